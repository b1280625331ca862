"""Maps, scenarios and instances: the data of one episode.

`B` environments in a batch, `N` agents, `H x W` map. Coordinates are `(row, col)`; a cell is the number
`row * W + col`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from mapf_pz._internal.arrays import Bools, EqualByValue, Ints, frozen
from mapf_pz.instances.delays import Delays
from mapf_pz.instances.heading import Heading

ActionModel = Literal["rotate", "cardinal"]
"""Agents that turn, whose instances have headings, or agents that move in four directions."""
HeadingName = Literal["random", "east"]
"""Initial headings by name."""


@dataclass(frozen=True, eq=False)
class Grid(EqualByValue):
    """A grid map. Raises `ValueError` unless `free` is a two-dimensional, non-empty array."""

    free: Bools
    """(H, W) bool, read-only: True where an agent can stand."""
    name: str = "custom"
    """The map's name, for messages and file headers."""

    def __post_init__(self) -> None:
        """Copy the array, make the copy read-only, and check it."""
        free = frozen(self.free, np.bool_, f"map {self.name!r}")
        if free.ndim != 2 or free.size == 0:
            raise ValueError(f"map {self.name!r}: expected an array of H x W cells, got the shape {free.shape}")
        object.__setattr__(self, "free", free)

    @classmethod
    def from_array(cls, array: ArrayLike) -> Grid:
        """Return the map of a bool array (H, W), True where a cell is free; raises `TypeError` for other dtypes."""
        # Other dtypes are not converted, since 1 often means an obstacle there.
        free = np.asarray(array)
        if free.dtype != np.bool_:
            got = f"{type(array).__name__} of {free.dtype}"
            expected = "a name, a .map file, a drawing, or a bool array with True for free"
            raise TypeError(f"map: expected {expected}, got {got}")
        return cls(free)

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W)."""
        return self.free.shape[0], self.free.shape[1]


@dataclass(frozen=True, eq=False)
class Scenario(EqualByValue):
    """Starts and goals of agents. Raises `ValueError` unless the arrays have the shapes below."""

    starts: Ints
    """(M, 2) int32, [row, col]."""
    goals: Ints
    """(M, 2) int32, [row, col]; or (M, L, 2), the sequence of each agent's goals (lifelong)."""
    goal_counts: Ints | None = None
    """(M,) int32, 1 to L: the number of goals of each agent; the others are ignored. None: all L."""

    def __post_init__(self) -> None:
        """Copy the arrays, make the copies read-only, and check them."""
        starts, goals = _coordinates("starts", self.starts), _coordinates("goals", self.goals)
        if starts.ndim != 2 or starts.shape[1] != 2:
            raise ValueError(f"scenario starts: expected the shape (M, 2), got {starts.shape}")
        if goals.ndim not in (2, 3) or len(goals) != len(starts) or goals.shape[-1] != 2 or 0 in goals.shape[1:]:
            raise ValueError(
                f"scenario goals: expected the shape ({len(starts)}, 2) or ({len(starts)}, L, 2), got {goals.shape}"
            )
        object.__setattr__(self, "starts", starts)
        object.__setattr__(self, "goals", goals)
        if self.goal_counts is not None:
            counts = frozen(self.goal_counts, np.int32, "scenario goal_counts")
            most = goals.shape[1] if goals.ndim == 3 else 1
            if counts.shape != (len(starts),) or counts.min(initial=1) < 1 or counts.max(initial=1) > most:
                raise ValueError(f"scenario goal_counts: expected {len(starts)} numbers 1 to {most}")
            object.__setattr__(self, "goal_counts", counts)

    def first(self, count: int) -> Scenario:
        """Return the scenario of the first `count` agents."""
        counts = None if self.goal_counts is None else self.goal_counts[:count]
        return Scenario(self.starts[:count], self.goals[:count], counts)

    def __len__(self) -> int:
        """Return the number of agents, M."""
        return len(self.starts)


def _coordinates(name: str, values: ArrayLike) -> Ints:
    """Return a read-only int32 copy; raises `ValueError` unless the values form an array of whole numbers."""
    try:
        return frozen(values, np.int32)
    except (ValueError, TypeError):
        expected = "whole numbers [row, col] for each agent, or a sequence of them with the same length for each agent"
        raise ValueError(f"scenario {name}: expected {expected}") from None


@dataclass(frozen=True, eq=False)
class Instance(EqualByValue):
    """A MAPF instance: a map and a scenario of exactly N agents, checked against each other.

    Raises `ValueError`, naming the first agent whose start or goal is outside the map or on an obstacle, or whose start
    is also another agent's.
    """

    grid: Grid
    """The map."""
    scenario: Scenario
    """Starts and goals of the N agents."""
    headings: Ints | None = None
    """(N,) int8 initial headings; None leaves them to the environment's `initial_heading`."""
    delays: Delays | None = None
    """Delays of the agents, which an environment has unless its configuration states others."""
    start_cells: Ints = field(init=False, repr=False, compare=False)
    """(N,) int64, the numbers of the start cells, `row * W + col`."""
    goal_cells: Ints = field(init=False, repr=False, compare=False)
    """(N, L) int64, the numbers of the goal cells."""

    def __post_init__(self) -> None:
        """Check starts, goals and headings against the map."""
        starts, goals = self.scenario.starts, self.scenario.goals
        per_agent = goals.shape[1] if goals.ndim == 3 else 1
        start_cells = _cell_numbers(self.grid, "start", starts)
        goal_cells = _cell_numbers(self.grid, "goal", goals.reshape(-1, 2), per_agent)
        if len(set(start_cells.tolist())) < len(starts):
            first = np.unique(start_cells, return_index=True)[1]
            agent = int(np.setdiff1d(np.arange(len(starts)), first)[0])
            raise ValueError(f"agent {agent}: start {_position(starts[agent])} is also another agent's start")
        object.__setattr__(self, "start_cells", start_cells)
        object.__setattr__(self, "goal_cells", goal_cells.reshape(-1, per_agent))
        if self.headings is not None:
            headings = frozen(self.headings, np.int8, "headings")
            if headings.shape != (len(self.scenario),) or not np.isin(headings, list(Heading)).all():
                raise ValueError(f"headings: expected {len(self.scenario)} numbers 0 to 3, got {self.headings!r}")
            object.__setattr__(self, "headings", headings)

    @property
    def num_agents(self) -> int:
        """N, the number of agents."""
        return len(self.scenario)


def _position(cell: Ints) -> str:
    return f"[row {cell[0]}, col {cell[1]}]"


def _cell_numbers(grid: Grid, what: str, cells: Ints, per_agent: int = 1) -> Ints:
    """Return the numbers of `cells` (M, 2); raises `ValueError` for the first outside the map or on an obstacle."""
    try:
        numbers = np.ravel_multi_index((cells[:, 0], cells[:, 1]), grid.shape)
    except ValueError:
        raise ValueError(_misplaced(grid, what, cells, per_agent)) from None
    if not grid.free.ravel().take(numbers).all():
        raise ValueError(_misplaced(grid, what, cells, per_agent))
    return numbers


def _misplaced(grid: Grid, what: str, cells: Ints, per_agent: int) -> str:
    """Return a message about the first agent whose cell is not free."""
    height, width = grid.shape
    inside: Bools = np.all((cells >= 0) & (cells < np.array(grid.shape)), axis=1)
    usable = inside.copy()
    usable[inside] = grid.free[cells[inside, 0], cells[inside, 1]]
    worst = int(np.argmin(usable))
    problem = "is an obstacle" if inside[worst] else "is outside"
    place = f"{problem} of map {grid.name!r} ({height} x {width})"
    return f"agent {worst // per_agent}: {what} {_position(cells[worst])} {place}"


@runtime_checkable
class InstanceSource(Protocol):
    """A source of episodes. All instances of a source have the same map size and number of agents."""

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W) of every map."""
        ...

    @property
    def num_agents(self) -> int:
        """N of every instance."""
        ...

    @property
    def grid(self) -> Grid | None:
        """The map, if all instances have the same one, otherwise None."""
        ...

    def sample(self, rng: np.random.Generator) -> Instance:
        """Sample an instance; `rng` is the only source of randomness."""
        ...
