"""The PettingZoo environment: PettingZoo's own tests, reproducibility, what agents live through, what they earn."""

import copy
import json
import pickle

import gymnasium
import numpy as np
import pettingzoo
import pytest
from gymnasium.utils.env_checker import data_equivalence
from pettingzoo.test import (
    api_test,
    parallel_api_test,
    parallel_seed_test,
    render_test,
    seed_test,
    state_test,
)

import mapf_pz
from mapf_pz import Action, CardinalAction, Grid, Instance, RewardConfig, Scenario
from mapf_pz.instances import RandomObstacles
from mapf_pz.simulator.kernels.observation.channels import CHANNELS
from mapf_pz.simulator.metrics import EpisodeRecord, episode_metrics
from mapf_pz.wrappers import ContinuousActions, FlatObservations, centralized_env

EAST, SOUTH, WEST, NORTH = range(4)
FORWARD, LEFT, RIGHT, WAIT = map(int, Action)
ON_TARGET = ("nothing", "finish", "restart")
KINDS = {
    "default": {},
    "cardinal": {"action_model": "cardinal", "view_size": (3, 3)},
    "features": {"features": ("goal_vector", "action_advantage", "last_actions", "time"), "on_target": "restart"},
    "finish": {"on_target": "finish", "channels": ("view", "cost_to_go", "others_next"), "reward": "progress"},
    "random maps": {"source": RandomObstacles(6, 7, 0.2, 4), "edge_weights": "random"},
}


@pytest.fixture(params=KINDS)
def keywords(request):
    return {"max_steps": 30} | KINDS[request.param]


@pytest.mark.parametrize("channel", CHANNELS)
def test_a_channel_has_the_bounds_of_its_space(channel):
    env = mapf_pz.parallel_env(
        map=".....\n.@@..\n.....",
        num_agents=8,
        channels=(channel,),
        view_size=(3, 5),
        see_through_walls=False,
        edge_weights="random",
    )
    space, seen = env.observation_space("agent_0"), list(env.reset(seed=0)[0].values())
    assert all(space.contains(one) for one in seen)
    assert (space.low.min(), space.high.max()) == (np.min(seen), 1)


@pytest.mark.parametrize(
    ("keywords", "count"),
    [
        ({}, 4),
        ({"scenario": Scenario([(0, 0), (1, 1)], [(1, 1), (0, 0)])}, 2),
        ({"scenario": Scenario([(0, 0), (1, 1)], [(1, 1), (0, 0)]), "num_agents": 1}, 1),
        ({"source": RandomObstacles(6, 7, 0.2, 5)}, 5),
    ],
    ids=str,
)
def test_the_number_of_agents_if_none_is_given(keywords, count):
    env = mapf_pz.parallel_env(**keywords)
    assert len(env.possible_agents) == count
    assert len(env.reset(seed=0)[0]) == count


# PettingZoo's own tests.


def test_parallel_api(keywords):
    parallel_api_test(mapf_pz.parallel_env(**keywords), num_cycles=100)


def test_parallel_seeds(keywords):
    parallel_seed_test(lambda: mapf_pz.parallel_env(**keywords))


@pytest.mark.filterwarnings("ignore:The observation contains negative numbers")  # a blocked edge is -1
@pytest.mark.filterwarnings("ignore:Observation is not a NumPy array")  # with features, it is a dictionary of two
@pytest.mark.filterwarnings("ignore:Observation space for each agent probably should be gymnasium.spaces.box")
def test_aec_api(keywords):
    api_test(mapf_pz.env(**keywords), num_cycles=200)


def test_aec_form_has_the_metrics_of_the_last_complete_step():
    env, parallel = mapf_pz.env(num_agents=2, max_steps=8), mapf_pz.parallel_env(num_agents=2, max_steps=8)
    env.reset(seed=3)
    parallel.reset(seed=3)
    for _ in range(8):
        assert env.metrics() == env.unwrapped.metrics() == parallel.metrics()
        for agent in ("agent_0", "agent_1"):
            assert env.metrics() == parallel.metrics()
            assert env.agent_selection == agent
            env.step(0)
        parallel.step({"agent_0": 0, "agent_1": 0})
    assert env.metrics()["ep_length"] == 8


def test_the_observation_space_is_printed_with_the_bounds_of_each_plane():
    space = mapf_pz.parallel_env(channels=("view", "goal"), view_size=(5, 7)).observation_space("agent_0")
    assert str(space) == "Box([-1 0], [1 1], (2, 5, 7), float32)"


def test_aec_seeds(keywords):
    seed_test(lambda: mapf_pz.env(**keywords), num_cycles=200)


def test_aec_render(keywords):
    pytest.importorskip("pygame")
    render_test(lambda render_mode: mapf_pz.env(**keywords, render_mode=render_mode))


def test_human_rendering_shows_every_step(monkeypatch):
    window = pytest.importorskip("mapf_pz.render.window")
    pytest.importorskip("pygame")
    shown = []
    monkeypatch.setattr(window.Window, "show", lambda _, picture, title: shown.append((picture, title)))
    options = {"map": "empty-8-8", "num_agents": 2}
    env = mapf_pz.parallel_env(**options, render_mode="human")
    twin = mapf_pz.parallel_env(**options, render_mode="rgb_array")
    for each in (env, twin):
        each.reset(seed=0)
    for step in range(3):
        picture, title = shown[step]
        assert title == f"step {step}"
        np.testing.assert_array_equal(picture, twin.render())
        for each in (env, twin):
            each.step(dict.fromkeys(each.agents, Action.ROTATE_LEFT))
    assert env.render() is None
    assert len(shown) == 5
    env.close()
    env.close()


def test_state_space(keywords):
    state_test(mapf_pz.env(**keywords), mapf_pz.parallel_env(**keywords), num_cycles=20)


@pytest.mark.skipif(not hasattr(pettingzoo, "register"), reason="PettingZoo before 1.27 has no registry")
@pytest.mark.parametrize("kind", ["parallel", "aec"])
def test_registries(kind):
    env = pettingzoo.make(kind, "mapf_pz/Mapf-v0", num_agents=3, max_steps=7)
    env.reset(seed=0)
    assert env.possible_agents == ["agent_0", "agent_1", "agent_2"]
    assert env.unwrapped.metadata["name"] == "mapf_v0"
    spec = (pettingzoo.parallel_registry if kind == "parallel" else pettingzoo.aec_registry)["mapf_pz/Mapf-v0"]
    assert spec.entry_point == f"mapf_pz.environment:{'parallel_env' if kind == 'parallel' else 'env'}"


# Reproducibility.


def episode(env, seed):
    """Return everything that happens in a whole episode."""
    rng = np.random.default_rng(seed)
    log = [env.reset(seed=seed)]
    while env.agents:
        log.append(env.step({agent: int(rng.choice(env.action_space(agent).n)) for agent in env.agents}))
        log.append((env.state(), env.metrics(), env.positions, env.goals, env.headings, env.step_count))
    return log


def assert_same(left, right):
    assert type(left) is type(right)
    if isinstance(left, dict):
        assert list(left) == list(right)
        assert_same(list(left.values()), list(right.values()))
    elif isinstance(left, (list, tuple)):
        assert len(left) == len(right)
        for one, other in zip(left, right, strict=True):
            assert_same(one, other)
    elif isinstance(left, np.ndarray):
        assert left.dtype == right.dtype
        np.testing.assert_array_equal(left, right)
    else:
        assert left == right


def test_whole_episodes_are_reproducible(keywords):
    """PettingZoo's own test of this compares one step."""
    env, other = mapf_pz.parallel_env(**keywords), mapf_pz.parallel_env(**keywords)
    first = episode(env, 3)
    assert len(first) >= 2
    episode(env, 4)  # what came before does not matter
    assert_same(first, episode(env, 3))
    assert_same(first, episode(other, 3))


def test_without_a_seed_episodes_differ_and_go_on_from_the_last_seed():
    env = mapf_pz.parallel_env()
    starts = []
    for seed in (1, None, None, 1, None):
        env.reset(seed=seed)
        starts.append(env.positions.tolist())
    assert starts[3:] == starts[:2]
    assert starts[0] != starts[1] != starts[2]


def test_arrays_are_never_reused():
    env = mapf_pz.parallel_env(features=("time",))
    arrays = []
    for step in range(4):
        observations, infos = env.reset(seed=step) if step % 2 == 0 else take(env, WAIT)
        arrays.append(
            [a for o in observations.values() for a in o.values()] + [i["action_mask"] for i in infos.values()]
        )
    for k, group in enumerate(arrays):
        for array in group:
            assert not any(np.shares_memory(array, other) for later in arrays[k + 1 :] for other in later)
    own = arrays[0]
    assert not any(np.shares_memory(own[i], own[j]) for i in range(len(own)) for j in range(i))


def take(env, action):
    observations, _, _, _, infos = env.step(dict.fromkeys(env.agents, action))
    return observations, infos


# What is readable: copies.


def test_readable_attributes_are_copies():
    env = mapf_pz.parallel_env(map=np.ones((4, 5), np.bool_), num_agents=3, view_size=(3, 3))
    env.reset(seed=0)
    before = episode_state(env)
    for array in (env.positions, env.goals, env.headings, env.state()):
        array[:] = 0
    assert_same(before, episode_state(env))
    assert env.positions.shape == env.goals.shape == (3, 2)
    assert env.headings.shape == (3,)
    assert env.positions.dtype.kind == env.goals.dtype.kind == env.headings.dtype.kind == "i"
    assert env.grid.dtype == np.bool_
    assert env.grid.shape == (4, 5)
    assert env.step_count == 0
    with pytest.raises(ValueError, match="read-only"):
        env.grid[0, 0] = False
    kept = env.positions
    for _ in range(10):
        take(env, FORWARD)
    assert env.step_count == 10
    assert kept.tolist() == before[0].tolist()
    assert not np.array_equal(env.positions, kept)


def episode_state(env):
    return [env.positions, env.goals, env.headings, env.grid.copy(), env.state()]


def test_the_callers_array_stays_the_callers():
    free = np.ones((4, 4), np.bool_)
    env = mapf_pz.parallel_env(map=free, num_agents=2, view_size=(2, 2))
    free[:] = False
    env.reset(seed=0)
    assert env.grid.all()


# Hand-drawn episodes.


def drawn(text, starts, headings, goals, **keywords):
    """Begin an episode on the map `text`; returns the environment and what `reset` returned."""
    env = mapf_pz.parallel_env(
        map=text, num_agents=len(starts), **{"view_size": (1, 1), "render_mode": "ansi"} | keywords
    )
    grid = env.simulator.source.grid
    return env, *env.reset(seed=0, options={"instance": Instance(grid, Scenario(starts, goals), headings)})


def go(env, *actions):
    return env.step(dict(zip(env.agents, actions, strict=True)))


def picture(*rows):
    return "".join(row + "\n" for row in rows)


def test_a_drawn_step():
    env, *_ = drawn(
        """
        ....
        .@@.
        ....
        """,
        [(0, 0), (0, 3), (2, 0)],
        [EAST, SOUTH, NORTH],
        [(0, 3), (2, 3), (2, 0)],
    )
    assert env.render() == picture(">..v", ".@@.", "N..x")
    go(env, FORWARD, FORWARD, RIGHT)
    assert env.render() == picture(".>.x", ".@@v", "E..x")
    go(env, FORWARD, FORWARD, FORWARD)
    assert env.render() == picture("..>x", ".@@.", "x>.S")
    go(env, FORWARD, LEFT, LEFT)
    assert env.render() == picture("...E", ".@@.", "x^.E")


def test_a_drawn_cardinal_step():
    env, *_ = drawn("..\n@.\n", [(0, 0), (1, 1)], None, [(1, 1), (0, 0)], action_model="cardinal")
    assert env.render() == picture("o.", "@o")  # each stands on the other's goal
    go(env, CardinalAction.DOWN, CardinalAction.UP)
    assert env.render() == picture("oo", "@x")
    go(env, CardinalAction.RIGHT, CardinalAction.LEFT)
    assert env.render() == picture("oo", "@x")


@pytest.mark.parametrize(("action_model", "heading"), [("rotate", NORTH), ("rotate", SOUTH), ("cardinal", NORTH)])
def test_of_two_equal_paths_others_are_shown_on_the_right_one(action_model, heading):
    """Right of the way that it looks; cardinal agents: east before west."""
    watcher, goal = (1, 2 if heading == NORTH else 0), (0 if heading == NORTH else 2, 1)
    _, observations, _ = drawn(
        "...\n.@.\n...\n",
        [watcher, (2 - goal[0], 1)],
        [NORTH, heading],
        [watcher, goal],
        action_model=action_model,
        view_size=(3, 3),
        view="centered",
        frame="map",
        channels=("others_next",),
    )
    expected = np.zeros((1, 3, 3))
    expected[0, 2 - goal[0], 1] = 1
    np.testing.assert_array_equal(observations["agent_0"], expected)


# Life cycles.


def test_nothing_ends_for_all_at_once():
    env, *_ = drawn("....\n", [(0, 0), (0, 3)], [EAST, WEST], [(0, 1), (0, 2)], max_steps=9)
    assert set(env.metrics().values()) == {0}  # before the first step
    _, _, terminations, truncations, infos = go(env, FORWARD, WAIT)
    assert not any(terminations.values())
    assert not any(truncations.values())
    assert [infos[agent]["at_goal"] for agent in env.possible_agents] == [1, 0]
    assert env.agents == env.possible_agents
    observations, rewards, terminations, truncations, infos = go(env, WAIT, FORWARD)
    assert list(terminations.values()) == [True, True]
    assert list(truncations.values()) == [False, False]
    assert [set(d) for d in (observations, rewards, infos)] == [set(env.possible_agents)] * 3
    assert env.agents == []
    assert env.metrics() == {"CSR": 1, "ISR": 1, "SoC": 3, "makespan": 2, "ep_length": 2, "SoC_ratio": 1.5}


def test_finish_takes_agents_away_one_by_one():
    env, *_ = drawn("....\n", [(0, 0), (0, 1)], [EAST, EAST], [(0, 3), (0, 2)], on_target="finish", max_steps=9)
    _, _, terminations, truncations, _ = go(env, WAIT, FORWARD)
    assert terminations == {"agent_0": False, "agent_1": True}
    assert truncations == {"agent_0": False, "agent_1": False}
    assert env.agents == ["agent_0"]
    assert env.render() == ">..x\n"
    for _ in range(2):
        observations, rewards, terminations, truncations, infos = go(env, FORWARD)
        assert [list(d) for d in (observations, rewards, terminations, truncations, infos)] == [["agent_0"]] * 5
    assert env.positions.tolist() == [[0, 2], [0, 2]]  # where agent_1 was is free
    assert env.state()[1].sum() == 1
    _, _, terminations, _, _ = go(env, FORWARD)
    assert terminations == {"agent_0": True}
    assert env.agents == []
    assert env.metrics() == {"CSR": 1, "ISR": 1, "SoC": 5, "makespan": 4, "ep_length": 2.5, "SoC_ratio": 1.25}


@pytest.mark.parametrize(
    ("resting_since", "shortest", "metrics"),
    [
        ([1, -1], [2, -1], {"CSR": 0, "ISR": 0.5, "SoC": 4, "makespan": 3, "ep_length": 3, "SoC_ratio": 2}),
        ([1, 1], [0, 0], {"CSR": 1, "ISR": 1, "SoC": 2, "makespan": 1, "ep_length": 3, "SoC_ratio": 1}),
    ],
)
def test_metrics_of_goals_out_of_reach_and_at_the_start(resting_since, shortest, metrics):
    """Sources of one's own may have such goals."""
    record = EpisodeRecord(
        "nothing", 3, 3, np.array(resting_since), np.ones(2, int), np.ones(2, int), np.array(shortest)
    )
    assert episode_metrics(record) == metrics


def test_restart_gives_new_goals_until_the_time_is_up():
    env = mapf_pz.parallel_env(
        map=np.ones((1, 2), np.bool_), num_agents=1, view_size=(1, 1), on_target="restart", max_steps=6,
        action_model="cardinal",
    )  # fmt: skip
    env.reset(seed=0)
    arrivals = []
    while env.agents:
        col, goal = env.positions[0, 1], env.goals[0, 1]
        assert col != goal
        action = CardinalAction.RIGHT if goal > col else CardinalAction.LEFT
        _, rewards, terminations, truncations, infos = env.step({"agent_0": int(action)})
        assert rewards == {"agent_0": 20}  # in `restart` mode, at each goal
        assert terminations == {"agent_0": False}
        assert truncations == {"agent_0": env.step_count == 6}
        arrivals.append(infos["agent_0"]["arrivals"])
    assert arrivals == [1, 2, 3, 4, 5, 6]
    assert env.metrics() == {"avg_throughput": 1, "ep_length": 6, "exhausted_agents": 0}


def test_the_end_of_a_given_goal_sequence_is_reported():
    starts, goals = [[0, 0], [1, 0]], [[[0, 1], [0, 0], [0, 1]], [[1, 1], [1, 0], [1, 1]]]
    scenario = Scenario(starts, goals, goal_counts=[2, 3])
    env = mapf_pz.parallel_env(
        map="..\n..\n",
        scenario=scenario,
        num_agents=2,
        on_target="restart",
        action_model="cardinal",
        max_steps=9,
        view_size=(1, 1),
    )
    env.reset(seed=0)
    seen = []
    for action in (CardinalAction.RIGHT, CardinalAction.LEFT, CardinalAction.RIGHT, CardinalAction.LEFT):
        go(env, action, action)
        seen.append((env.goals[:, 1].tolist(), env.metrics()["exhausted_agents"]))
    assert seen == [([0, 0], 0), ([1, 1], 1), ([0, 1], 2), ([1, 1], 2)]


@pytest.mark.parametrize("counts", [[1], [0, 1], [1, 4], [1, 2, 3]])
def test_goal_counts_that_are_not_of_the_goals(counts):
    with pytest.raises(ValueError, match="goal_counts: expected 2 numbers 1 to 3"):
        Scenario([[0, 0], [1, 0]], [[[0, 1], [0, 0], [0, 1]]] * 2, goal_counts=counts)


@pytest.mark.parametrize("on_target", ON_TARGET)
def test_time_limit_truncates_the_remaining_agents(on_target):
    env, *_ = drawn("....\n", [(0, 0), (0, 3)], [NORTH, WEST], [(0, 1), (0, 2)], on_target=on_target, max_steps=2)
    go(env, WAIT, FORWARD)
    finished = on_target == "finish"
    _, _, terminations, truncations, _ = env.step(dict.fromkeys(env.agents, WAIT))
    assert list(terminations) == (["agent_0"] if finished else ["agent_0", "agent_1"])
    assert not any(terminations.values())
    assert all(truncations.values())
    assert env.agents == []


@pytest.mark.parametrize("on_target", ["nothing", "finish"])
def test_agents_that_end_in_the_last_step_are_terminated_not_truncated(on_target):
    env, *_ = drawn("..\n..\n", [(0, 0), (1, 0)], [EAST, EAST], [(0, 1), (1, 1)], on_target=on_target, max_steps=1)
    _, _, terminations, truncations, _ = go(env, FORWARD, FORWARD)
    assert list(terminations.values()) == [True, True]
    assert list(truncations.values()) == [False, False]


def test_one_finishes_in_the_last_step_the_other_does_not():
    env, *_ = drawn("..\n..\n", [(0, 0), (1, 0)], [EAST, EAST], [(0, 1), (1, 1)], on_target="finish", max_steps=1)
    _, _, terminations, truncations, _ = go(env, FORWARD, WAIT)
    assert list(terminations.values()) == [True, False]
    assert list(truncations.values()) == [False, True]


@pytest.mark.parametrize("on_target", ON_TARGET)
def test_metrics_keys(on_target):
    env = mapf_pz.parallel_env(on_target=on_target)
    env.reset(seed=0)
    take(env, WAIT)
    team = {"CSR", "ISR", "SoC", "makespan", "ep_length", "SoC_ratio"}
    assert env.metrics().keys() == (
        {"avg_throughput", "ep_length", "exhausted_agents"} if on_target == "restart" else team
    )
    assert all(type(value) is float for value in env.metrics().values())


# reset(options=...).


def test_reset_to_a_scenario_and_to_an_instance():
    env = mapf_pz.parallel_env(map=np.ones((3, 3), np.bool_), num_agents=2, view_size=(1, 1))
    scenario = Scenario([(0, 0), (2, 2)], [(2, 2), (0, 0)])
    env.reset(seed=1, options={"instance": scenario})
    headings = env.headings.tolist()
    assert env.positions.tolist() == [[0, 0], [2, 2]]
    assert env.goals.tolist() == [[2, 2], [0, 0]]
    env.reset(seed=1, options={"instance": scenario})
    assert env.headings.tolist() == headings  # drawn: the seed decides
    other = Grid(np.array([[True, False, True], [True, True, True], [True, True, True]]))
    env.reset(options={"instance": Instance(other, scenario, [3, 1])})
    assert env.headings.tolist() == [3, 1]
    assert env.grid is other.free
    assert env.state()[0, 0, 1] == 1
    env.reset(seed=2)
    assert env.grid.all()
    assert env.state()[0].sum() == 0


def test_initial_headings():
    for given, expected in (("east", [0, 0, 0]), ([3, 1, 2], [3, 1, 2])):
        env = mapf_pz.parallel_env(num_agents=3, initial_heading=given)
        env.reset(seed=0)
        assert env.headings.tolist() == expected
    env = mapf_pz.parallel_env(num_agents=40)
    env.reset(seed=0)
    assert set(env.headings.tolist()) == {0, 1, 2, 3}
    env = mapf_pz.parallel_env(num_agents=3, action_model="cardinal", initial_heading=[0, 1, 2])
    env.reset(seed=0)
    assert env.headings.tolist() == [3, 3, 3]


# state().


def test_state_content():
    env, *_ = drawn(
        """
        ...
        .@.
        """,
        [(0, 0), (1, 2)],
        [EAST, NORTH],
        [(0, 2), (0, 2)],
        max_steps=4,
    )
    go(env, RIGHT, WAIT)
    obstacle, agent, sine, cosine, goal, distance, time = env.state()
    assert obstacle.tolist() == [[0, 0, 0], [0, 1, 0]]
    assert agent.tolist() == [[1, 0, 0], [0, 0, 1]]
    # Headings count clockwise from east: south has the sine 1, north -1.
    assert np.round(sine, 6).tolist() == [[1, 0, 0], [0, 0, -1]]
    assert np.round(cosine, 6).tolist() == [[0, 0, 0], [0, 0, 0]]
    assert goal.tolist() == [[0, 0, 1], [0, 0, 0]]
    assert distance == pytest.approx(np.array([[3 / 5, 0, 0], [0, 0, 1 / 5]]))
    assert (time == 0.25).all()
    assert env.state().dtype == np.float32
    assert env.state_space.contains(env.state())


def test_a_bool_is_a_number_as_in_gymnasium():
    after = []
    for action in (True, np.True_, 1, np.int8(1)):
        env = mapf_pz.parallel_env(num_agents=2)
        env.reset(seed=0)
        env.step(dict.fromkeys(env.agents, action))
        after.append(env.headings.tolist())
    assert env.action_space("agent_0").contains(True)
    assert after == after[:1] * 4
    with pytest.raises(ValueError, match=r"^action array\(\[1\]\) of 'agent_0': expected a whole number from 0 to 3$"):
        env.step(dict.fromkeys(env.agents, np.array([1])))


@pytest.mark.parametrize(
    ("make", "expected"),
    [
        (mapf_pz.parallel_env, "MapfEnv({})"),
        (mapf_pz.env, "MapfAecEnv(MapfEnv({}))"),
        (
            lambda: ContinuousActions(FlatObservations(mapf_pz.parallel_env())),
            "ContinuousActions(FlatObservations(MapfEnv({})))",
        ),
        (centralized_env, "CentralizedEnv(ContinuousActions(MapfEnv({})))"),
    ],
)
def test_repr(make, expected):
    rules = "action_model='rotate', on_target='nothing'"
    assert repr(make()) == expected.replace("{}", f"num_agents=4, map 'empty-8-8' of 8 x 8, {rules}")
    env = mapf_pz.parallel_env(source=RandomObstacles(6, 7, 0.2, 3), on_target="finish", action_model="cardinal")
    assert repr(env) == "MapfEnv(num_agents=3, maps of 6 x 7, action_model='cardinal', on_target='finish')"


# infos.


def test_infos_have_constant_keys_and_numbers():
    env = mapf_pz.parallel_env(on_target="finish", max_steps=20)
    _, infos = env.reset(seed=0)
    rng = np.random.default_rng(0)
    while True:
        for info in infos.values():
            assert list(info) == ["action_mask", "at_goal", "arrived", "blocked", "moved", "arrivals"]
            assert info["action_mask"].dtype == np.int8
            assert info["action_mask"][WAIT] == 1
            assert all(isinstance(value, (int, float)) for name, value in info.items() if name != "action_mask")
        if not env.agents:
            break
        _, _, _, _, infos = env.step({agent: int(rng.integers(4)) for agent in env.agents})


def test_infos_are_plain_dictionaries():
    """Programs written in C, such as the encoder of `json`, read a dictionary without its Python methods."""
    env = mapf_pz.parallel_env()
    env.reset(seed=0)
    _, infos = take(env, FORWARD)
    assert [type(each) for each in (infos, *infos.values())] == [dict] * 5
    written = json.loads(json.dumps(infos, default=np.ndarray.tolist))
    assert written == {agent: info | {"action_mask": info["action_mask"].tolist()} for agent, info in infos.items()}
    assert list(written) == env.possible_agents


def test_infos_keep_the_values_of_their_step():
    env = mapf_pz.parallel_env()
    env.reset(seed=0)
    _, infos = take(env, FORWARD)
    kept = copy.deepcopy(infos)
    for info in take(env, LEFT)[1].values():  # neither do steps share what a user may change
        info["action_mask"][:] = 9
        info["blocked"] = 9
    env.reset(seed=1)
    assert_same(infos, kept)


def test_infos_of_a_start_on_the_goal():
    env, _, infos = drawn("..\n", [(0, 0), (0, 1)], [EAST, EAST], [(0, 0), (0, 1)], max_steps=3)
    assert [info["at_goal"] for info in infos.values()] == [1, 1]
    _, rewards, terminations, _, infos = go(env, WAIT, WAIT)
    assert [info["arrived"] for info in infos.values()] == [1, 1]
    assert list(rewards.values()) == [20, 20]
    assert all(terminations.values())


def test_action_mask_samples():
    env, _, infos = drawn("..\n", [(0, 0)], [NORTH], [(0, 1)])
    mask = infos["agent_0"]["action_mask"]
    assert mask.tolist() == [0, 1, 1, 1]
    space = env.action_space("agent_0")
    assert isinstance(space, gymnasium.spaces.Discrete)
    assert {int(space.sample(mask)) for _ in range(50)} == {LEFT, RIGHT, WAIT}


# The report's rewards.


@pytest.mark.parametrize("pays", [False, True])
def test_the_reports_reward_table(pays):
    env, *_ = drawn(
        ".....\n", [(0, 0), (0, 4)], [EAST, WEST], [(0, 2), (0, 0)],
        reward=RewardConfig(pay_blocked_forward=pays) if pays else "report",
    )  # fmt: skip
    steps = [
        # agent_0 drives to its goal, leaves it, and comes again; agent_1 turns at the edge and drives into it.
        ((FORWARD, LEFT), (0.1, 0.01)),
        ((FORWARD, RIGHT), (20, 0.01)),  # the first arrival, in place of 0.1
        ((WAIT, WAIT), (0, 0)),  # it stays: nothing more
        ((FORWARD, LEFT), (0.1, 0.01)),
        ((LEFT, LEFT), (0.01, 0.01)),
        ((LEFT, FORWARD), (0.01, 0.1 if pays else 0)),  # against the edge of the map
        ((FORWARD, WAIT), (0.1, 0)),  # the second arrival
        ((RIGHT, RIGHT), (0.01, 0.01)),
        ((RIGHT, RIGHT), (0.01, 0.01)),
        ((FORWARD, WAIT), (0.1, 0)),
        ((FORWARD, WAIT), (0.1 if pays else 0, 0)),  # against the other agent
    ]
    for actions, expected in steps:
        _, rewards, _, _, _ = go(env, *actions)
        assert tuple(rewards.values()) == expected  # to the last digit: 0.1, not 0.10000000149011612
    assert env.render() == "x.x><\n"


def test_rewards_are_python_floats():
    env = mapf_pz.parallel_env()
    env.reset(seed=0)
    _, rewards, terminations, truncations, _ = env.step(dict.fromkeys(env.agents, WAIT))
    assert {type(value) for value in rewards.values()} == {float}
    assert {type(value) for value in (*terminations.values(), *truncations.values())} == {bool}


def test_numpy_actions_are_taken():
    env = mapf_pz.parallel_env()
    env.reset(seed=0)
    for kind in (np.int64, np.int8, np.uint8, np.array):
        env.step({agent: kind(WAIT) for agent in env.agents})
    env.step(dict.fromkeys(env.agents, Action.WAIT))


def test_actions_of_agents_that_have_left_are_ignored():
    env, *_ = drawn("....\n", [(0, 0), (0, 1)], [EAST, EAST], [(0, 3), (0, 2)], on_target="finish")
    go(env, WAIT, FORWARD)
    observations, *_ = env.step({"agent_0": WAIT, "agent_1": 99})
    assert list(observations) == ["agent_0"]


def test_without_a_render_mode_nothing_is_drawn():
    env = mapf_pz.parallel_env()
    env.reset(seed=0)
    assert env.render() is None
    env.close()


def test_spaces_hold_what_is_observed(keywords):
    env = mapf_pz.parallel_env(**keywords)
    observations, _ = env.reset(seed=0)
    for agent, observation in observations.items():
        assert env.observation_space(agent).contains(observation)
        assert env.observation_space(agent) is env.observation_space("agent_0")
        assert env.action_space(agent) is env.action_space("agent_0")


@pytest.mark.parametrize("make_copy", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
@pytest.mark.parametrize(
    "fields",
    [
        {},
        {"on_target": "restart", "features": ("action_advantage", "last_actions"), "num_frames": 2, "num_neighbors": 1},
        {"on_target": "finish", "channels": ("view", "cost_to_go", "others_next"), "edge_weights": "random"},
        {"see_through_walls": False, "view": "centered", "action_model": "cardinal", "reward": "progress"},
    ],
)
def test_a_copy_continues_the_episode_as_the_original_does(make_copy, fields):
    env = mapf_pz.parallel_env(map="empty-8-8", num_agents=5, max_steps=24, **fields)
    env.reset(seed=3)
    draw = np.random.default_rng(0)

    def step(envs):
        actions = {agent: int(draw.integers(4)) for agent in envs[0].agents}
        results = [env.step(actions) for env in envs]
        for other in results[1:]:
            assert data_equivalence(results[0], other)

    for _ in range(5):
        step([env])
    other = make_copy(env)
    while env.agents:
        step([env, other])
    assert other.agents == []
    observations = [each.reset(seed=4)[0] for each in (env, other)]
    assert data_equivalence(*observations)


@pytest.mark.parametrize("render_mode", ["ansi", "rgb_array"])
def test_delayed_agents_are_rendered(render_mode):
    instance = "....\n", [(0, 0), (0, 2)], [EAST, EAST], [(0, 1), (0, 2)]
    env, *_ = drawn(*instance, delays="1:2-2", render_mode=render_mode)
    before = env.render()
    assert not env.render_state().delayed.any()
    go(env, FORWARD, WAIT)
    assert env.render_state().delayed.tolist() == [True, True]
    if render_mode == "ansi":
        assert (before, env.render()) == (picture(">xE."), picture("zxZ."))
    else:
        bars = (env.render() != before).any(axis=2).any(axis=0).reshape(4, -1).any(axis=1)
        assert bars.tolist() == [True, False, True, False]
