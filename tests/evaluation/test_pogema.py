import numpy as np
import pytest

import mapf_pz
from mapf_pz.evaluation import EvaluationTask, evaluate
from mapf_pz.evaluation.pogema.pogema import FromPogema, InPogema, pogema_policy
from mapf_pz.evaluation.policies import factory_for
from mapf_pz.instances import RandomObstacles
from mapf_pz.planners import Planner
from mapf_pz.simulator.actions import CardinalAction as Do

MAP = "....\n.#..\n....\n"
"""Where most of these tests take place."""


class Scripted:
    """A policy for POGEMA that takes given actions, and stores its observations."""

    def __init__(self, *actions):
        self.actions = list(actions)
        self.seen = []

    def act(self, observations):
        self.seen.append(observations)
        return self.actions.pop(0)

    def reset_states(self):
        pass


def drawn(*rows):
    return [[float(char != ".") for char in row] for row in rows]


def env_of(starts, goals, map=MAP, **keywords):
    scenario = mapf_pz.Scenario(starts, goals)
    all_keywords = keywords | {"num_agents": len(scenario), "action_model": "cardinal"} | Planner.env_kwargs
    env = mapf_pz.parallel_env(map=map, scenario=scenario, **all_keywords)
    observations, _ = env.reset(seed=0)
    return env, observations


def step(env, *actions):
    env.step(dict(zip(env.agents, actions, strict=True)))


def test_pogemas_default_radius():
    env, _ = env_of([[0, 0]], [[2, 3]])
    (seen,) = FromPogema(Scripted(), env).observe()
    assert seen.shape == (3, 11, 11)


def test_default_observation():
    env, _ = env_of([[0, 0], [0, 1]], [[2, 3], [0, 0]])
    first, second = FromPogema(Scripted(), env, obs_radius=1).observe()
    assert (first.dtype, first.shape) == (np.float32, (3, 3, 3))
    assert first.tolist() == [drawn("###", "#..", "#.#"), drawn("...", ".@@", "..."), drawn("...", "...", "..@")]
    assert second.tolist() == [drawn("###", "...", ".#."), drawn("...", "@@.", "..."), drawn("...", "@..", "...")]


def test_only_a_ring_of_obstacles_is_around_the_map():
    env, _ = env_of([[0, 0]], [[1, 3]])
    (seen,) = FromPogema(Scripted(), env, obs_radius=2).observe()
    assert seen[0].tolist() == drawn(".....", ".####", ".#...", ".#.#.", ".#...")
    assert seen[2].tolist() == drawn(".....", ".....", ".....", "....@", ".....")


def test_positions_count_from_the_start():
    env, _ = env_of([[0, 1], [2, 3]], [[2, 1], [0, 0]])
    policy = FromPogema(Scripted(), env, obs_radius=1, observation_type="POMAPF")
    policy.observe()
    step(env, Do.RIGHT, Do.UP)
    first, second = policy.observe()
    assert first["obstacles"].tolist() == drawn("###", "...", "#..")
    assert first["agents"].tolist() == drawn("...", ".@.", "..@")
    assert (first["xy"], first["target_xy"]) == ((0, 1), (2, 0))
    assert (second["xy"], second["target_xy"]) == ((-1, 0), (-2, -3))
    assert first.keys() == {"obstacles", "agents", "xy", "target_xy"}


def test_the_whole_map_is_padded():
    env, _ = env_of([[0, 1]], [[2, 3]])
    (seen,) = FromPogema(Scripted(), env, obs_radius=2, observation_type="MAPF").observe()
    rows = ("........", ".######.", ".#....#.", ".#.#..#.", ".#....#.", ".######.", "........")
    assert seen["global_obstacles"].tolist() == drawn(*rows)
    assert (seen["global_xy"], seen["global_target_xy"]) == ((2, 3), (4, 5))


@pytest.mark.parametrize(
    ("collision_system", "columns", "show_followers", "shown"),
    [
        ("soft", [0, 1], False, ".@"),
        ("soft", [0, 1], True, "@@"),
        ("soft", [1, 0], False, "@@"),  # the follower's index is the higher one
        ("priority", [1, 0], False, "@@"),
    ],
)
def test_followers_as_pogema_shows_them(collision_system, columns, show_followers, shown):
    env, _ = env_of([[0, c] for c in columns], [[2, 3], [2, 2]], collision_system=collision_system)
    policy = FromPogema(Scripted(), env, 1, "POMAPF", show_followers)
    step(env, Do.RIGHT, Do.RIGHT)
    assert env.positions[:, 1].tolist() == [c + 1 for c in columns]
    behind = policy.observe()[columns.index(0)]
    assert behind["agents"].tolist() == drawn("...", "." + shown, "...")
    step(env, Do.WAIT, Do.WAIT)
    assert policy.observe()[columns.index(0)]["agents"].tolist() == drawn("...", ".@@", "...")


def test_agents_that_have_disappeared():
    env, observations = env_of([[0, 3], [2, 0], [0, 0]], [[2, 3], [0, 2], [0, 1]], on_target="finish")
    script = Scripted([Do.WAIT, Do.WAIT, Do.RIGHT], [Do.LEFT, Do.WAIT, Do.UP], [Do.LEFT, Do.WAIT, Do.UP])
    policy = FromPogema(script, env, obs_radius=1)
    policy.reset_states()
    while env.agents and script.actions:
        observations = env.step(policy.act(observations))[0]
    assert env.agents == ["agent_0", "agent_1"]
    assert [seen[2][1].tolist() for seen in script.seen[1:]] == [drawn("...", "...", "..."), drawn("...", "..@", "...")]
    assert env.positions.tolist() == [[0, 1], [2, 0], [0, 1]]
    assert policy.observe()[2][1].tolist() == drawn("...", ".@.", "...")  # another one, where it was


class Straight:
    """A policy of POGEMA's for empty maps: first along the row, then along the column."""

    def act(self, observations):
        return [self.decide(*np.subtract(seen["target_xy"], seen["xy"])) for seen in observations]

    def decide(self, rows, cols):
        if cols:
            return Do.RIGHT if cols > 0 else Do.LEFT
        return Do.WAIT if rows == 0 else Do.DOWN if rows > 0 else Do.UP

    def reset_states(self):
        pass


def test_a_policy_of_pogema_is_evaluated():
    task = EvaluationTask("empty", 1, {"map": "empty-8-8", "num_agents": 1, "max_steps": 20}, episodes=10)
    episodes = evaluate({"straight": pogema_policy(Straight(), observation_type="POMAPF")}, [task])
    assert len(episodes) == 10
    for episode in episodes:
        assert (episode.metrics["CSR"], episode.metrics["SoC_ratio"]) == (1, 1)


def test_environments_that_do_not_fit_pogema():
    with pytest.raises(ValueError, match="action_model='rotate': POGEMA's actions are 'cardinal'"):
        FromPogema(Straight(), mapf_pz.parallel_env())
    env, _ = env_of([[0, 0]], [[0, 1]])
    with pytest.raises(ValueError, match="obs_radius=0: expected a number of cells of 1 or more"):
        FromPogema(Straight(), env, obs_radius=0)
    with pytest.raises(ValueError, match="observation_type='pomapf': expected one of 'default', 'POMAPF', 'MAPF'"):
        FromPogema(Straight(), env, observation_type="pomapf")


class Watcher:
    """Takes random actions, and keeps what it saw."""

    env_kwargs = {  # noqa: RUF012
        "channels": ("view", "cost_to_go", "others_next", "others_at_goal"),
        "features": ("action_advantage", "last_actions", "time"),
    }

    def __init__(self):
        self.seen = []

    def act(self, observations):
        self.seen.append(observations)
        return {agent: int(self.rng.integers(5)) for agent in observations}

    def reset_states(self):
        self.rng = np.random.default_rng(3)


def in_pogema(agent, env, obs_radius, seed):
    """Let `agent` play an episode in `env`, of which it sees what POGEMA would show."""
    env.reset(seed=seed)
    agent.reset_states()
    window = FromPogema(Scripted(), env, obs_radius, "MAPF")
    while env.agents:
        actions = dict(zip(env.possible_agents, agent.act(window.observe()), strict=True))
        env.step({name: actions[name] for name in env.agents})
    return env.metrics()


@pytest.mark.parametrize("on_target", ["nothing", "finish", "restart"])
@pytest.mark.parametrize("collision_system", ["soft", "priority", "block_both"])
@pytest.mark.parametrize("obs_radius", [1, 5])
def test_a_policy_sees_in_pogema_what_it_sees_here(on_target, collision_system, obs_radius):
    rules = {"on_target": on_target, "collision_system": collision_system, "max_steps": 60}
    source = RandomObstacles(5, 6, 0.1, num_agents=7, goals_per_agent=61 if on_target == "restart" else 1)
    here, there = Watcher(), Watcher()
    agent = InPogema(factory_for(there), **rules)
    for seed in range(3):
        env = mapf_pz.parallel_env(source=source, action_model="cardinal", **rules, **Watcher.env_kwargs)
        observations, _ = env.reset(seed=seed)
        here.reset_states()
        while env.agents:
            observations = env.step(here.act(observations))[0]
        assert in_pogema(agent, env, obs_radius, seed) == env.metrics()
    assert len(here.seen) == len(there.seen) > 100
    for first, second in zip(here.seen, there.seen, strict=True):
        assert first.keys() == second.keys()
        for name, seen in first.items():
            assert all(np.array_equal(part, second[name][key]) for key, part in seen.items())


@pytest.mark.parametrize("on_target", ["nothing", "restart"])
def test_a_planner_acts_in_pogema_as_here(on_target):
    rules = {"on_target": on_target, "collision_system": "soft", "max_steps": 50}
    source = RandomObstacles(8, 8, 0.1, num_agents=8, goals_per_agent=51)
    (episode,) = evaluate(
        ["pibt"], [EvaluationTask("", 8, {"source": source, "action_model": "cardinal"} | rules, 1, seed=5)]
    )
    env = mapf_pz.parallel_env(source=source, action_model="cardinal", **rules)
    metrics = in_pogema(InPogema("pibt", **rules), env, 5, seed=5)
    assert metrics == {name: episode.metrics[name] for name in metrics}


def observed(env, observation_type="MAPF"):
    return FromPogema(Scripted(), env, 2, observation_type).observe()


def moving_right(**keywords):
    """Return an agent in POGEMA whose policy always moves right."""

    class Right:
        env_kwargs = Planner.env_kwargs

        def act(self, observations):
            return dict.fromkeys(observations, int(Do.RIGHT))

        def reset_states(self):
            pass

    rules = {"collision_system": "soft", "on_target": "nothing", "max_steps": 5} | keywords
    return InPogema(factory_for(Right()), **rules)


def test_actions_that_were_not_taken():
    env, _ = env_of([[0, 0], [2, 0]], [[0, 3], [2, 3]])
    agent = moving_right()
    assert agent.act(observed(env)) == [Do.RIGHT, Do.RIGHT]
    step(env, Do.RIGHT, Do.WAIT)
    expected = (
        r"step 1: the position of agent 1 is \[2, 0\] in POGEMA, but \[2, 1\] by these rules: expected POGEMA to have "
        "collision_system='soft', on_target='nothing', max_steps=5, to execute the returned"
    )
    with pytest.raises(RuntimeError, match=expected):
        agent.act(observed(env))


def test_another_collision_system():
    env, _ = env_of([[0, 0], [0, 1]], [[0, 3], [2, 3]], collision_system="block_both")
    agent = moving_right()
    step(env, *agent.act(observed(env)))
    with pytest.raises(RuntimeError, match=r"the position of agent 0 is \[0, 0\] in POGEMA, but \[0, 1\] by"):
        agent.act(observed(env))


def test_another_mode():
    env, _ = env_of([[0, 0]], [[[0, 1], [2, 2]]], on_target="restart")
    agent = moving_right()
    step(env, *agent.act(observed(env)))
    with pytest.raises(RuntimeError, match=r"the goal of agent 0 is \[2, 2\] in POGEMA, but \[0, 1\] by these rules"):
        agent.act(observed(env))


def test_another_time_limit():
    env, _ = env_of([[0, 0]], [[2, 3]])
    agent = moving_right(max_steps=1)
    step(env, *agent.act(observed(env)))
    with pytest.raises(RuntimeError, match=r"step 1: POGEMA's episode continues after its end: expected .*max_steps=1"):
        agent.act(observed(env))


@pytest.mark.parametrize(("map", "starts"), [("....\n....\n....\n", [[0, 0]]), (MAP, [[0, 0], [2, 0]])])
def test_a_missing_reset_is_reported(map, starts):
    env, _ = env_of([[0, 0]], [[0, 3]])
    agent = moving_right()
    agent.act(observed(env))
    other, _ = env_of(starts, [[0, 3], [2, 3]][: len(starts)], map)
    with pytest.raises(RuntimeError, match="another map or number of agents: expected reset_states"):
        agent.act(observed(other))
    agent.reset_states()
    assert agent.act(observed(other)) == [Do.RIGHT] * len(starts)


def test_goals_are_never_drawn():
    """They could not be: no component of the map holds all agents."""
    starts, goals = [[0, 0], [0, 1], [0, 3], [0, 4]], [[0, 1], [0, 0], [0, 4], [0, 3]]
    env, _ = env_of(starts, np.stack([goals, starts], axis=1), "..#..\n", on_target="restart")
    assert moving_right(on_target="restart").act(observed(env)) == [Do.RIGHT] * 4


@pytest.mark.parametrize("observation_type", ["default", "POMAPF"])
def test_other_observations(observation_type):
    env, _ = env_of([[0, 0]], [[0, 3]])
    with pytest.raises(ValueError, match="expected observations of POGEMA's observation_type='MAPF'"):
        moving_right().act(observed(env, observation_type))
