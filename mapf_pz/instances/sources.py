"""Sources of instances: where the episodes of an environment come from."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from mapf_pz.arrays import Ints
from mapf_pz.instance import Grid, Instance, InstanceSource, Scenario
from mapf_pz.instances import generate
from mapf_pz.instances.place import check_reachable, largest_component, place_on

MAX_DRAWS = 100
"""So many maps are drawn in search of one that holds all agents."""


@dataclass(frozen=True)
class FixedMap:
    """New random starts and goals on one map in each episode, all in its largest component.

    Raises `ValueError` when that has fewer cells than there are agents.
    """

    grid: Grid
    """The map."""
    num_agents: int
    """N."""
    goals_per_agent: int = 1
    """L, the goals of each agent, one after the other."""
    _cells: Ints = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Find the component, and try it once."""
        object.__setattr__(self, "_cells", largest_component(self.grid.free))
        self.sample(np.random.default_rng(0))

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W)."""
        return self.grid.shape

    def sample(self, rng: np.random.Generator) -> Instance:
        """Draw starts and goals."""
        return Instance(self.grid, place_on(self._cells, self.num_agents, rng, self.goals_per_agent))


@dataclass(frozen=True)
class FixedScenario:
    """The first agents of one scenario in each episode.

    Raises `ValueError` when the scenario has fewer agents, does not fit the map, or has a goal that cannot be reached.
    """

    grid: Grid
    """The map."""
    scenario: Scenario
    """The agents, of which the first `num_agents` are taken."""
    num_agents: int
    """N."""
    _instance: Instance = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Check the scenario against the map."""
        if not 1 <= self.num_agents <= len(self.scenario):
            raise ValueError(f"num_agents={self.num_agents}: the scenario has {len(self.scenario)} agents")
        object.__setattr__(self, "_instance", Instance(self.grid, self.scenario.first(self.num_agents)))
        check_reachable(self._instance)

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W)."""
        return self.grid.shape

    def sample(self, rng: np.random.Generator) -> Instance:
        """Return the one instance; nothing is drawn."""
        return self._instance


@dataclass(frozen=True)
class RandomMaps:
    """A new map, starts and goals in each episode.

    `partial(generate.maze, 12, 12)` is a generator that can be pickled. Raises `ValueError` when the maps' largest
    components are too small for the agents again and again, or when a map has another size than the first.
    """

    generator: Callable[[np.random.Generator], Grid] = field(compare=False)
    """Draws a map; always of the same size."""
    num_agents: int
    """N."""
    goals_per_agent: int = 1
    """L, the goals of each agent, one after the other."""
    shape: tuple[int, int] = field(init=False)
    """(H, W) of every map."""
    _generates: tuple[object, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Try the generator."""
        object.__setattr__(self, "_generates", _call(self.generator))
        rng = np.random.default_rng(0)
        object.__setattr__(self, "shape", self.generator(rng).shape)
        self.sample(rng)

    @property
    def grid(self) -> None:
        """Maps differ."""
        return

    def sample(self, rng: np.random.Generator) -> Instance:
        """Draw a map that holds all agents, starts and goals."""
        largest = 0
        for _ in range(MAX_DRAWS):
            grid = self.generator(rng)
            if grid.shape != self.shape:
                raise ValueError(f"map {grid.name!r}: expected the size {self.shape} of the first, got {grid.shape}")
            cells = largest_component(grid.free)
            if len(cells) >= self.num_agents:
                return Instance(grid, place_on(cells, self.num_agents, rng, self.goals_per_agent))
            largest = max(largest, len(cells))
        raise ValueError(
            f"{self.num_agents} agents fit on none of {MAX_DRAWS} maps: the largest component had {largest} cells"
        )


@dataclass(frozen=True)
class RandomObstacles:
    """A new map of random obstacles, starts and goals in each episode; raises `ValueError` as `RandomMaps` does."""

    height: int
    """H."""
    width: int
    """W."""
    density: float
    """Share of cells that are obstacles."""
    num_agents: int
    """N."""
    goals_per_agent: int = 1
    """L, the goals of each agent, one after the other."""
    _maps: RandomMaps = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Make the source."""
        generator = partial(generate.random, self.height, self.width, self.density)
        object.__setattr__(self, "_maps", RandomMaps(generator, self.num_agents, self.goals_per_agent))

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W)."""
        return self.height, self.width

    @property
    def grid(self) -> None:
        """Maps differ."""
        return

    def sample(self, rng: np.random.Generator) -> Instance:
        """Draw a map that holds all agents, starts and goals."""
        return self._maps.sample(rng)


@dataclass(frozen=True)
class InstanceList:
    """One of some instances in each episode, each as likely as the others.

    Raises `ValueError` when there are none, or when they differ in map size or number of agents.
    """

    instances: Sequence[Instance]
    """The instances."""

    def __post_init__(self) -> None:
        """Check that one environment can hold all of them."""
        object.__setattr__(self, "instances", tuple(self.instances))
        _check_alike("instance", [_size(instance.grid.shape, instance.num_agents) for instance in self.instances])

    @property
    def size(self) -> str:
        """Map size and number of agents, which all instances share."""
        return _size(self.shape, self.num_agents)

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W) of every map."""
        return self.instances[0].grid.shape

    @property
    def num_agents(self) -> int:
        """N."""
        return self.instances[0].num_agents

    @property
    def grid(self) -> Grid | None:
        """The map that all instances share, or None."""
        grid = self.instances[0].grid
        return grid if all(instance.grid is grid for instance in self.instances) else None

    def sample(self, rng: np.random.Generator) -> Instance:
        """Draw one of the instances."""
        return self.instances[int(rng.integers(len(self.instances)))]


@dataclass(frozen=True)
class SourceMixture:
    """Samples one of several sources in each episode, all equally likely, and the instance from that source.

    Raises `ValueError` if there are no sources, or if they differ in map size or number of agents.
    """

    sources: Sequence[InstanceSource]
    """The sources."""

    def __post_init__(self) -> None:
        """Check that one environment can hold the instances of all sources."""
        object.__setattr__(self, "sources", tuple(self.sources))
        _check_alike("source", [_size(source.shape, source.num_agents) for source in self.sources])

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W) of every map."""
        return self.sources[0].shape

    @property
    def num_agents(self) -> int:
        """N."""
        return self.sources[0].num_agents

    @property
    def grid(self) -> Grid | None:
        """The map that all sources share, or None."""
        grid = self.sources[0].grid
        return grid if all(source.grid is grid for source in self.sources) else None

    def sample(self, rng: np.random.Generator) -> Instance:
        """Sample a source, and an instance from it."""
        return self.sources[int(rng.integers(len(self.sources)))].sample(rng)


def _call(generator: Callable[[np.random.Generator], Grid]) -> tuple[object, ...]:
    """Return what a generator calls and with which arguments: equal partials are different objects."""
    if not isinstance(generator, partial):
        return (generator,)
    return generator.func, generator.args, tuple(sorted(generator.keywords.items()))


def _size(shape: tuple[int, int], num_agents: int) -> str:
    return f"a {shape[0]} x {shape[1]} map, {num_agents} agents"


def _check_alike(name: str, sizes: list[str]) -> None:
    """Raise `ValueError` unless all items called `name` have the same size."""
    if not sizes:
        raise ValueError(f"{name}s: expected at least one, got none")
    for index, size in enumerate(sizes):
        if size != sizes[0]:
            raise ValueError(f"{name} {index}: expected {sizes[0]} as {name} 0, got {size}")
