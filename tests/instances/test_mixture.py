import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mapf_pz
from mapf_pz.instances import MapMixture, RandomObstacles, components, load_map, write_map
from mapf_pz.instances.instance import Grid, InstanceSource

FAMILIES = ("random", "walls", "maze", "primal2", "room", "warehouse")
NAMED = ("empty-8-8", "maze-13-13-1", "room-16-16-4")


def rng(seed=0):
    return np.random.default_rng(seed)


def ranges(least, most):
    """Generate a number, or a range of numbers."""
    number = st.integers(least, most)
    return number | st.tuples(number, number).map(lambda ends: tuple(sorted(ends)))


@st.composite
def mixtures(draw):
    return MapMixture(
        maps=tuple(draw(st.lists(st.sampled_from(FAMILIES + NAMED), min_size=1, max_size=5))),
        height=draw(ranges(8, 18)),
        width=draw(ranges(9, 18)),
        density=draw(st.just(0.2) | st.tuples(st.floats(0, 0.1), st.floats(0.1, 0.3))),
        corridor=draw(ranges(1, 2)),
        room_size=draw(ranges(3, 6)),
        shelf_length=draw(ranges(1, 3)),
    )


def most(value):
    return value if isinstance(value, int) else value[1]


@settings(max_examples=60, deadline=None)
@given(mixtures(), st.integers(1, 8), st.integers(1, 3), st.integers(0, 100))
def test_every_instance_is_valid(mixture, num_agents, goals_per_agent, seed):
    source = mixture.source(num_agents, goals_per_agent)
    assert isinstance(source, InstanceSource)
    shapes = [load_map(name).shape for name in mixture.maps if name in NAMED]
    if set(mixture.maps) & set(FAMILIES):
        shapes.append((most(mixture.height), most(mixture.width)))
    assert (source.shape, source.num_agents) == (tuple(map(max, zip(*shapes, strict=True))), num_agents)
    copied = pickle.loads(pickle.dumps(source))
    assert copied == source
    one, two = rng(seed), rng(seed)
    for _ in range(3):
        drawn = source.sample(one)
        assert drawn == copied.sample(two)
        assert (drawn.grid.shape, drawn.num_agents) == (source.shape, num_agents)
        starts, goals = drawn.scenario.starts, drawn.scenario.goals.reshape(num_agents, goals_per_agent, 2)
        labels = components(drawn.grid.free)
        assert len({tuple(start) for start in starts.tolist()}) == num_agents
        used = np.concatenate([starts[:, None], goals], axis=1)
        assert len(set(labels[used[..., 0], used[..., 1]].ravel())) == 1
        assert drawn.grid.free[used[..., 0], used[..., 1]].all()
        if goals_per_agent == 1:
            assert len({tuple(goal) for goal in goals[:, 0].tolist()}) == num_agents


def test_all_maps_occur_equally_often():
    source = MapMixture(maps=(*FAMILIES, "empty-8-8", "empty-8-8"), height=(8, 12), width=(9, 12)).source(3)
    generator = rng()
    names = [source.sample(generator).grid.name.split("-")[0] for _ in range(1600)]
    counts = {name: names.count(name) for name in (*FAMILIES, "empty")}
    assert all(150 < counts[name] < 250 for name in FAMILIES)
    assert 340 < counts["empty"] < 460


def test_sizes_and_densities_cover_their_ranges():
    mixture = MapMixture(height=(5, 7), width=(8, 10), density=(0.1, 0.4))
    source, generator = mixture.source(2), rng()
    names = [source.sample(generator).grid.name for _ in range(400)]
    heights, widths, percents = (set(map(int, part)) for part in zip(*(n.split("-")[1:] for n in names), strict=True))
    assert (heights, widths) == ({5, 6, 7}, {8, 9, 10})
    assert (min(percents), max(percents)) == (10, 40)


def test_smaller_maps_are_in_the_upper_left_corner_of_a_canvas():
    source = MapMixture(maps=("empty-8-8", "maze"), height=10, width=9).source(3)
    generator = rng()
    grids = [source.sample(generator).grid for _ in range(20)]
    (empty,) = {grid for grid in grids if grid.name == "empty-8-8"}
    assert empty.shape == (10, 9)
    assert empty.free[:8, :8].all()
    assert empty.free.sum() == 64


def test_warehouses_have_as_many_shelves_as_fit():
    names = []
    for height, width in ((6, 9), (8, 14), (9, 15), (12, 14)):
        grid = MapMixture(maps=("warehouse",), height=height, width=width).source(2).sample(rng()).grid
        assert grid.shape == (height, width)
        names.append(grid.name)
    assert names == ["warehouse-1-1-5-2-1", "warehouse-1-1-5-2-1", "warehouse-2-2-5-2-1", "warehouse-1-3-5-2-1"]


def test_a_map_file_is_mixed_with_others(tmp_path):
    write_map(Grid(np.ones((3, 14), np.bool_)), tmp_path / "hall.map")
    source = MapMixture(maps=(str(tmp_path / "hall.map"), "random")).source(4)
    assert source.shape == (12, 14)


def test_fixed_random_maps_are_those_of_random_obstacles():
    mixed, plain = MapMixture(height=7, width=8, density=0.2).source(5), RandomObstacles(7, 8, 0.2, 5)
    assert [mixed.sample(rng(seed)) for seed in range(5)] == [plain.sample(rng(seed)) for seed in range(5)]


def test_an_environment_with_a_mixture():
    source = MapMixture(maps=FAMILIES, height=(8, 12), width=(9, 12)).source(6)
    env = mapf_pz.parallel_env(source=source, max_steps=5)
    maps = set()
    for seed in range(40):
        env.reset(seed=seed)
        maps.add(env.simulator.grid(0).name.split("-")[0])
    assert maps == set(FAMILIES)


def test_lists_are_equal_to_tuples():
    assert MapMixture(maps=["maze"], height=[5, 6]) == MapMixture(maps=("maze",), height=(5, 6))


@pytest.mark.parametrize(
    ("fields", "num_agents", "message"),
    [
        ({"maps": ("maze",), "height": 1}, 1, "height=1: expected 2 or more for maps='maze'"),
        ({"maps": ("warehouse",), "height": (5, 20)}, 1, "height=(5, 20): expected 6 or more for maps='warehouse'"),
        ({"maps": ("warehouse",), "corridor": (1, 3)}, 1, "width=12: expected 13 or more for maps='warehouse'"),
        (
            {"maps": ("maze",), "corridor": 2**63},
            1,
            "corridor=9223372036854775808: expected a whole number from 1 to 1073741824, or",
        ),
        (
            {"maps": ("room",), "room_size": (2, 2**63)},
            1,
            "room_size=(2, 9223372036854775808): expected a whole number from 2 to 1073741824, or",
        ),
        ({"maps": ("random", "empty-8-8")}, 65, "maps: 'empty-8-8': 65 agents do not fit on the 64 cells"),
        (
            {"maps": ("empty-16-16", "maze"), "height": 5, "width": 5},
            9,
            "maps: 'maze': 9 agents fit on none of 100 maps",
        ),
        ({"maps": ("mase",)}, 2, "no .map file is named 'mase'"),
    ],
)
def test_impossible_values_are_refused(fields, num_agents, message):
    with pytest.raises(ValueError) as caught:  # noqa: PT011
        MapMixture(**fields).source(num_agents)
    assert str(caught.value).startswith(message)
    assert "\n" not in str(caught.value)


def test_a_problem_file_is_not_a_map(tmp_path):
    (tmp_path / "problem.json").write_text('{"mapFile": "a.map"}')
    with pytest.raises(ValueError, match=r"problem\.json: expected a map with the member 'layout'; a problem's"):
        MapMixture(maps=(str(tmp_path / "problem.json"),)).source(2)
