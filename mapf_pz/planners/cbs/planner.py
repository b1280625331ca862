"""Conflict-based search: plans with the lowest sum of costs."""

from __future__ import annotations

import heapq
from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple

import numpy as np

from mapf_pz.arrays import Ints
from mapf_pz.core.cost_lookup import num_headings
from mapf_pz.environment import MapfEnv
from mapf_pz.planners.base import PlanFollower
from mapf_pz.planners.cbs.conflicts import FIRST, RAISED, SECOND, STEP, SWAP, find_conflicts
from mapf_pz.planners.cbs.paths import ANY, FULL, NO_PATH, Agent, Others, allocate_layers, read_path, search
from mapf_pz.planners.deadline import Deadline
from mapf_pz.planners.problem import Path, Problem, starting_costs

MAX_CONFLICTS = 256
"""Maximum number of conflicts of a node among which one is chosen: the first ones."""
FIRST_ROWS = 64
"""Initial number of steps of the search of a path."""

Constraint = tuple[int, int, int]
"""The step after which an agent must not be on a cell, (step, ANY, cell), or have moved, (step, from, to)."""


class CBS(PlanFollower):
    """Finds plans with the lowest sum of costs, for both action models; for small instances.

    Conflict-based search (Sharon et al., Artificial Intelligence 219, 2015) plans each agent alone. If two paths
    collide, it continues with two problems, in which one or the other agent must not be there at that time, in the
    order of a lower bound on their costs. It chooses conflicts that raise the cost first, replaces a path where that is
    enough (Boyarski et al., IJCAI 2015), and adds to the bound the number of disjoint pairs of agents with such
    conflicts (Felner et al., ICAPS 2018). The time grows exponentially with the number of conflicts.

    The sum of costs counts steps, whatever the edge weights are; edges of infinite weight are blocked.
    """

    optimal: ClassVar[bool] = True

    def __init__(self, env: MapfEnv | None = None, seed: int = 0, time_limit: float = 1.0) -> None:
        """Create the planner.

        Args:
            env: the environment to act in, or a wrapper of it. With None, only `solve` can be used.
            seed: random seed, which has no effect.
            time_limit: time limit in seconds of each call of `act` that has to plan.
        """
        super().__init__(env, seed, time_limit, anytime=False)

    def plan(self, problem: Problem, time_limit: float) -> Path | None:
        """Return the paths with the lowest sum of costs, or None if they were not found in time.

        The search does not end by itself for agents that each can reach their goals, but not all together.
        """
        deadline = Deadline(time_limit, self.clock)
        unreachable = np.isinf(starting_costs(problem)).any()
        if unreachable or len(np.unique(problem.goals)) < len(problem.goals):
            return None
        paths = ConflictTree(problem).search(deadline)
        return None if paths is None else _joined(paths, num_headings(problem.to_go))


class AgentPath(NamedTuple):
    """An agent's path of T steps."""

    cells: Ints  # (T + 1,) int32
    headings: Ints  # (T + 1,) int8; 0 for cardinal agents
    widths: Ints  # (T + 1,) int32: number of cells that the agent's shortest paths can be on

    @property
    def cost(self) -> int:
        """T."""
        return len(self.cells) - 1


@dataclass(order=True)
class Node:
    """A node of the conflict tree: shortest paths of all agents under constraints."""

    bound: int
    """A lower bound on the sum of costs of the node's solutions."""
    num_conflicts: int
    """Number of conflicts."""
    number: int
    """Nodes of the same bound and number of conflicts are expanded in this order."""
    paths: list[AgentPath] = field(compare=False)
    """The path of each agent."""
    constraints: list[tuple[Constraint, ...]] = field(compare=False)
    """The constraints of each agent."""
    conflicts: Ints = field(compare=False)
    """(M, 5): the first conflicts."""

    @property
    def cost(self) -> int:
        """Sum of costs of the paths."""
        return sum(path.cost for path in self.paths)


class ConflictTree:
    """The best-first search over the nodes."""

    def __init__(self, problem: Problem) -> None:
        """Refer to the problem."""
        num_cells = problem.leads_to.shape[1] - 1
        blocked = np.isinf(problem.weight[:4, :num_cells])
        moves = np.where(blocked, np.arange(num_cells), problem.leads_to[:, :num_cells]).astype(np.int32)
        headings = num_headings(problem.to_go)
        starts = problem.starts * headings + problem.headings
        self._agents = [
            Agent(moves, headings, start, goal)
            for start, goal in zip(starts.tolist(), problem.goals.tolist(), strict=True)
        ]
        self._num_cells = num_cells
        self._layers = allocate_layers(FIRST_ROWS, num_cells * headings)
        self._num_nodes = 0

    def search(self, deadline: Deadline) -> list[AgentPath] | None:
        """Return the paths of the best solution, or None if it was not found in time."""
        none: list[tuple[Constraint, ...]] = [() for _ in self._agents]
        paths: list[AgentPath] = []
        for agent in range(len(self._agents)):
            path = self._plan(agent, (), paths)
            if path is None or deadline.has_passed:
                return None
            paths.append(path)
        nodes = [self._node(paths, none, 0)]
        while nodes and not deadline.has_passed:
            node = heapq.heappop(nodes)
            if not node.num_conflicts:
                return node.paths
            for child in self._expand(node, deadline):
                heapq.heappush(nodes, child)
        return None

    def _expand(self, node: Node, deadline: Deadline) -> list[Node]:
        """Return the children of a node, or the node itself with other paths that have fewer conflicts."""
        children: list[Node] = []
        conflict = node.conflicts[node.conflicts[:, RAISED].argmax()].tolist()
        for agent, constraint in _constraints(conflict, node.paths):
            constraints = node.constraints.copy()
            constraints[agent] = tuple(sorted((*constraints[agent], constraint)))
            others = [path for other, path in enumerate(node.paths) if other != agent]
            path = self._plan(agent, constraints[agent], others)
            if path is None or deadline.has_passed:
                continue
            paths = node.paths.copy()
            paths[agent] = path
            child = self._node(paths, constraints, node.bound)
            if child.cost == node.cost and child.num_conflicts < node.num_conflicts:
                paths[agent] = path._replace(widths=node.paths[agent].widths)
                return [self._node(paths, node.constraints, node.bound)]
            children.append(child)
        return children

    def _plan(self, agent: int, constraints: tuple[Constraint, ...], others: list[AgentPath]) -> AgentPath | None:
        """Return a shortest path of an agent with the fewest conflicts with other paths, or None if there is none."""
        task = self._agents[agent]
        array = np.array(constraints, np.int32).reshape(-1, 3)
        ends = [step for step, origin, cell in constraints if origin == ANY and cell == task.goal]
        avoided = _others(others, self._num_cells)
        while (cost := search(task, array, max(ends, default=-1) + 1, avoided, self._layers)) == FULL:
            rows, num_states = self._layers.conflicts.shape
            self._layers = allocate_layers(2 * rows, num_states)
        if cost == NO_PATH:
            return None
        path = AgentPath(np.empty(cost + 1, np.int32), np.empty(cost + 1, np.int8), np.empty(cost + 1, np.int32))
        read_path(task, array, self._layers, path.cells, path.headings, path.widths)
        return path

    def _node(self, paths: list[AgentPath], constraints: list[tuple[Constraint, ...]], bound: int) -> Node:
        """Return the node with these paths, whose cost is at least `bound`."""
        cells = _cells(paths)
        widths = np.ones_like(cells)  # an agent at its goal must stay there
        for agent, path in enumerate(paths):
            widths[: path.cost + 1, agent] = path.widths
        conflicts = np.empty((MAX_CONFLICTS, 5), np.int32)
        count = find_conflicts(cells, widths, conflicts)
        conflicts = conflicts[:count].copy()
        self._num_nodes += 1
        bound = max(bound, sum(path.cost for path in paths) + _num_raising_pairs(conflicts))
        return Node(bound, count, self._num_nodes, paths, constraints, conflicts)


def _constraints(conflict: list[int], paths: list[AgentPath]) -> list[tuple[int, Constraint]]:
    """Return the two agents of a conflict, each with the constraint that avoids it."""
    step, first, second = conflict[STEP], conflict[FIRST], conflict[SECOND]
    constraints: list[tuple[int, Constraint]] = []
    for agent in (first, second):
        cells = paths[agent].cells
        last = len(cells) - 1
        before = int(cells[min(step - 1, last)]) if conflict[SWAP] else ANY
        constraints.append((agent, (step, before, int(cells[min(step, last)]))))
    return constraints


def _num_raising_pairs(conflicts: Ints) -> int:
    """Return the number of pairs of agents, disjoint and chosen greedily, of which one or the other must cost more."""
    paired: set[int] = set()
    count = 0
    for first, second in conflicts[conflicts[:, RAISED] == 2][:, [FIRST, SECOND]].tolist():
        if first not in paired and second not in paired:
            paired |= {first, second}
            count += 1
    return count


def _others(paths: list[AgentPath], num_cells: int) -> Others:
    """Return the paths of other agents, as the search of a path takes them."""
    cells = _cells(paths)
    at = np.full((len(cells), num_cells), -1, np.int32)
    at[np.arange(len(cells))[:, None], cells] = np.arange(len(paths))
    return Others(cells, at)


def _cells(paths: list[AgentPath]) -> Ints:
    """Return the cell of each agent after each step, (L, N) int32."""
    return _padded([path.cells for path in paths])


def _padded(columns: list[Ints]) -> Ints:
    """Return columns as an array (L, N) int32, where L is the largest length; the last number of each is repeated."""
    table = np.empty((max(map(len, columns), default=1), len(columns)), np.int32)
    for agent, column in enumerate(columns):
        table[: len(column), agent], table[len(column) :, agent] = column, column[-1]
    return table


def _joined(paths: list[AgentPath], headings: int) -> Path:
    """Return the paths of all agents."""
    turns = headings == 4
    return Path(_cells(paths), _padded([path.headings for path in paths]).astype(np.int8) if turns else None)
