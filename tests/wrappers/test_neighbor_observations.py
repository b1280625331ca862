import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pettingzoo.test import parallel_api_test, parallel_seed_test

import mapf_pz
from mapf_pz.actions import Action
from mapf_pz.environment import env as aec_env
from mapf_pz.instance import Scenario
from mapf_pz.neighbors import nearest
from mapf_pz.wrappers import CentralizedEnv, ContinuousActions, FrameStack, NeighborObservations

MODES = [{}, {"features": ("goal_vector", "time"), "on_target": "finish"}, {"on_target": "restart"}]


def make(neighbors=2, radius=8, **keywords):
    return NeighborObservations(
        mapf_pz.parallel_env(**{"num_agents": 4, "max_steps": 20, **keywords}), neighbors, radius
    )


# Who the neighbors are.

MAP = """
0..1...
..2....
.......
4..3...
......5
"""  # the digits are agents
ROWS = MAP.split()
AGENTS = np.array([next((r, row.index(str(i))) for r, row in enumerate(ROWS) if str(i) in row) for i in range(6)])


def near(neighbors, radius, gone=()):
    active = ~np.isin(np.arange(6), gone)
    return nearest(AGENTS[None], active[None], neighbors, radius)[0].tolist()


def test_neighbors_on_a_drawn_map():
    assert near(3, 3) == [
        [1, 2, 4],  # 3, 3 and 3 steps away: by number; 3 is in reach, but 6 steps away
        [2, 0, 3],  # 2, 3 and 3 steps
        [1, 0, 3],  # 2, 3 and 3 steps
        [1, 2, 4],  # 3, 3 and 3 steps; 5 is 4 away
        [0, 3, 2],  # 3, 3 and 4 steps
        [3, -1, -1],  # the others are more than 3 columns or rows away
    ]


def test_the_radius_is_a_square():
    assert near(6, 2)[2] == [1, 0, 3, 4, -1, -1]
    assert near(6, 1)[2] == [1, -1, -1, -1, -1, -1]
    assert near(2, 0) == [[-1, -1]] * 6


def test_who_has_left_is_nobodys_neighbor_and_has_none():
    assert near(3, 3, gone=(1, 4)) == [[2, 3, -1], [-1] * 3, [0, 3, -1], [2, 5, 0], [-1] * 3, [3, -1, -1]]


def test_no_neighbors_asked_for():
    assert nearest(AGENTS[None], np.ones((1, 6), np.bool_), 0, 9).shape == (1, 6, 0)


def nearest_plainly(positions, active, neighbors, radius):
    """The same for one environment, in plain Python."""
    found = []
    for i, (row, col) in enumerate(positions):
        others = []
        for j, (r, c) in enumerate(positions):
            rows, cols = abs(r - row), abs(c - col)
            if i != j and active[i] and active[j] and rows <= radius and cols <= radius:
                others.append((rows + cols, j))
        found.append(([j for _, j in sorted(others)] + [-1] * neighbors)[:neighbors])
    return found


@given(st.data())
def test_neighbors_as_found_plainly(data):
    cells = st.tuples(st.integers(0, 6), st.integers(0, 6))
    num_agents = data.draw(st.integers(1, 8))
    crews = data.draw(
        st.lists(st.lists(cells, min_size=num_agents, max_size=num_agents, unique=True), min_size=1, max_size=3)
    )
    flags = st.lists(st.booleans(), min_size=num_agents, max_size=num_agents)
    active = data.draw(st.lists(flags, min_size=len(crews), max_size=len(crews)))
    neighbors, radius = data.draw(st.integers(0, 9)), data.draw(st.integers(0, 7))
    found = nearest(np.array(crews), np.array(active), neighbors, radius)
    assert found.shape == (len(crews), num_agents, neighbors)
    assert found.tolist() == [
        nearest_plainly(agents, flag, neighbors, radius) for agents, flag in zip(crews, active, strict=True)
    ]


# The wrapper.


@pytest.mark.parametrize("keywords", MODES, ids=str)
def test_parallel_api_and_seeds(keywords):
    parallel_api_test(make(**keywords), num_cycles=50)
    parallel_seed_test(lambda: make(**keywords))


def test_spaces():
    env, plain = make(), mapf_pz.parallel_env(num_agents=4).observation_space("agent_0")
    space = env.observation_space("agent_0")
    assert space is env.observation_space("agent_3") is env.observation_spaces["agent_1"]
    assert space.shape == (21, 5, 5)
    assert np.array_equal(space.low, np.concatenate([plain.low] * 3))
    both = make(features=("time", "location")).observation_space("agent_0")
    assert (both["image"].shape, both["features"].shape) == ((21, 5, 5), (21,))


def drawn(neighbors, radius, **keywords):
    """The agents of the drawn map; returns the sharing environment and the plain one."""
    free = "\n".join("." * len(row) for row in ROWS) + "\n"
    goals = AGENTS + (0, 1)
    goals[5] = (3, 6)  # it stands at the right edge
    keywords = {
        "map": free,
        "scenario": Scenario(AGENTS, goals),
        "num_agents": 6,
        "initial_heading": "east",
        "view_size": (3, 3),
        **keywords,
    }
    plain = mapf_pz.parallel_env(**keywords)
    return NeighborObservations(mapf_pz.parallel_env(**keywords), neighbors, radius), plain


def test_neighbors_observations_come_after_the_own_one():
    env, plain = drawn(3, 3, features=("location",))
    seen, alone = env.reset(seed=0)[0], plain.reset(seed=0)[0]
    for i, others in enumerate(near(3, 3)):
        for part in ("image", "features"):
            own = alone[f"agent_{i}"][part]
            theirs = [alone[f"agent_{j}"][part] if j >= 0 else np.zeros_like(own) for j in others]
            assert np.array_equal(seen[f"agent_{i}"][part], np.concatenate([own, *theirs]))


def test_agents_that_have_disappeared_are_not_observed():
    env, plain = drawn(2, 9, on_target="finish")
    for one in (env, plain):
        one.reset()
    actions = {agent: int(Action.FORWARD if agent == "agent_3" else Action.WAIT) for agent in env.agents}
    seen, alone = env.step(actions)[0], plain.step(actions)[0]
    planes = alone["agent_3"].shape[0]
    assert env.agents == ["agent_0", "agent_1", "agent_2", "agent_4", "agent_5"]
    assert np.array_equal(seen["agent_3"][:planes], alone["agent_3"])
    assert not seen["agent_3"][planes:].any()
    assert np.array_equal(seen["agent_5"], np.concatenate([alone[f"agent_{j}"] for j in (5, 1, 2)]))
    del actions["agent_3"]
    assert list(env.step(actions)[0]) == env.agents


def test_neighbors_are_there_in_the_last_observation_at_the_time_limit():
    env = make(neighbors=3, max_steps=1)
    env.reset(seed=0)
    seen = env.step(dict.fromkeys(env.agents, 0))[0]
    assert not env.agents
    assert all(seen[agent][21:].any() for agent in seen)


def test_no_neighbors_change_nothing():
    env, plain = make(neighbors=0), mapf_pz.parallel_env(num_agents=4)
    assert env.observation_space("agent_0") == plain.observation_space("agent_0")
    seen, expected = env.reset(seed=0)[0], plain.reset(seed=0)[0]
    assert all(np.array_equal(seen[agent], expected[agent]) for agent in plain.agents)


def test_all_neighbors_are_the_whole_team():
    env, plain = make(neighbors=3, radius=8), mapf_pz.parallel_env(num_agents=4)
    seen, alone = env.reset(seed=0)[0], plain.reset(seed=0)[0]
    everything = sorted(planes.tobytes() for planes in alone.values())
    for agent in seen:
        assert sorted(planes.tobytes() for planes in np.split(seen[agent], 4)) == everything


def test_other_wrappers_around_it_and_within():
    env = CentralizedEnv(FrameStack(make(), 2))
    assert env.observation_space.shape == env.reset(seed=0)[0].shape == (4 * 2 * 21, 5, 5)
    assert NeighborObservations(ContinuousActions(mapf_pz.parallel_env()), 1, 3).observation_space("agent_0").shape == (
        14,
        5,
        5,
    )


def test_wrong_arguments_are_refused():
    with pytest.raises(ValueError, match="neighbors=-1: expected a whole number, 0 or more"):
        make(neighbors=-1)
    with pytest.raises(ValueError, match="radius=-3: expected a whole number, 0 or more"):
        make(radius=-3)
    for wrong in (None, aec_env()):
        with pytest.raises(TypeError, match="env: expected a MapfEnv or a wrapper of one"):
            NeighborObservations(wrong, 1, 1)
