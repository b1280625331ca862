"""Plans, which hold the positions of all agents after every step, and their validation."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mapf_pz._internal.arrays import Bools, Ints, frozen
from mapf_pz.guidance.graph import GuidanceGraph
from mapf_pz.instances.heading import HEADING_STEPS
from mapf_pz.instances.instance import Grid, Instance

Kind = Literal["start", "map", "move", "turn", "vertex", "edge", "goal"]


@dataclass(frozen=True, eq=False)
class Plan:
    """A plan of T steps for N agents. Raises `ValueError` if the shapes differ from those below."""

    positions: Ints
    """(T + 1, N, 2) int32, [row, col] after each step; `positions[0]` holds the starts."""
    headings: Ints | None = None
    """(T + 1, N) int8, `Heading`s; None for cardinal agents, which have none."""

    def __post_init__(self) -> None:
        """Copy, freeze and check the arrays."""
        positions = frozen(self.positions, np.int32, "plan positions")
        if positions.ndim != 3 or positions.shape[2] != 2 or not len(positions):
            raise ValueError(f"plan positions: expected the shape (T + 1, N, 2), got {positions.shape}")
        object.__setattr__(self, "positions", positions)
        if self.headings is not None:
            headings = frozen(self.headings, np.int8, "plan headings")
            if headings.shape != positions.shape[:2]:
                raise ValueError(f"plan headings: expected the shape {positions.shape[:2]}, got {headings.shape}")
            object.__setattr__(self, "headings", headings)

    @property
    def num_steps(self) -> int:
        """Number of steps T."""
        return len(self.positions) - 1

    @property
    def num_agents(self) -> int:
        """Number of agents N."""
        return self.positions.shape[1]

    @property
    def costs(self) -> Ints:
        """(N,) int64: the step after which each agent stays on its last cell, at least 1.

        The environment notes arrivals after a step, so that an agent that never moves costs 1, as in POGEMA. By the
        definition of Stern et al., SoCS 2019, it costs 0.
        """
        return costs_of((self.positions != self.positions[-1]).any(axis=2))

    @property
    def sum_of_costs(self) -> int:
        """Sum of the agents' costs: time on the last cell afterwards costs nothing."""
        return int(self.costs.sum())

    @property
    def makespan(self) -> int:
        """The highest cost; 0 without agents."""
        return int(self.costs.max(initial=0))

    def weighted_cost(self, graph: GuidanceGraph) -> float:
        """Return the sum of the agents' costs in the weights of a guidance graph of the map.

        Each step that counts in `costs` costs the weight of the edge for a move, or that of waiting for waiting and
        turning. An agent that never moves costs one wait. The cost is `inf` if an edge of infinite weight is used.

        Raises `ValueError` for moves that are not between adjacent cells of the graph.
        """
        # An agent that never moves costs a step, even in a plan without steps.
        positions = self.positions if self.num_steps else np.repeat(self.positions, 2, axis=0)
        before, steps = positions[:-1], np.diff(positions, axis=0)
        inside = ((positions >= 0) & (positions < graph.shape)).all()
        if not inside or (np.abs(steps).sum(axis=2) > 1).any():
            raise ValueError(f"plan: expected moves between adjacent cells of a map of {graph.shape} cells")
        rows, cols = np.moveaxis(before, -1, 0)
        weights = graph.wait[rows, cols]
        for heading, step in enumerate(HEADING_STEPS):
            weights = np.where((steps == step).all(axis=2), graph.move[heading, rows, cols], weights)
        counted = np.arange(1, len(positions))[:, None] <= self.costs
        return float(np.where(counted, weights, 0).sum(dtype=np.float64))

    @property
    def num_unmoved(self) -> int:
        """Number of agents that never move."""
        return int((self.positions == self.positions[0]).all(axis=(0, 2)).sum())

    def away(self, instance: Instance) -> Bools:
        """Return which agents (N,) are not at their goals at the end. The instance has one goal for each agent."""
        return (self.positions[-1] != instance.scenario.goals).any(axis=1)


def costs_of(away: Bools) -> Ints:
    """Return each agent's cost (N,) int64; `away` (T + 1, N) tells when it is not on its last cell."""
    steps = np.arange(1, len(away) + 1)[:, None]
    return np.where(away, steps, 1).max(axis=0)


@dataclass(frozen=True)
class Violation:
    """A violation of the rules in a plan."""

    kind: Kind
    """The violated rule."""
    step: int
    """The step of the violation, 1 to T; 0 is the start. For `goal` it is the last step."""
    agents: tuple[int, ...]
    """The agents involved."""
    cells: tuple[tuple[int, int], ...]
    """The cells that the agents' step leads to."""

    def __str__(self) -> str:
        """Return a one-line description."""
        who = " and ".join(f"agent {agent}" for agent in self.agents)
        where = " and ".join(f"[row {row}, col {col}]" for row, col in self.cells)
        return f"step {self.step}: {who} at {where}: {_MEANINGS[self.kind]}"


_MEANINGS: dict[Kind, str] = {
    "start": "not the instance's start",
    "map": "an obstacle, or outside the map",
    "move": "not a move to an adjacent cell, or not straight ahead",
    "turn": "more than a quarter turn, or a turn during a move",
    "vertex": "two agents on one cell",
    "edge": "two agents swap cells",
    "goal": "not the agent's goal",
}


def validate(instance: Instance, plan: Plan) -> Violation | None:
    """Return the first violation of the rules in a plan, or None if it is legal.

    It checks the starts, obstacles, moves and turns, that no two agents share a cell or swap cells (following and
    cycles are allowed), and that every agent ends at its goal, unless the agents have several goals each.

    Raises `ValueError` if the plan and the instance differ in their numbers of agents.
    """
    _check_agents(instance, plan)
    found = [violation for check in _CHECKS if (violation := next(check(instance, plan), None)) is not None]
    return min(found, key=lambda violation: violation.step, default=None)


def violations(instance: Instance, plan: Plan) -> list[Violation]:
    """Return all violations of the rules in a plan in the order of their steps, the first of which is `validate`'s.

    If M > 2 agents share a cell, they are M - 1 violations: of the first agent with each of the others.

    Raises `ValueError` if the plan and the instance differ in their numbers of agents.
    """
    _check_agents(instance, plan)
    found = [violation for check in _CHECKS for violation in check(instance, plan)]
    return sorted(found, key=lambda violation: violation.step)


def reached(path: Ints, goals: Iterable[Ints]) -> list[int]:
    """Return the steps in which an agent reaches its goals, which it visits in order.

    A goal becomes the agent's goal in the step after the previous goal was reached. So each goal takes at least one
    step, and an agent that starts on its first goal has not reached it yet. This is the rule of the League of Robot
    Runners and of `on_target="restart"`.

    Args:
        path: (T + 1, 2), [row, col] of the agent after each step; `path[0]` is the start.
        goals: any number of cells (2,), [row, col].
    """
    steps: list[int] = []
    left = (goal.tolist() for goal in goals)
    goal = next(left, None)
    for step, cell in enumerate(path[1:].tolist(), 1):
        if cell == goal:
            steps.append(step)
            goal = next(left, None)
    return steps


def _check_agents(instance: Instance, plan: Plan) -> None:
    if plan.num_agents != instance.num_agents:
        raise ValueError(f"plan: {plan.num_agents} agents, but the instance has {instance.num_agents}")


def _starts(instance: Instance, plan: Plan) -> Iterator[Violation]:
    wrong = (plan.positions[0] != instance.scenario.starts).any(axis=1)
    if plan.headings is not None and instance.headings is not None:
        wrong |= plan.headings[0] != instance.headings
    return _marked("start", plan, wrong[None])


def _obstacles(instance: Instance, plan: Plan) -> Iterator[Violation]:
    return _marked("map", plan, ~_free(instance.grid, plan.positions))


def _moves(_: Instance, plan: Plan) -> Iterator[Violation]:
    steps = np.diff(plan.positions, axis=0)
    wrong = np.abs(steps).sum(axis=2) > 1
    if plan.headings is not None:
        ahead = HEADING_STEPS[plan.headings[:-1]]
        wrong |= (steps != ahead).any(axis=2) & (steps != 0).any(axis=2)
    return _marked("move", plan, wrong, first_step=1)


def _turns(_: Instance, plan: Plan) -> Iterator[Violation]:
    if plan.headings is None:
        return iter(())
    turns = np.diff(plan.headings, axis=0) % 4
    moved = (np.diff(plan.positions, axis=0) != 0).any(axis=2)
    return _marked("turn", plan, (turns == 2) | ((turns != 0) & moved), first_step=1)


def _vertices(instance: Instance, plan: Plan) -> Iterator[Violation]:
    for step, cells in enumerate(_cell_numbers(instance.grid, plan)):
        seen: dict[int, int] = {}
        for agent, cell in enumerate(cells.tolist()):
            first = seen.setdefault(cell, agent)
            if first != agent:
                yield Violation("vertex", step, (first, agent), (_cell(plan.positions[step, agent]),))


def _edges(instance: Instance, plan: Plan) -> Iterator[Violation]:
    numbers = _cell_numbers(instance.grid, plan)
    for step in range(1, len(numbers)):
        before, after = numbers[step - 1].tolist(), numbers[step].tolist()
        movers = np.flatnonzero(numbers[step - 1] != numbers[step]).tolist()
        by_move: defaultdict[tuple[int, int], list[int]] = defaultdict(list)
        for agent in movers:
            by_move[before[agent], after[agent]].append(agent)
        for agent in movers:
            for other in by_move.get((after[agent], before[agent]), ()):
                if agent < other:
                    cells = (_cell(plan.positions[step, agent]), _cell(plan.positions[step, other]))
                    yield Violation("edge", step, (agent, other), cells)


def _goals(instance: Instance, plan: Plan) -> Iterator[Violation]:
    if instance.scenario.goals.ndim == 3:
        return iter(())
    return _marked("goal", plan, plan.away(instance)[None], first_step=plan.num_steps)


_CHECKS: tuple[Callable[[Instance, Plan], Iterator[Violation]], ...] = (
    _starts,
    _obstacles,
    _moves,
    _turns,
    _vertices,
    _edges,
    _goals,
)
"""The checks, in the order in which violations of the same step are reported. Each yields its violations by step."""


def _marked(kind: Kind, plan: Plan, wrong: Bools, first_step: int = 0) -> Iterator[Violation]:
    """Yield the violations marked in `wrong` (steps, N), the first row of which is step `first_step`."""
    for row, agent in np.argwhere(wrong).tolist():
        step = first_step + row
        yield Violation(kind, step, (agent,), (_cell(plan.positions[step, agent]),))


def _free(grid: Grid, cells: Ints) -> Bools:
    """Return which of `cells` (..., 2) are free cells of the map."""
    inside: Bools = np.all((cells >= 0) & (cells < np.array(grid.shape)), axis=-1)
    row, col = np.moveaxis(np.where(inside[..., None], cells, 0), -1, 0)
    return inside & grid.free[row, col]


def _cell_numbers(grid: Grid, plan: Plan) -> Ints:
    """Return a number (T + 1, N) for each position, which is also unique outside the map."""
    offset = plan.positions.astype(np.int64) - plan.positions.min()
    return offset[..., 0] * (int(offset.max()) + grid.shape[1]) + offset[..., 1]


def _cell(cell: Ints) -> tuple[int, int]:
    return int(cell[0]), int(cell[1])
