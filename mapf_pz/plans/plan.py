"""A plan: where every agent is after every step, and whether that is allowed."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mapf_pz.actions import HEADING_STEPS
from mapf_pz.arrays import Bools, Ints, frozen
from mapf_pz.instance import Grid, Instance

Kind = Literal["start", "map", "move", "turn", "vertex", "edge", "goal"]


@dataclass(frozen=True, eq=False)
class Plan:
    """T steps of N agents. Raises `ValueError` unless the shapes are as said below."""

    positions: Ints
    """(T + 1, N, 2) int32, [row, col]: row 0 is where the agents start."""
    headings: Ints | None = None
    """(T + 1, N) int8, `Heading`s; None: cardinal agents, which have none."""

    def __post_init__(self) -> None:
        """Copy, freeze and check the arrays."""
        positions = frozen(self.positions, np.int32)
        if positions.ndim != 3 or positions.shape[2] != 2 or not len(positions):
            raise ValueError(f"plan positions: expected the shape (T + 1, N, 2), got {positions.shape}")
        object.__setattr__(self, "positions", positions)
        if self.headings is not None:
            headings = frozen(self.headings, np.int8)
            if headings.shape != positions.shape[:2]:
                raise ValueError(f"plan headings: expected the shape {positions.shape[:2]}, got {headings.shape}")
            object.__setattr__(self, "headings", headings)

    @property
    def num_steps(self) -> int:
        """T."""
        return len(self.positions) - 1

    @property
    def num_agents(self) -> int:
        """N."""
        return self.positions.shape[1]

    @property
    def arrivals(self) -> Ints:
        """(N,) int64: the step after which each agent rests on its last cell for good; 0 if it never leaves it."""
        away = (self.positions != self.positions[-1]).any(axis=2)
        steps = np.arange(1, len(self.positions) + 1)[:, None]
        return np.where(away, steps, 0).max(axis=0)

    @property
    def sum_of_costs(self) -> int:
        """The sum of the arrivals: what agents do on their last cells afterwards is free (Stern et al., SoCS 2019)."""
        return int(self.arrivals.sum())

    @property
    def makespan(self) -> int:
        """The latest arrival; 0 without agents."""
        return int(self.arrivals.max(initial=0))


@dataclass(frozen=True)
class Violation:
    """The first thing in a plan that is not allowed."""

    kind: Kind
    """What is wrong."""
    step: int
    """The step that does it, 1 to T; 0: the start. For `goal` the last."""
    agents: tuple[int, ...]
    """Who does it."""
    cells: tuple[tuple[int, int], ...]
    """Where: what the agents' step leads to."""

    def __str__(self) -> str:
        """Return one line for people."""
        who = " and ".join(f"agent {agent}" for agent in self.agents)
        where = " and ".join(f"[row {row}, col {col}]" for row, col in self.cells)
        return f"step {self.step}: {who} at {where}: {_MEANINGS[self.kind]}"


_MEANINGS: dict[Kind, str] = {
    "start": "not where the instance starts",
    "map": "an obstacle, or outside the map",
    "move": "not one cell further, or not straight ahead",
    "turn": "more than a quarter turn, or a turn on the move",
    "vertex": "two agents on one cell",
    "edge": "two agents change places",
    "goal": "not the agent's goal",
}


def validate(instance: Instance, plan: Plan) -> Violation | None:
    """Return the first violation of the rules in a plan, or None if it is legal.

    Checked are starts, obstacles, moves, turns, and that no two agents share a cell or change places (follow and cycle
    are allowed); at the end, that every agent is on its goal, unless the instance has several goals for each.

    Raises `ValueError` where the plan is not for as many agents as the instance.
    """
    if plan.num_agents != instance.num_agents:
        raise ValueError(f"plan: {plan.num_agents} agents, but the instance has {instance.num_agents}")
    found = [violation for check in _CHECKS if (violation := check(instance, plan)) is not None]
    return min(found, key=lambda violation: violation.step, default=None)


def reached(path: Ints, goals: Iterable[Ints]) -> list[int]:
    """Return the steps that end on one agent's goals, taken one after the other.

    A goal is the agent's from the step on that follows the one that ended on the goal before, so each takes a step at
    least, and standing on the first goal at the start is not enough: the rule of the League of Robot Runners, and of
    `on_target="restart"`.

    Args:
        path: (T + 1, 2), [row, col]: where the agent is after each step; row 0 is the start.
        goals: Any number of cells (2,), [row, col].
    """
    steps: list[int] = []
    left = (goal.tolist() for goal in goals)
    goal = next(left, None)
    for step, cell in enumerate(path[1:].tolist(), 1):
        if cell == goal:
            steps.append(step)
            goal = next(left, None)
    return steps


def _starts(instance: Instance, plan: Plan) -> Violation | None:
    wrong = (plan.positions[0] != instance.scenario.starts).any(axis=1)
    if plan.headings is not None and instance.headings is not None:
        wrong |= plan.headings[0] != instance.headings
    return _first("start", plan, wrong[None])


def _obstacles(instance: Instance, plan: Plan) -> Violation | None:
    return _first("map", plan, ~_free(instance.grid, plan.positions))


def _moves(_: Instance, plan: Plan) -> Violation | None:
    steps = np.diff(plan.positions, axis=0)
    wrong = np.abs(steps).sum(axis=2) > 1
    if plan.headings is not None:
        ahead = HEADING_STEPS[plan.headings[:-1]]
        wrong |= (steps != ahead).any(axis=2) & (steps != 0).any(axis=2)
    return _first("move", plan, wrong, first_step=1)


def _turns(_: Instance, plan: Plan) -> Violation | None:
    if plan.headings is None:
        return None
    turns = np.diff(plan.headings, axis=0) % 4
    moved = (np.diff(plan.positions, axis=0) != 0).any(axis=2)
    return _first("turn", plan, (turns == 2) | ((turns != 0) & moved), first_step=1)


def _vertices(instance: Instance, plan: Plan) -> Violation | None:
    for step, places in enumerate(_places(instance.grid, plan)):
        seen: dict[int, int] = {}
        for agent, place in enumerate(places.tolist()):
            if place in seen:
                return Violation("vertex", step, (seen[place], agent), (_cell(plan.positions[step, agent]),))
            seen[place] = agent
    return None


def _edges(instance: Instance, plan: Plan) -> Violation | None:
    places = _places(instance.grid, plan)
    for step in range(1, len(places)):
        before, after = places[step - 1], places[step]
        at = {int(place): agent for agent, place in enumerate(before)}
        for agent in np.flatnonzero(before != after).tolist():
            other = at.get(int(after[agent]))
            if other is not None and after[other] == before[agent]:
                cells = (_cell(plan.positions[step, agent]), _cell(plan.positions[step, other]))
                return Violation("edge", step, (agent, other), cells)
    return None


def _goals(instance: Instance, plan: Plan) -> Violation | None:
    goals = instance.scenario.goals
    if goals.ndim == 3:
        return None
    return _first("goal", plan, (plan.positions[-1] != goals).any(axis=1)[None], first_step=plan.num_steps)


_CHECKS: tuple[Callable[[Instance, Plan], Violation | None], ...] = (
    _starts,
    _obstacles,
    _moves,
    _turns,
    _vertices,
    _edges,
    _goals,
)
"""In the order in which violations of one step are told."""


def _first(kind: Kind, plan: Plan, wrong: Bools, first_step: int = 0) -> Violation | None:
    """Return the first violation of those marked in `wrong` (steps, N), the first row of which is `first_step`."""
    marked: list[list[int]] = np.argwhere(wrong).tolist()
    if not marked:
        return None
    row, agent = marked[0]
    step = first_step + row
    return Violation(kind, step, (agent,), (_cell(plan.positions[step, agent]),))


def _free(grid: Grid, cells: Ints) -> Bools:
    """Tell which of `cells` (..., 2) are free cells of the map."""
    inside: Bools = np.all((cells >= 0) & (cells < np.array(grid.shape)), axis=-1)
    row, col = np.moveaxis(np.where(inside[..., None], cells, 0), -1, 0)
    return inside & grid.free[row, col]


def _places(grid: Grid, plan: Plan) -> Ints:
    """Return one number for each cell (T + 1, N), different also for cells outside the map."""
    offset = plan.positions.astype(np.int64) - plan.positions.min()
    return offset[..., 0] * (int(offset.max()) + grid.shape[1]) + offset[..., 1]


def _cell(cell: Ints) -> tuple[int, int]:
    return int(cell[0]), int(cell[1])
