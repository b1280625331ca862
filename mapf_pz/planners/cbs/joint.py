"""The shortest paths of a group of agents together under constraints: A* over their joint states.

A joint state is the state of each agent (see `cbs.paths`), which agents have ended at their goals, where they stay,
and the time until the last constraint. Each agent that has not ended costs 1 a step, and each agent costs 1 in the
first step; the heuristic is the sum of the agents' distances to their goals. The number of joint states grows
exponentially with the number of agents, but is finite, so the search also ends if there is no solution.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapf_pz._internal.arrays import Ints
from mapf_pz._internal.jit import Array, inlined, jit
from mapf_pz.planners.cbs.paths import UNREACHED, is_forbidden, last_on_goal, next_state
from mapf_pz.planners.deadline import Deadline
from mapf_pz.planners.hashing import EMPTY, find_slot, hash_row, refill_slots

MAX_BYTES = 1 << 30
"""Maximum memory of a search, which fails if it needs more."""

RUNNING, SOLVED, EXHAUSTED, FULL = range(4)
"""Results of `_expand`. FULL means that `Nodes` must grow."""
COUNT, LOWEST, SOLUTION = range(3)
"""Indices of the counters (3,) int64: the number of nodes, the lowest f-value of an open node, and the solution."""

_FIRST_NODES = 1 << 10
_SUCCESSORS = 1 << 17  # generated per call of the kernel: at most about 50 ms


class Group(NamedTuple):
    """The tasks of G agents on a map of C cells."""

    moves: Array  # (4, C) int32: the cell that a move in each direction leads to; the same cell if blocked
    num_headings: int  # D
    starts: Array  # (G,) int32: states
    goals: Array  # (G,) int32: cells
    distance: Array  # (G, C * D) int32: number of steps to each agent's goal; UNREACHED: unreachable
    disappear: bool  # as in `Problem`


class Nodes(NamedTuple):
    """Up to K joint states."""

    rows: Array  # (K, G + 2) int32: the states, the ended agents as a bit set, and the time
    key: Array  # (K,) uint64: the hash of the row
    slots: Array  # (2 * K,) int32: hash table of the rows
    cost: Array  # (K,) int32: cost of the shortest known path to the joint state
    parent: Array  # (K,) int32: the node before it on that path; -1: none, it is the start
    after: Array  # (K,) int32: the next open node with the same f-value; -1: none
    first: Array  # (2 * G * K,) int32: the first open node of each f-value less that of the start; -1: none


def _allocate(capacity: int, num_agents: int) -> Nodes:
    return Nodes(
        rows=np.zeros((capacity, num_agents + 2), np.int32),
        key=np.zeros(capacity, np.uint64),
        slots=np.full(2 * capacity, EMPTY, np.int32),
        cost=np.zeros(capacity, np.int32),
        parent=np.zeros(capacity, np.int32),
        after=np.zeros(capacity, np.int32),
        first=np.full(2 * num_agents * capacity, EMPTY, np.int32),  # each step adds at most 2 * G
    )


class JointSearch:
    """A search for the paths of a group with the lowest sum of costs."""

    def __init__(self, group: Group, constraints: Ints) -> None:
        """Start the search.

        Args:
            group: the agents and their tasks.
            constraints: (K, 3) int32, as in `cbs.paths.search`: none of the agents must violate any of them.
        """
        self._group, self._constraints = group, constraints
        last_step = int(constraints[-1, 0]) if len(constraints) else 0
        self._first_step = np.searchsorted(constraints[:, 0], np.arange(last_step + 3)).astype(np.int32)
        steps = [last_on_goal(constraints, goal, group.disappear) for goal in group.goals.tolist()]
        self._first_end = np.array(steps, np.int32)
        self._nodes = _allocate(_FIRST_NODES, len(group.goals))
        self._counters = np.array([1, 0, EMPTY], np.int64)
        self.is_exhausted = False
        """Whether `run` has found that there is no solution."""
        self._nodes.rows[0, :-2] = group.starts
        self._nodes.key[0] = hash_row(self._nodes.rows[0])
        self._nodes.parent[0] = self._nodes.after[0] = EMPTY
        self._nodes.first[0] = 0
        refill_slots(self._nodes, 1)

    def run(self, deadline: Deadline) -> tuple[Ints, Ints] | None:
        """Return the states (T + 1, G) after each step and the lengths (G,) of the paths; None: none were found."""
        status, expansions = RUNNING, 1 + (_SUCCESSORS >> 2 * len(self._group.goals))
        while status in (RUNNING, FULL) and not deadline.has_passed:
            if status == FULL and not self._grow():
                return None
            steps = self._first_step, self._first_end
            status = _expand(self._group, self._constraints, *steps, expansions, self._nodes, self._counters)
        self.is_exhausted = status == EXHAUSTED
        if status != SOLVED:
            return None
        chain = [int(self._counters[SOLUTION])]
        while self._nodes.parent[chain[-1]] != EMPTY:
            chain.append(int(self._nodes.parent[chain[-1]]))
        rows = self._nodes.rows[chain[::-1]]
        has_ended = rows[:, -2, None] >> np.arange(len(self._group.goals)) & 1
        return rows[:, :-2], (has_ended[1:] == 0).sum(axis=0)

    def _grow(self) -> bool:
        """Double the capacity; return whether that is allowed."""
        if 2 * sum(array.nbytes for array in self._nodes) > MAX_BYTES:
            return False
        first = self._nodes.first
        self._nodes = self._nodes._make(np.concatenate([array, np.zeros_like(array)]) for array in self._nodes)
        self._nodes.first[len(first) :] = EMPTY
        refill_slots(self._nodes, self._counters[COUNT])
        return True


@jit
def distances(moves: Array, num_headings: int, goal: int, distance: Array) -> None:
    """Write the number of steps (C * D,) int32 from each state to the goal."""
    distance[:] = UNREACHED
    distance[goal * num_headings : (goal + 1) * num_headings] = 0
    num_actions = 5 if num_headings == 1 else 4
    step, found = 0, True
    while found:
        found = False
        for state in range(distance.size):
            for action in range(1, num_actions):
                if distance[state] == UNREACHED and distance[next_state(moves, num_headings, state, action)] == step:
                    distance[state] = step + 1
                    found = True
        step += 1


@jit
def _expand(
    group: Group,
    constraints: Array,
    first_step: Array,
    first_end: Array,
    expansions: int,
    nodes: Nodes,
    counters: Array,
) -> int:
    """Expand up to `expansions` nodes; return the status.

    Args:
        group: the agents and their tasks.
        constraints: (K, 3) int32, ordered by step.
        first_step: (S + 3,) int32: the first constraint of each step, where S is the last step with a constraint.
        first_end: (G,) int32: no agent must end before its step here.
        expansions: maximum number of nodes to expand.
        nodes: the joint states.
        counters: (3,) int64.
    """
    num_agents = group.goals.size
    num_actions = 5 if group.num_headings == 1 else 4
    choice = np.zeros(num_agents, np.int32)
    row = np.zeros(num_agents + 2, np.int32)
    for _ in range(expansions):
        # An expansion is never interrupted: there must be room for all combinations of actions, ending included.
        if counters[COUNT] + (num_actions + 1) ** num_agents > nodes.cost.size:
            return FULL
        node = _pop(nodes, counters)
        if node == EMPTY:
            return EXHAUSTED
        before = nodes.rows[node]
        # An open node is not moved when a shorter path is found, but opened again; the slot has the latest node.
        if nodes.slots[find_slot(nodes, before, nodes.key[node])] != node:
            continue  # a shorter path to the joint state was found later
        time = before[num_agents + 1]
        # The sum of distances is a consistent heuristic, so the first goal that is expanded has the lowest sum of
        # costs.
        if _all_end(group, first_end, before, time):
            counters[SOLUTION] = node
            return SOLVED
        # After the last constraint, time no longer matters. So the number of joint states is finite, and the search
        # ends even without a solution.
        row[num_agents + 1] = min(time + 1, first_step.size - 3)
        at = first_step[time + 1], first_step[time + 2]
        agent = 0
        # Backtracking over the actions of one agent after another: the actions of the rest are not tried with a choice
        # that collides with those before it.
        choice[0] = -1
        while agent >= 0:
            choice[agent] += 1
            if choice[agent] > num_actions:
                agent -= 1
            elif _choose(group, constraints, at, first_end, before, node == 0, agent, choice[agent], row):
                if agent == num_agents - 1:
                    _open(group, node, row, nodes, counters)
                else:
                    agent += 1
                    choice[agent] = -1
    return RUNNING


@inlined
def _all_end(group: Group, first_end: Array, before: Array, time: int) -> bool:
    """Return whether all agents are at their goals and have ended or may end."""
    for agent in range(group.goals.size):
        if before[agent] // group.num_headings != group.goals[agent] or time < first_end[agent]:
            return False
    return True


@jit
def _choose(
    group: Group,
    constraints: Array,
    at: tuple[int, int],
    first_end: Array,
    before: Array,
    is_first: bool,
    agent: int,
    action: int,
    row: Array,
) -> bool:
    """Write the agent's state after an action to `row`, and whether it has ended; return whether this is allowed.

    The first action is to end, or to have ended. The agents with lower indices have chosen; `at` are the numbers of the
    first constraint of this step and of the next step. In the first step, no agent has disappeared.
    """
    num_agents, headings = group.goals.size, group.num_headings
    bit = 1 << agent
    has_ended = before[num_agents] & bit != 0
    cell = before[agent] // headings
    has_disappeared = _has_disappeared(group, before, is_first, agent)
    if action == 0:
        # Ending is an action, because an agent at its goal may also have to leave it again for another agent. Once it
        # has ended, it stays, and its steps cost nothing.
        if not has_ended and (cell != group.goals[agent] or before[num_agents + 1] < first_end[agent]):
            return False
        after = before[agent]
        row[num_agents] |= bit
    else:
        after = next_state(group.moves, headings, before[agent], action - 1)
        # A blocked move has the same effect as the wait, and must not double the successors.
        is_second_wait = action > 1 and after == before[agent]
        if has_ended or has_disappeared or is_second_wait or group.distance[agent, after] == UNREACHED:
            return False
        row[num_agents] &= ~bit
    row[agent] = after
    if has_disappeared:
        return True
    next_cell = after // headings
    if action > 0 and is_forbidden(constraints, at[0], at[1], cell, next_cell):
        return False
    for other in range(agent):
        # Only agents that have chosen before: each pair is checked once.
        if _has_disappeared(group, before, is_first, other):
            continue
        next_other = row[other] // headings
        if next_other == next_cell or (next_other == cell and before[other] // headings == next_cell):
            return False
    return True


@inlined
def _has_disappeared(group: Group, before: Array, is_first: bool, agent: int) -> bool:
    """Return whether an agent is no longer on the map after a step, since it was at its goal after a step before."""
    return group.disappear and not is_first and before[agent] // group.num_headings == group.goals[agent]


@jit
def _open(group: Group, parent: int, row: Array, nodes: Nodes, counters: Array) -> None:
    """Add a joint state, unless a path to it is known that is not longer."""
    num_agents = group.goals.size
    cost, excess = nodes.cost[parent], 0
    for agent in range(num_agents):
        has_ended = row[num_agents] >> agent & 1
        # As in `Plan.costs`: even an agent that starts at its goal costs 1.
        cost += 1 if parent == 0 else 1 - has_ended
        # f-values are stored less that of the start, so that the array of lists starts at 0.
        excess += group.distance[agent, row[agent]] - group.distance[agent, group.starts[agent]]
    key = hash_row(row)
    slot = find_slot(nodes, row, key)
    known = nodes.slots[slot]
    if known != EMPTY and nodes.cost[known] <= cost:
        return
    node = counters[COUNT]
    counters[COUNT] += 1
    nodes.rows[node], nodes.key[node], nodes.cost[node], nodes.parent[node] = row, key, cost, parent
    nodes.slots[slot] = node
    # f-values are small integers: a list for each of them replaces a heap. The latest node comes first, which is mostly
    # the deepest one.
    nodes.after[node] = nodes.first[cost + excess]
    nodes.first[cost + excess] = node


@jit
def _pop(nodes: Nodes, counters: Array) -> int:
    """Return an open node with the lowest f-value, the latest one, which is closed; -1 if there is none."""
    # f-values never decrease along a path, so the lists before the lowest one stay empty.
    while counters[LOWEST] < nodes.first.size:
        node = nodes.first[counters[LOWEST]]
        if node != EMPTY:
            nodes.first[counters[LOWEST]] = nodes.after[node]
            return node
        counters[LOWEST] += 1
    return EMPTY
