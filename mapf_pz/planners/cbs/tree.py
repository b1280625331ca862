"""The conflict tree: a best-first search over the constraints of groups of agents."""

from __future__ import annotations

import heapq
from collections import Counter
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from mapf_pz._internal.arrays import Ints
from mapf_pz.planners.cbs.conflicts import FIRST, RAISED, SECOND, STEP, SWAP, find_conflicts
from mapf_pz.planners.cbs.joint import Group, JointSearch, distances
from mapf_pz.planners.cbs.paths import (
    ANY,
    FULL,
    NO_PATH,
    UNREACHED,
    Agent,
    Others,
    allocate_layers,
    last_on_goal,
    read_path,
    search,
)
from mapf_pz.planners.deadline import Deadline
from mapf_pz.planners.problem import Problem
from mapf_pz.simulator.kernels.cost_lookup import num_headings

MAX_CONFLICTS = 256
"""Maximum number of conflicts of a node among which one is chosen: the first ones."""
MERGE_AFTER = 32
"""Two groups are merged after more conflicts between them than this have been chosen."""
FIRST_ROWS = 64
"""Initial number of steps of the search of a path."""
WIDE = 2
"""A number of cells for paths of which it is not computed: more than 1."""

Constraint = tuple[int, int, int]
"""The step after which an agent must not be on a cell, (step, ANY, cell), or have moved, (step, from, to)."""
Paths = dict[int, "AgentPath"]
"""The paths of agents by their numbers."""


class AgentPath(NamedTuple):
    """An agent's path of T steps."""

    cells: Ints  # (T + 1,) int32
    headings: Ints  # (T + 1,) int8; 0 for cardinal agents
    widths: Ints  # (T + 1,) int32: number of cells that the agent's shortest paths can be on
    end_width: (
        int  # the same at each later step: 1, since the agent stays at its goal, unless other agents share its group
    )

    @property
    def num_steps(self) -> int:
        """T."""
        return len(self.cells) - 1

    @property
    def cost(self) -> int:
        """The cost, as in `Plan.costs`. An agent that disappears does so after this step."""
        return max(self.num_steps, 1)


@dataclass(order=True)
class Node:
    """A node of the conflict tree: shortest paths of all groups under constraints."""

    bound: int
    """A lower bound on the sum of costs of the node's solutions."""
    num_conflicts: int
    """Number of conflicts."""
    number: int
    """Nodes of the same bound and number of conflicts are expanded in this order."""
    paths: list[AgentPath] = field(compare=False)
    """The path of each agent."""
    constraints: list[tuple[Constraint, ...]] = field(compare=False)
    """The constraints of each group."""
    conflicts: Ints = field(compare=False)
    """(M, 5): the first conflicts."""

    @property
    def cost(self) -> int:
        """Sum of costs of the paths."""
        return sum(path.cost for path in self.paths)


class ConflictTree:
    """The search for the paths of all agents with the lowest sum of costs.

    The agents of a group are planned together. At first each agent is a group. Two groups with many conflicts are
    merged, and the search starts again: Boyarski et al., IJCAI 2015. So it ends, also if there is no solution.
    """

    def __init__(self, problem: Problem, groups: list[tuple[int, ...]] | None = None) -> None:
        """Refer to the problem; `groups` are the agents of each group to begin with, by default one agent each."""
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
        self._disappear = problem.disappear
        self._layers = allocate_layers(FIRST_ROWS, num_cells * headings)
        self._num_nodes = 0
        self._was_cut = False
        self._split_into(groups or [(agent,) for agent in range(len(self._agents))])

    def _split_into(self, groups: list[tuple[int, ...]]) -> None:
        """Set the groups, which have no conflicts yet."""
        self._groups = groups
        self._group_of = {agent: number for number, group in enumerate(groups) for agent in group}
        self._num_conflicts: Counter[tuple[int, int]] = Counter()

    def search(self, deadline: Deadline) -> list[AgentPath] | None:
        """Return the paths of the best solution, or None if there is none, or if it was not found in time or memory."""
        root = self._root(deadline)
        nodes = [] if root is None else [root]
        while nodes and not deadline.has_passed:
            # The high level of CBS (Sharon et al. 2015): no other node has a lower bound, so a node without conflicts
            # is optimal.
            node = heapq.heappop(nodes)
            if not node.num_conflicts:
                return node.paths
            # Cardinal conflicts first, which raise the cost of both children, then those that raise that of one (ICBS,
            # Boyarski et al., IJCAI 2015). Of these, `argmax` takes the earliest conflict.
            conflict = node.conflicts[node.conflicts[:, RAISED].argmax()].tolist()
            if self._merges(conflict):
                # Merge and restart (ICBS): the paths of the merged agents no longer need most of the constraints that
                # were found.
                root = self._root(deadline)
                nodes = [] if root is None else [root]
                continue
            for child in self._expand(node, conflict, deadline):
                heapq.heappush(nodes, child)
        self._was_cut |= bool(nodes)
        return None

    @property
    def is_exhausted(self) -> bool:
        """Whether a search without a result was not cut by a limit, so that there is no solution."""
        return not self._was_cut

    def _root(self, deadline: Deadline) -> Node | None:
        """Return the node without constraints, or None if there is none, or if the deadline has passed."""
        paths: Paths = {}
        for number in range(len(self._groups)):
            found = self._plan(number, (), list(paths.values()), deadline)
            if found is None:
                return None
            paths |= found
        none: list[tuple[Constraint, ...]] = [() for _ in self._groups]
        return self._node([paths[agent] for agent in range(len(self._agents))], none, 0)

    def _merges(self, conflict: list[int]) -> bool:
        """Count a conflict between two groups; return whether they are now merged."""
        pair = sorted((self._group_of[conflict[FIRST]], self._group_of[conflict[SECOND]]))
        one, other = pair
        self._num_conflicts[one, other] += 1
        if self._num_conflicts[one, other] <= MERGE_AFTER:
            return False
        rest = [group for number, group in enumerate(self._groups) if number not in pair]
        self._split_into([*rest, self._groups[one] + self._groups[other]])
        return True

    def _expand(self, node: Node, conflict: list[int], deadline: Deadline) -> list[Node]:
        """Return the children of a node, or the node itself with other paths that have fewer conflicts."""
        children: list[Node] = []
        # Every solution satisfies one of the two constraints, so no solution is lost by the split (Sharon et al. 2015).
        # Only the group with the new constraint is planned again.
        for agent, constraint in _constraints(conflict, node.paths):
            number = self._group_of[agent]
            constraints = node.constraints.copy()
            constraints[number] = tuple(sorted((*constraints[number], constraint)))
            others = [path for other, path in enumerate(node.paths) if self._group_of[other] != number]
            found = self._plan(number, constraints[number], others, deadline)
            if found is None:
                continue
            paths = [found.get(other, path) for other, path in enumerate(node.paths)]
            child = self._node(paths, constraints, node.bound)
            # A bypass (Boyarski et al., *Don't Split, Try to Work It Out*, ICAPS 2015): the child's path is as cheap,
            # and also valid without the new constraint. The node adopts it instead of being split.
            if child.cost == node.cost and child.num_conflicts < node.num_conflicts:
                # The widths of the new path were counted with the constraint. Without it, the agent has as many
                # shortest paths as before.
                if len(found) == 1:
                    paths[agent] = paths[agent]._replace(widths=node.paths[agent].widths)
                return [self._node(paths, node.constraints, node.bound)]
            children.append(child)
        return children

    def _plan(
        self, number: int, constraints: tuple[Constraint, ...], others: list[AgentPath], deadline: Deadline
    ) -> Paths | None:
        """Return shortest paths of a group, or None if there are none, or if the deadline has passed.

        A single agent's path is one with the fewest conflicts with other paths.
        """
        group, array = self._groups[number], np.array(constraints, np.int32).reshape(-1, 3)
        if len(group) != 1:
            return self._plan_together(group, array, deadline)
        if deadline.has_passed:
            self._was_cut = True
            return None
        path = self._plan_alone(self._agents[group[0]], array, others)
        return None if path is None else {group[0]: path}

    def _plan_alone(self, task: Agent, constraints: Ints, others: list[AgentPath]) -> AgentPath | None:
        # An agent that has ended stays on its goal, where a later constraint would still apply to it.
        first_end = last_on_goal(constraints, task.goal, self._disappear)
        avoided = self._others(others)
        # Most paths need few layers, so there are more only once a path has needed them.
        while (cost := search(task, constraints, first_end, avoided, self._layers)) == FULL:
            rows, num_states = self._layers.conflicts.shape
            self._layers = allocate_layers(2 * rows, num_states)
        if cost == NO_PATH:
            return None
        path = AgentPath(np.empty(cost + 1, np.int32), np.empty(cost + 1, np.int8), np.empty(cost + 1, np.int32), 1)
        read_path(task, constraints, self._layers, path.cells, path.headings, path.widths)
        return path

    def _plan_together(self, group: tuple[int, ...], constraints: Ints, deadline: Deadline) -> Paths | None:
        tasks = [self._agents[agent] for agent in group]
        moves, headings = tasks[0].moves, tasks[0].num_headings
        starts, goals = (np.array([getattr(task, name) for task in tasks], np.int32) for name in ("start", "goal"))
        distance = np.empty((len(group), self._num_cells * headings), np.int32)
        for goal, row in zip(goals, distance, strict=True):
            distances(moves, headings, goal, row)
        joint = JointSearch(Group(moves, headings, starts, goals, distance, self._disappear), constraints)
        found = joint.run(deadline)
        if found is None:
            self._was_cut |= not joint.is_exhausted
            return None
        states, lengths = found
        return {
            agent: _wide_path(states[: length + 1, column], headings)
            for column, (agent, length) in enumerate(zip(group, lengths.tolist(), strict=True))
        }

    def _others(self, paths: list[AgentPath]) -> Others:
        """Return the paths of other agents, as the search of a path takes them."""
        cells = cells_of(paths)
        if self._disappear:
            cells = np.concatenate([cells, cells[-1:]])  # after the last arrival, no agent is left
        steps, agents = np.nonzero(np.arange(len(cells))[:, None] <= self._last_steps(paths))
        # The conflict avoidance table (Sharon et al. 2015): it only breaks ties between paths of equal cost.
        at = np.full((len(cells), self._num_cells), -1, np.int32)
        at[steps, cells[steps, agents]] = agents
        return Others(cells, at)

    def _last_steps(self, paths: list[AgentPath]) -> Ints:
        """Return the last step (N,) int32 after which each agent is on the map."""
        return np.array([path.cost if self._disappear else UNREACHED for path in paths], np.int32)

    def _node(self, paths: list[AgentPath], constraints: list[tuple[Constraint, ...]], bound: int) -> Node:
        """Return the node with these paths, whose cost is at least `bound`."""
        cells = cells_of(paths)
        # A path is continued at its end, where the width is 1 for an agent that stays: it has no other cell to be on.
        widths = np.empty_like(cells)
        for agent, path in enumerate(paths):
            end = path.num_steps + 1
            widths[:end, agent], widths[end:, agent] = path.widths, path.end_width
        conflicts = np.empty((MAX_CONFLICTS, 5), np.int32)
        count = find_conflicts(cells, self._last_steps(paths), widths, conflicts)
        conflicts = conflicts[:count].copy()
        self._num_nodes += 1
        # The bound of a child is at least that of its parent. Each pair of agents with a cardinal conflict adds 1 to
        # it, if no agent is in two pairs (Felner et al., ICAPS 2018). A greedy choice of pairs may add less, but never
        # too much.
        bound = max(bound, sum(path.cost for path in paths) + _num_raising_pairs(conflicts))
        return Node(bound, count, self._num_nodes, paths, constraints, conflicts)


def _wide_path(states: Ints, headings: int) -> AgentPath:
    """Return the path of an agent that was planned together with others."""
    # Other paths of the group may cost one agent more and another one less. So none of its conflicts is known to raise
    # the cost, and the bound stays valid.
    widths = np.full(len(states), WIDE, np.int32)
    return AgentPath(states // headings, (states % headings).astype(np.int8), widths, WIDE)


def _constraints(conflict: list[int], paths: list[AgentPath]) -> list[tuple[int, Constraint]]:
    """Return the two agents of a conflict, each with the constraint that avoids it."""
    step, first, second = conflict[STEP], conflict[FIRST], conflict[SECOND]
    constraints: list[tuple[int, Constraint]] = []
    for agent in (first, second):
        cells = paths[agent].cells
        last = len(cells) - 1
        # In a swap, both agents may be on these cells, only not make this move: a constraint on an edge.
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


def cells_of(paths: list[AgentPath]) -> Ints:
    """Return the cell of each agent after each step, (L, N) int32."""
    return padded([path.cells for path in paths])


def padded(columns: list[Ints]) -> Ints:
    """Return columns as an array (L, N) int32, where L is the largest length; the last number of each is repeated."""
    table = np.empty((max(map(len, columns), default=1), len(columns)), np.int32)
    for agent, column in enumerate(columns):
        table[: len(column), agent], table[len(column) :, agent] = column, column[-1]
    return table
