"""Sources of instances for the episodes of an environment."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from mapf_pz._internal.arrays import Ints
from mapf_pz.instances import generate
from mapf_pz.instances.delays import Delays
from mapf_pz.instances.instance import Grid, Instance, InstanceSource, Scenario
from mapf_pz.instances.place import check_reachable, largest_component, place_on

MAX_DRAWS = 100
"""Maximum number of maps that are sampled to find one with enough space for all agents."""


@dataclass(frozen=True)
class FixedMap:
    """Samples starts and goals in the largest component of one map in each episode.

    Raises `ValueError` if that component has fewer cells than there are agents.
    """

    grid: Grid
    """The map."""
    num_agents: int
    """N, the number of agents."""
    goals_per_agent: int = 1
    """L, the number of goals of each agent."""
    _cells: Ints = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Find the component, and check that it holds the agents."""
        object.__setattr__(self, "_cells", largest_component(self.grid.free))
        self.sample(np.random.default_rng(0))

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W)."""
        return self.grid.shape

    def sample(self, rng: np.random.Generator) -> Instance:
        """Sample starts and goals."""
        return Instance(self.grid, place_on(self._cells, self.num_agents, rng, self.goals_per_agent))


@dataclass(frozen=True)
class FixedScenario:
    """Returns the first agents of one scenario in each episode.

    Raises `ValueError` if the scenario has too few agents, does not fit the map, or has a goal that cannot be reached.
    """

    grid: Grid
    """The map."""
    scenario: Scenario
    """The scenario, whose first `num_agents` agents are used."""
    num_agents: int
    """N, the number of agents."""
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
        """Return the instance; nothing is sampled."""
        return self._instance


@dataclass(frozen=True)
class RandomMaps:
    """Samples a new map, starts and goals in each episode.

    `partial(generate.maze, 12, 12)` is a generator that can be pickled. Raises `ValueError` if no sampled map has
    enough space for the agents, or if a map has another size than the first.
    """

    generator: Callable[[np.random.Generator], Grid] = field(compare=False)
    """Function that samples a map, always of the same size."""
    num_agents: int
    """N, the number of agents."""
    goals_per_agent: int = 1
    """L, the number of goals of each agent."""
    shape: tuple[int, int] = field(init=False)
    """(H, W) of every map."""
    _generates: tuple[object, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Check the generator by sampling from it."""
        object.__setattr__(self, "_generates", _call(self.generator))
        rng = np.random.default_rng(0)
        object.__setattr__(self, "shape", self.generator(rng).shape)
        self.sample(rng)

    @property
    def grid(self) -> None:
        """None, since maps differ."""
        return

    def sample(self, rng: np.random.Generator) -> Instance:
        """Sample a map with enough space for all agents, starts and goals."""
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
    """Samples random obstacles, starts and goals in each episode; raises `ValueError` as `RandomMaps`."""

    height: int
    """H, the number of rows."""
    width: int
    """W, the number of columns."""
    density: float
    """Fraction of cells that are obstacles."""
    num_agents: int
    """N, the number of agents."""
    goals_per_agent: int = 1
    """L, the number of goals of each agent."""
    _maps: RandomMaps = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Create the source."""
        generator = partial(generate.random, self.height, self.width, self.density)
        object.__setattr__(self, "_maps", RandomMaps(generator, self.num_agents, self.goals_per_agent))

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W)."""
        return self.height, self.width

    @property
    def grid(self) -> None:
        """None, since maps differ."""
        return

    def sample(self, rng: np.random.Generator) -> Instance:
        """Sample a map with enough space for all agents, starts and goals."""
        return self._maps.sample(rng)


@dataclass(frozen=True)
class InstanceList:
    """Samples one of several instances in each episode, all equally likely.

    Raises `ValueError` if there are no instances, or if they differ in map size or number of agents.
    """

    instances: Sequence[Instance]
    """The instances."""

    def __post_init__(self) -> None:
        """Check that all instances have the same size."""
        object.__setattr__(self, "instances", tuple(self.instances))
        _check_alike("instance", [_size(instance.grid.shape, instance.num_agents) for instance in self.instances])

    @property
    def size(self) -> str:
        """Map size and number of agents of all instances, as text."""
        return _size(self.shape, self.num_agents)

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W) of every map."""
        return self.instances[0].grid.shape

    @property
    def num_agents(self) -> int:
        """N, the number of agents."""
        return self.instances[0].num_agents

    @property
    def grid(self) -> Grid | None:
        """The map that all instances share, or None."""
        grid = self.instances[0].grid
        return grid if all(instance.grid is grid for instance in self.instances) else None

    @property
    def delays(self) -> Delays | None:
        """The delays of all instances; None if there are none. Raises `ValueError` if they differ."""
        delays = self.instances[0].delays
        if any(instance.delays != delays for instance in self.instances):
            raise ValueError("delays: expected those of the environment, since the instances have different ones")
        return delays

    def sample(self, rng: np.random.Generator) -> Instance:
        """Sample one of the instances."""
        return self.instances[int(rng.integers(len(self.instances)))]


@dataclass(frozen=True)
class SourceMixture:
    """Samples one of several sources in each episode, all equally likely, and the instance from that source.

    Raises `ValueError` if there are no sources, or if they differ in map size or number of agents.
    """

    sources: Sequence[InstanceSource]
    """The sources."""

    def __post_init__(self) -> None:
        """Check that the instances of all sources have the same size."""
        object.__setattr__(self, "sources", tuple(self.sources))
        _check_alike("source", [_size(source.shape, source.num_agents) for source in self.sources])

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W) of every map."""
        return self.sources[0].shape

    @property
    def num_agents(self) -> int:
        """N, the number of agents."""
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
    """Return a generator's function and arguments, for comparison, since equal partials are different objects."""
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
