import networkx as nx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from mapf_pz.instances import components, largest_component, place, place_on
from mapf_pz.instances.instance import Grid

FREE = hnp.arrays(np.bool_, hnp.array_shapes(min_dims=2, max_dims=2, max_side=9))


def rng(seed=0):
    return np.random.default_rng(seed)


def cells_of(count):
    return np.stack([np.arange(count) // 4, np.arange(count) % 4], axis=1).astype(np.int32)


def graph_components(free):
    graph = nx.grid_2d_graph(*free.shape)
    graph.remove_nodes_from(map(tuple, np.argwhere(~free).tolist()))
    return {frozenset(cells) for cells in nx.connected_components(graph)}


@given(FREE)
def test_components_are_those_of_the_graph(free):
    labels = components(free)
    assert labels.dtype == np.int32
    assert np.array_equal(labels == -1, ~free)
    parts = [np.argwhere(labels == label).tolist() for label in range(labels.max() + 1)]
    assert {frozenset(map(tuple, part)) for part in parts} == graph_components(free)
    largest = {tuple(cell) for cell in largest_component(free).tolist()}
    assert len(largest) == max(map(len, graph_components(free)), default=0)
    assert largest in graph_components(free) or not free.any()


def test_corners_do_not_join():
    assert components(np.eye(2, dtype=np.bool_)).tolist() == [[0, -1], [-1, 1]]


def test_components_of_a_large_map_and_of_a_view():
    free = rng().random((300, 200)) < 0.7
    assert components(free).max() + 1 == len(graph_components(free))
    assert np.array_equal(components(free[::2, ::-1]), components(free[::2, ::-1].copy()))


def test_place_draws_in_the_largest_component():
    grid = Grid([[True, True, False, True], [True, True, False, True]])
    for seed in range(30):
        scenario = place(grid, 3, rng(seed))
        assert scenario.starts.shape == scenario.goals.shape == (3, 2)
        assert scenario.starts.max() <= 1
        assert scenario.goals.max() <= 1


@given(st.integers(1, 12), st.data())
def test_starts_and_goals_differ(size, data):
    num_agents = data.draw(st.integers(1, size))
    scenario = place_on(cells_of(size), num_agents, rng(data.draw(st.integers(0, 1000))))
    assert len(np.unique(scenario.starts, axis=0)) == num_agents
    assert len(np.unique(scenario.goals, axis=0)) == num_agents
    assert size == 1 or (scenario.starts != scenario.goals).any(axis=1).all()


@given(st.integers(1, 12), st.integers(2, 7), st.data())
def test_an_agents_next_goal_is_another_cell(size, length, data):
    num_agents = data.draw(st.integers(1, size))
    scenario = place_on(cells_of(size), num_agents, rng(data.draw(st.integers(0, 1000))), length)
    assert scenario.goals.shape == (num_agents, length, 2)
    assert len(np.unique(scenario.starts, axis=0)) == num_agents
    if size == 1:
        return
    route = np.concatenate([scenario.starts[:, None], scenario.goals], axis=1)
    assert (route[:, 1:] != route[:, :-1]).any(axis=2).all()
    if size > 2 or length % 2 == 0:
        assert (scenario.goals[:, 0] != scenario.goals[:, -1]).any(axis=1).all()


def test_all_cells_are_drawn_alike():
    cells, generator = cells_of(5), rng()
    scenarios = [place_on(cells, 2, generator, length) for length in (1, 4) for _ in range(3000)]
    for picked in (
        np.concatenate([s.starts for s in scenarios]),
        np.concatenate([s.goals for s in scenarios[:3000]]),
        np.concatenate([s.goals[:, 0] for s in scenarios[3000:]]),
        np.concatenate([s.goals[:, -1] for s in scenarios[3000:]]),
    ):
        share = np.bincount(picked @ np.array([4, 1]), minlength=5) / len(picked)
        assert share == pytest.approx([0.2] * 5, abs=0.025)


@pytest.mark.parametrize("length", [1, 3])
def test_the_seed_alone_decides(length):
    grid = Grid(np.ones((6, 6), np.bool_))
    first, again, other = (place(grid, 5, rng(seed), length) for seed in (1, 1, 2))
    assert np.array_equal(first.starts, again.starts)
    assert np.array_equal(first.goals, again.goals)
    assert not np.array_equal(first.goals, other.goals)


@pytest.mark.parametrize(
    ("num_agents", "length", "message"),
    [
        (3, 1, "^3 agents do not fit on the 2 cells of the map's largest component$"),
        (0, 1, "num_agents=0"),
        (1, 0, "goals_per_agent=0"),
    ],
)
def test_invalid_numbers_are_refused(num_agents, length, message):
    with pytest.raises(ValueError, match=message):
        place(Grid([[True, True, False, True]]), num_agents, rng(), length)


def test_a_map_without_free_cells():
    with pytest.raises(ValueError, match="1 agents do not fit on the 0 cells"):
        place(Grid([[False]]), 1, rng())
