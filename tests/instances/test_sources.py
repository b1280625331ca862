import pickle
from functools import partial

import numpy as np
import pytest

import mapf_pz
from mapf_pz.instances import (
    FixedMap,
    FixedScenario,
    InstanceList,
    RandomMaps,
    RandomObstacles,
    SourceMixture,
    components,
    generate,
    place,
)
from mapf_pz.instances.instance import Grid, Instance, InstanceSource, Scenario

GRID = generate.empty(5, 6)
SCENARIO = Scenario([[0, 0], [1, 1], [2, 2]], [[4, 4], [3, 3], [0, 5]])


def rng(seed=0):
    return np.random.default_rng(seed)


def instance(grid=GRID, num_agents=3, goals_per_agent=1):
    return Instance(grid, place(grid, num_agents, rng(), goals_per_agent))


SOURCES = {
    "fixed map": FixedMap(GRID, 3),
    "fixed map, many goals": FixedMap(GRID, 3, goals_per_agent=4),
    "fixed scenario": FixedScenario(GRID, SCENARIO, 3),
    "random obstacles": RandomObstacles(5, 6, 0.2, 3),
    "random obstacles, many goals": RandomObstacles(5, 6, 0.2, 3, goals_per_agent=4),
    "mazes": RandomMaps(partial(generate.maze, 5, 6), 3),
    "rooms": RandomMaps(partial(generate.room, 5, 6, size=3), 3),
    "list": InstanceList([instance(), instance()]),
    "mixture": SourceMixture([FixedMap(GRID, 3), RandomObstacles(5, 6, 0.2, 3)]),
}


@pytest.mark.parametrize("source", SOURCES.values(), ids=SOURCES)
def test_every_source(source):
    assert isinstance(source, InstanceSource)
    assert (source.shape, source.num_agents) == ((5, 6), 3)
    copied = pickle.loads(pickle.dumps(source))
    for seed in range(5):
        drawn, again = source.sample(rng(seed)), copied.sample(rng(seed))
        assert (drawn.grid.shape, drawn.num_agents) == ((5, 6), 3)
        assert source.grid is None or drawn.grid is source.grid
        assert np.array_equal(drawn.grid.free, again.grid.free)
        assert np.array_equal(drawn.scenario.starts, again.scenario.starts)
        assert np.array_equal(drawn.scenario.goals, again.scenario.goals)
        if getattr(source, "goals_per_agent", 1) > 1:
            assert drawn.scenario.goals.shape == (3, 4, 2)


@pytest.mark.parametrize("name", ["fixed map", "random obstacles", "mazes", "rooms"])
def test_episodes_differ(name):
    generator = rng()
    starts = {SOURCES[name].sample(generator).scenario.starts.tobytes() for _ in range(10)}
    assert len(starts) > 5


def test_random_maps_are_new_ones():
    source, generator = RandomObstacles(5, 6, 0.2, 3), rng()
    maps = {source.sample(generator).grid.free.tobytes() for _ in range(10)}
    assert len(maps) > 5
    assert source.grid is None
    assert all(np.frombuffer(free, np.bool_).sum() == 24 for free in maps)


def test_random_maps_hold_all_agents():
    source = RandomMaps(partial(generate.random, 4, 4, 0.4), num_agents=8)
    for seed in range(30):
        drawn = source.sample(rng(seed))
        labels = components(drawn.grid.free)[tuple(drawn.scenario.starts.T)]
        assert np.unique(labels).size == 1


class TooSmallMaps:
    """Generates `remaining` maps of one free cell, then an empty one."""

    remaining = 0

    def __call__(self, generator):
        self.remaining -= 1
        return generate.empty(2, 2) if self.remaining < 0 else Grid([[True, False], [False, False]])


def test_random_maps_are_generated_a_hundred_times():
    maps = TooSmallMaps()
    source = RandomMaps(maps, num_agents=2)
    maps.remaining = 99
    assert source.sample(rng()).grid.free.all()
    maps.remaining = 100
    with pytest.raises(ValueError, match="2 agents fit on none of 100 maps: the largest component had 1 cells"):
        source.sample(rng())
    assert maps.remaining == 0


def test_a_fixed_scenario_gives_its_first_agents():
    source = FixedScenario(GRID, SCENARIO, 2)
    assert source.sample(rng()).scenario.starts.tolist() == [[0, 0], [1, 1]]
    assert source.sample(rng()).scenario.goals.tolist() == [[4, 4], [3, 3]]
    assert source.grid is GRID


def test_a_list_gives_each_instance():
    first, second = instance(), instance()
    source, generator = InstanceList([first, second]), rng()
    drawn = [source.sample(generator) for _ in range(400)]
    assert 140 < sum(d is first for d in drawn) < 260
    assert all(d is first or d is second for d in drawn)
    assert source.grid is GRID
    assert InstanceList([first, instance(Grid(GRID.free))]).grid is None


def test_a_mixture_samples_each_source():
    part = FixedMap(GRID, 3)
    source, generator = SourceMixture([part, RandomObstacles(5, 6, 0.2, 3), part]), rng()
    drawn = [source.sample(generator).grid for _ in range(400)]
    assert 220 < sum(grid is GRID for grid in drawn) < 310
    assert source.grid is None
    assert SourceMixture([part, FixedMap(GRID, 3, goals_per_agent=2)]).grid is GRID


def test_instances_of_a_list_may_have_different_numbers_of_goals():
    env = mapf_pz.parallel_env(
        source=InstanceList([instance(), instance(goals_per_agent=4)]), on_target="restart", max_steps=9
    )
    for seed in range(6):
        env.reset(seed=seed)
        assert env.goals.tolist() == instance(goals_per_agent=4).scenario.goals[:, 0].tolist() or (
            env.goals.tolist() == instance().scenario.goals.tolist()
        )


def changing_size(generator):
    return generate.empty(2, int(generator.integers(2, 9)))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: FixedMap(GRID, 31), "31 agents do not fit on the 30 cells"),
        (lambda: FixedMap(GRID, 0), "num_agents=0"),
        (lambda: FixedScenario(GRID, SCENARIO, 4), "num_agents=4: the scenario has 3 agents"),
        (lambda: FixedScenario(GRID, SCENARIO, 0), "num_agents=0"),
        (lambda: FixedScenario(generate.empty(4, 4), SCENARIO, 3), "agent 0: goal"),
        (
            lambda: RandomObstacles(3, 3, 0.5, 6),
            "6 agents fit on none of 100 maps: the largest component had [2-5] cells",
        ),
        (lambda: RandomObstacles(3, 3, 1.5, 6), "density"),
        (lambda: RandomMaps(changing_size, 2).sample(rng(3)), "expected the size"),
        (lambda: InstanceList([]), "expected at least one"),
        (
            lambda: InstanceList([instance(), instance(generate.empty(6, 5))]),
            "instance 1: expected a 5 x 6 map, 3 agents",
        ),
        (lambda: InstanceList([instance(), instance(num_agents=2)]), "got a 5 x 6 map, 2 agents"),
        (lambda: SourceMixture([]), "sources: expected at least one"),
        (
            lambda: SourceMixture([FixedMap(GRID, 3), FixedMap(GRID, 2)]),
            "source 1: expected a 5 x 6 map, 3 agents as source 0, got a 5 x 6 map, 2 agents",
        ),
        (lambda: SourceMixture([FixedMap(GRID, 3), RandomObstacles(6, 5, 0.1, 3)]), "source 1: .* a 6 x 5 map"),
    ],
)
def test_impossible_values_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
