import os
import re
from collections import Counter

import numpy as np
import pytest

from mapf_pz.evaluation import EvaluationTask, evaluate, make_env, policy_factory, rollout
from mapf_pz.evaluation.episodes import run_episodes
from mapf_pz.evaluation.policies import factory_for
from mapf_pz.instances import RandomObstacles
from mapf_pz.instances.instance import Grid, Instance, Scenario
from mapf_pz.simulator.actions import Action, CardinalAction
from tests.helpers.text_instances import drawn

TIMES = {"runtime", "step_ms", "agent_us"}


class Forward:
    """Moves forward, and counts the episodes."""

    env_kwargs = {"initial_heading": "east", "view_size": (1, 1)}  # noqa: RUF012
    identity = "moves in one direction"

    def __init__(self):
        self.episodes = 0

    def act(self, observations):
        return dict.fromkeys(observations, int(Action.FORWARD))

    def reset_states(self):
        self.episodes += 1


class Right(Forward):
    env_kwargs = {"action_model": "cardinal", "view_size": (1, 1)}  # noqa: RUF012

    def act(self, observations):
        return dict.fromkeys(observations, int(CardinalAction.RIGHT))


def measured(policy, task, episodes=None):
    return list(run_episodes(factory_for(policy), task, range(task.episodes) if episodes is None else episodes))


def on(*drawings, max_steps=10, **fields):
    instances = tuple(map(drawn, drawings))
    keywords, count = {"max_steps": max_steps}, instances[0].num_agents
    return EvaluationTask("drawn", count, keywords, len(drawings), instances=instances, **fields)


# The number of agents.


def test_the_number_of_agents_of_a_task():
    seen = []

    class Counts(Right):
        def act(self, observations):
            seen.append(len(observations))
            return super().act(observations)

    measured(Counts(), EvaluationTask("empty", 20, {"map": "empty-8-8", "max_steps": 3}, episodes=2))
    assert set(seen) == {20}


@pytest.mark.parametrize(
    ("parts", "origin"),
    [
        ({"keywords": {"num_agents": 3}}, r"keywords\['num_agents'\]"),
        ({"keywords": {"source": RandomObstacles(8, 8, 0.1, 3)}}, r"keywords\['source'\]"),
        ({"instances": (drawn("ab\nBA"), drawn("abc\nABC"))}, "instance 1"),
    ],
    ids=lambda parts: "",
)
def test_contradictory_numbers_of_agents(parts, origin):
    with pytest.raises(ValueError, match=rf"^task 'mine': num_agents=2, but {origin} has 3 agents$"):
        EvaluationTask("mine", 2, **parts)


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        ({"num_agents": 2.5}, "num_agents=2.5: expected a whole number, 1 or more"),
        ({"num_agents": 0}, "num_agents=0: expected a whole number, 1 or more"),
        ({"episodes": 1.5}, "episodes=1.5: expected a whole number, 0 or more"),
        ({"seed": -1}, "seed=-1: expected a whole number, 0 or more"),
        ({"seed": True}, "seed=True: expected a whole number, 0 or more"),
    ],
)
def test_numbers_are_whole(numbers, message):
    with pytest.raises(ValueError, match=f"^task 'mine': {re.escape(message)}$"):
        EvaluationTask("mine", **{"num_agents": 2, "keywords": {"map": "empty-8-8"}} | numbers)


def test_each_instance_is_played_once_by_default():
    assert EvaluationTask("drawn", 1, instances=(drawn("a..A"), drawn("a.A."))).episodes == 2
    assert EvaluationTask("drawn", 1, instances=(drawn("a..A"),), episodes=3).episodes == 3
    assert EvaluationTask("empty", 1, {"map": "empty-8-8"}).episodes == 256


# What is no policy.


class Forgets:
    def act(self, observations):
        return dict.fromkeys(observations, 0)


@pytest.mark.parametrize(
    ("policy", "message"),
    [
        (Right, r"^policy Right: expected an object, such as Right\(\), got the class$"),
        (Forgets(), "^policy Forgets: expected the methods act and reset_states, not found: reset_states$"),
        (type("Empty", (), {}), "^policy Empty: expected an object"),
        (7, "^policy int: expected the methods act and reset_states, not found: act$"),
    ],
    ids=["class", "no reset_states", "empty class", "number"],
)
def test_what_is_not_a_policy(policy, message):
    task = on("a...A")
    with pytest.raises(TypeError, match=message):
        evaluate({"mine": policy}, [task])
    with pytest.raises(TypeError, match=message):
        rollout(make_env(Right(), **task.env_keywords(0)), policy, seed=0)


# Metrics.


def test_metrics_of_each_episode():
    episodes = measured(Forward(), EvaluationTask("corridor", 1, instances=(drawn("a...A"),), episodes=3))
    assert len(episodes) == 3
    for episode in episodes:
        assert (episode["CSR"], episode["SoC"], episode["makespan"], episode["SoC_ratio"]) == (1, 4, 4, 1)
        assert episode["collisions"] == 0


def test_time_limit_counts_as_unsolved():
    (episode,) = measured(Forward(), on("a...A", max_steps=3))
    assert (episode["CSR"], episode["ISR"], episode["ep_length"]) == (0, 0, 3)


def test_a_rollout_calls_after_the_reset_and_after_each_step():
    policy, columns = Forward(), []
    env = make_env(policy, **on("a...A").env_keywords(0))
    result = rollout(env, policy, seed=0, on_step=lambda: columns.append(env.positions[0, 1]))
    assert columns == [0, 1, 2, 3, 4]
    assert (result.num_steps, result.metrics) == (4, env.metrics())
    assert result.runtime > 0
    assert policy.episodes == 1


def test_collisions_are_the_share_of_prevented_moves():
    # The agent in front stands at the wall from the beginning, that behind it after one step.
    (episode,) = measured(Right(), on("a.b\nBA.", max_steps=4))
    assert episode["collisions"] == (4 + 3) / 8
    (episode,) = measured(Right(), on("a...A"))
    assert episode["collisions"] == 0


def test_agents_that_have_left_do_not_count():
    # `a` disappears after a step, `b` moves into the wall in each of four steps.
    task = EvaluationTask("drawn", 2, {"max_steps": 4, "on_target": "finish"}, 1, instances=(drawn("aA\nBb"),))
    (episode,) = measured(Right(), task)
    assert episode["collisions"] == 4 / 5


def test_times_belong_together(monkeypatch):
    clock = iter(range(1000))
    monkeypatch.setattr("mapf_pz.evaluation.episodes.time.process_time", lambda: 0.5 * next(clock))
    task = EvaluationTask("drawn", 2, {"max_steps": 5}, 1, instances=(drawn("a.B\nb.A"),))
    (episode,) = measured(Right(), task)
    assert episode["runtime"] == 5 * 0.5
    assert episode["step_ms"] == 500
    assert episode["agent_us"] == pytest.approx(250_000)


def test_the_first_decision_is_not_measured():
    slow = []

    class Compiles(Right):
        def act(self, observations):
            slow.append(self.episodes)
            return super().act(observations)

    measured(Compiles(), on("a...A", "a...A"))
    assert Counter(slow) == {1: 1, 2: 4, 3: 4}  # once before both episodes


def test_best_ratio_is_of_the_throughput():
    instance = Instance(Grid(np.ones((1, 5), bool)), Scenario([[0, 0]], [[[0, 1], [0, 2], [0, 3], [0, 4]]]))
    task = EvaluationTask("lifelong", 1, {"max_steps": 4, "on_target": "restart"}, 1, instances=(instance,), best=2.0)
    (episode,) = measured(Right(), task)
    assert (episode["avg_throughput"], episode["best_ratio"]) == (1, 0.5)
    assert "CSR" not in episode
    (episode,) = measured(Right(), on("a.A", best=2.0))
    assert "best_ratio" not in episode


def test_maps_of_different_sizes_in_one_task():
    task = on("a...A", "a.A\n...", "a..A", "..a..A", "a...A")
    assert [episode["SoC"] for episode in measured(Right(), task)] == [4, 2, 3, 3, 4]
    assert [episode["SoC"] for episode in measured(Right(), task, [3, 1])] == [3, 2]


def test_instances_are_gone_through_again():
    task = on("a...A", "a.A..").with_(episodes=5)
    assert [episode["SoC"] for episode in measured(Right(), task)] == [4, 2, 4, 2, 4]


def test_the_settings_that_a_policy_requires():
    class Looks(Right):
        env_kwargs = Right.env_kwargs | {"num_frames": 3}
        seen = None

        def act(self, observations):
            self.seen = next(iter(observations.values())).shape
            return super().act(observations)

    policy = Looks()
    assert measured(policy, on("a...A"))[0]["SoC"] == 4
    assert policy.seen[0] == 3 * make_env(Right()).observation_space("agent_0").shape[0]


# Episodes are the same however they are done.

DRAWN = EvaluationTask("random 7 x 8", 6, {"source": RandomObstacles(7, 8, 0.15, 6), "max_steps": 20}, 3)
FREE = "\n.......\n.......\n.......\n......."
DRAWINGS = [
    "a....B.\nb....A.\n......." + FREE,
    "aB.....\n..b....\nA......" + FREE,
    "ab......\n..BA....\n........" + FREE.replace("\n", "\n."),
]
SOLVED = EvaluationTask("drawn", 2, {"max_steps": 12}, 3, instances=tuple(map(drawn, DRAWINGS)))
NAMES = ["random", "pibt", "epibt", "mappo"]


def untimed(episodes):
    return [{name: value for name, value in episode.items() if name not in TIMES} for episode in episodes]


def needed(name):
    if name == "mappo":
        pytest.importorskip("torch")
    return policy_factory(name)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("task", [DRAWN, SOLVED], ids=["drawn", "instances"])
def test_an_episode_does_not_depend_on_those_before_it(name, task):
    factory = needed(name)
    whole = untimed(run_episodes(factory, task, range(3)))
    assert untimed(run_episodes(factory, task, [2, 0, 1])) == [whole[2], whole[0], whole[1]]
    assert untimed(run_episodes(factory, task, [1])) == [whole[1]]
    assert whole[0] != whole[1] != whole[2]


def outcome(names, tasks, jobs):
    done = evaluate(names, tasks, jobs=jobs)
    assert [episode.key for episode in done] == [
        (name, task.name, task.num_agents, number)
        for task in tasks
        for name in names
        for number in range(task.episodes)
    ]
    return untimed([episode.metrics for episode in done])


@pytest.mark.slow
@pytest.mark.usefixtures("forked_processes")
def test_processes_do_the_same():
    pytest.importorskip("torch")
    names, tasks = ["pibt", "mappo"], [SOLVED]  # one job for each policy, so that only one process imports torch
    assert outcome(names, tasks, 1) == outcome(names, tasks, 2)


@pytest.mark.slow
def test_ray_does_the_same(monkeypatch):
    ray = pytest.importorskip("ray")
    monkeypatch.setenv("RAY_AUTH_MODE", "disabled")
    monkeypatch.setenv("RAY_worker_niceness", "0")  # on a busy machine, its workers would never get their turn
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([os.getcwd(), os.environ.get("PYTHONPATH", "")]))
    names, tasks = ["random", "pibt"], [DRAWN.with_(episodes=9), SOLVED]  # two jobs, and one
    assert outcome(names, tasks, "ray") == outcome(names, tasks, 1)
    assert not ray.is_initialized()
