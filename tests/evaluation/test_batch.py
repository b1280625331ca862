"""Evaluation of policies that act in several episodes at the same time."""

import numpy as np
import pytest
from pettingzoo.utils import BaseParallelWrapper

from mapf_pz.environment.policy import BatchPolicy, make_env
from mapf_pz.evaluation import EvaluationTask, evaluate, policy_factory, rollout
from mapf_pz.evaluation import batch as batches
from mapf_pz.evaluation.batch import MAX_AGENTS, batch_of
from mapf_pz.evaluation.episodes import run_episodes
from mapf_pz.evaluation.policies import factory_for
from mapf_pz.instances import RandomObstacles
from mapf_pz.planners import Shield
from mapf_pz.simulator.actions import CardinalAction
from tests.evaluation.test_episodes import DRAWN, SOLVED, TIMES, Right, on, untimed

RESTART = EvaluationTask("lifelong", 6, {"map": "maze-13-13-1", "max_steps": 25, "on_target": "restart"}, 7, best=0.5)
FINISH = EvaluationTask(
    "finish", 6, {"source": RandomObstacles(8, 8, 0.1, 6), "max_steps": 25, "on_target": "finish"}, 7
)
WEIGHTS = EvaluationTask(
    "weights", 6, {"source": RandomObstacles(8, 8, 0.1, 6), "max_steps": 25, "edge_weights": "random"}, 7
)


class RightInBatch(Right):
    """Moves right, in single environments and in batches, and records in how many environments."""

    def __init__(self):
        super().__init__()
        self.calls = []

    def in_batch(self, simulator):
        policy = self

        class Batch:
            def reset(self, b):
                policy.episodes += 1

            def actions(self, observation, envs):
                policy.calls.append(list(envs))
                assert observation.image.shape[:2] == simulator.agents.shape
                return np.full(simulator.agents.shape, int(CardinalAction.RIGHT), np.int64)

        return Batch()


@pytest.mark.parametrize("task", [DRAWN, SOLVED, RESTART, FINISH, WEIGHTS], ids=lambda task: task.name)
@pytest.mark.parametrize("name", ["mappo", "mappo+pibt", "central"])
def test_metrics_are_those_of_single_episodes(monkeypatch, name, task):
    pytest.importorskip("torch")
    monkeypatch.setattr(batches, "MAX_AGENTS", 4 * task.num_agents)  # fewer environments than episodes
    factory = policy_factory(name)
    found = list(run_episodes(factory, task, range(task.episodes)))
    for episode, metrics in enumerate(found):
        env, policy = factory(task.env_keywords(episode))
        result = rollout(env, policy, task.seed + episode, task.instance(episode))
        assert result.metrics.items() <= metrics.items()
    assert any(metrics != found[0] for metrics in untimed(found))
    assert all(metrics.keys() >= TIMES for metrics in found)
    assert all(("best_ratio" in metrics) == (task is RESTART) for metrics in found)


def test_an_environment_continues_with_the_next_episode(monkeypatch):
    monkeypatch.setattr(batches, "MAX_AGENTS", 2)
    policy, task = RightInBatch(), on("a.A..", "a...A", "aA...", "a..A.")
    assert [episode["SoC"] for episode in run_episodes(factory_for(policy), task, range(4))] == [2, 4, 1, 3]
    compiling, *calls = policy.calls
    assert compiling == [0, 1]
    assert calls == [[0, 1], [0, 1], [0, 1], [0, 1], [0], [0]]  # env 0: episodes 0, 2, 3; env 1: episode 1
    assert policy.episodes == 2 + 4


def test_collisions_in_a_batch_are_those_of_each_episode():
    task = on("a.b\nBA.", ".a.\nbAB", max_steps=4)
    single = list(run_episodes(factory_for(Right()), task, range(2)))
    assert untimed(run_episodes(factory_for(RightInBatch()), task, range(2))) == untimed(single)
    assert single[0]["collisions"] != single[1]["collisions"]


def test_the_runtime_is_divided_among_the_running_episodes(monkeypatch):
    clock = iter(range(1000))
    monkeypatch.setattr("mapf_pz.evaluation.batch.time.process_time", lambda: next(clock))
    episodes = list(run_episodes(factory_for(RightInBatch()), on("a.A..", "a...A"), range(2)))
    assert [episode["runtime"] for episode in episodes] == [1 / 2 + 1 / 2, 1 / 2 + 1 / 2 + 1 + 1]
    assert [episode["step_ms"] for episode in episodes] == [500, 750]
    assert [episode["agent_us"] for episode in episodes] == pytest.approx([500_000, 750_000])


def test_maps_of_different_sizes():
    task = on("a...A", "a.A\n...", "a..A", "..a..A", "a...A", "A....\na....")
    policy = RightInBatch()
    found = list(run_episodes(factory_for(policy), task, range(5)))
    assert [episode["SoC"] for episode in found] == [4, 2, 3, 3, 4]
    assert max(map(len, policy.calls)) == 1
    found = list(run_episodes(factory_for(policy), task, [4, 0, 2]))
    assert [episode["SoC"] for episode in found] == [4, 4, 3]
    assert max(map(len, policy.calls)) == 2


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        ([[0, 0]], r"expected integers of shape \(2, 1\), got int64 of shape \(1, 2\)"),
        ([[0.5], [1]], r"expected integers of shape \(2, 1\), got float64 of shape \(2, 1\)"),
        ([[0], [5]], "expected numbers from 0 to 4, got 0 to 5"),
        ([[-1], [1]], "expected numbers from 0 to 4, got -1 to 1"),
    ],
)
def test_invalid_actions(monkeypatch, actions, message):
    policy = RightInBatch()
    in_batch = policy.in_batch

    def invalid(simulator):
        batch = in_batch(simulator)
        batch.actions = lambda observation, envs: np.array(actions)
        return batch

    monkeypatch.setattr(policy, "in_batch", invalid)
    with pytest.raises(ValueError, match=f"^actions of a policy in a batch: {message}$"):
        list(run_episodes(factory_for(policy), on("a...A", "a..A."), range(2)))


def test_a_wrapped_environment_is_for_single_episodes():
    policy, task = RightInBatch(), on("a...A", "a..A.")

    def factory(keywords):
        return BaseParallelWrapper(make_env(policy, **keywords)), policy

    assert [episode["SoC"] for episode in run_episodes(factory, task, range(2))] == [4, 3]
    assert policy.calls == []


class PrefersRight(Right):
    def preferences(self, observations):
        return {name: np.eye(5)[CardinalAction.RIGHT] for name in observations}


def test_a_shield_acts_in_batches_if_its_policy_does():
    def factory(keywords):
        env = make_env(PrefersRight(), **keywords)
        return env, Shield(PrefersRight(), env)

    env, shield = factory(on("a...A").env_keywords(0))
    assert isinstance(shield, BatchPolicy)
    assert shield.in_batch(env.simulator) is None
    assert [episode["SoC"] for episode in run_episodes(factory, on("a...A", "a..A."), range(2))] == [4, 3]


def test_the_number_of_environments():
    def number(num_agents, episodes=1000, size=10, **keywords):
        source = RandomObstacles(size, size, 0.1, num_agents)
        task = EvaluationTask("many", num_agents, {"source": source} | keywords, episodes)
        return batch_of(make_env(Right(), **task.env_keywords(0)).simulator, task, range(episodes)).num_envs

    assert number(8) == MAX_AGENTS // 8
    assert number(8, episodes=3) == 3
    assert number(20, distance_bytes=100 * (128 + 20 * 20) * 3) == 3
    assert number(20, distance_bytes=100 * 4 * 20) == 1
    assert number(MAX_AGENTS + 1, size=30) == 1
    assert number(2, size=500) < MAX_AGENTS // 2


def test_jobs_of_policies_that_act_in_batches_have_more_episodes(monkeypatch):
    jobs = []

    def run_jobs(function, items, _):
        jobs.extend((item.name, len(item.episodes)) for item in items)
        return map(function, items)

    monkeypatch.setattr("mapf_pz.evaluation.evaluate_policies.run_jobs", run_jobs)
    task = on("aA").with_(episodes=20)
    evaluate({"single": Right(), "batch": RightInBatch()}, [task])
    assert jobs == [("single", 8), ("single", 8), ("single", 4), ("batch", 20)]
    assert policy_factory("mappo").in_batches
