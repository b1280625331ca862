"""The length of an agent's shortest path without other agents, for metrics: A* from start to goal."""

from __future__ import annotations

import numpy as np

from mapf_pz._internal.jit import Array, inlined, jit
from mapf_pz.instances.heading import Heading
from mapf_pz.simulator.kernels.state import World

EAST, WEST, NORTH = int(Heading.EAST), int(Heading.WEST), int(Heading.NORTH)


def shortest_lengths(world: World, m: int, starts: Array, headings: Array, goals: Array, num_headings: int) -> Array:
    """Return the length in steps (N,) int32 of each agent's shortest path on map `m`, without other agents; -1: none.

    `starts`, `headings` and `goals` are (N,); `num_headings` is 4, or 1 for cardinal agents.
    """
    states = world.obstacle.shape[1] * num_headings
    closed, lists = np.empty(states, np.bool_), np.empty((4, 4 * states), np.int32)
    lengths = np.empty(goals.size, np.int32)
    agents = starts.astype(np.int64), headings.astype(np.int64), goals.astype(np.int64)
    _shortest_lengths(world.leads_to[m], world.width, *agents, num_headings, closed, lists, lengths)
    return lengths


@jit
def _shortest_lengths(
    leads_to: Array, width: int, starts: Array, headings: Array, goals: Array, num_headings: int, closed: Array,
    lists: Array, lengths: Array
) -> None:  # fmt: skip
    """Write the lengths (N,); `closed` and `lists` are scratch."""
    for i in range(goals.size):
        heading = headings[i] % num_headings
        lengths[i] = _shortest_length(leads_to, width, starts[i], heading, goals[i], num_headings, closed, lists)


@jit
def _shortest_length(
    leads_to: Array, width: int, start: int, heading: int, goal: int, num_headings: int, closed: Array, lists: Array
) -> int:
    """Return the length of a shortest path; -1: there is none.

    A state is the number `cell * num_headings + heading`. A step raises the estimated length of a path by 0 to 3, so
    the open states are in four lists, by their estimates modulo 4.
    """
    closed[:] = False
    sizes = np.zeros(4, np.int64)
    first = start * num_headings + heading
    estimate = _estimate(width, first, goal, num_headings)
    lists[estimate & 3, 0] = first
    sizes[estimate & 3] = 1
    while sizes.any():
        now = estimate & 3
        if sizes[now] == 0:
            estimate += 1
            continue
        sizes[now] -= 1
        state = lists[now, sizes[now]]
        if closed[state]:
            continue
        closed[state] = True
        cell, towards = state // num_headings, state % num_headings
        if cell == goal:
            return estimate
        steps = estimate - _estimate(width, state, goal, num_headings) + 1
        for k in range(4 if num_headings == 1 else 3):
            if num_headings == 1:
                following = leads_to[k, cell]
            elif k == 2:  # straight ahead comes last, and is expanded first
                following = leads_to[towards, cell] * 4 + towards
            else:
                following = cell * 4 + (towards + 1 + 2 * k) % 4
            if not closed[following]:  # the own state, where a move is blocked, is
                at = (steps + _estimate(width, following, goal, num_headings)) & 3
                lists[at, sizes[at]] = following
                sizes[at] += 1
    return -1


@inlined
def _estimate(width: int, state: int, goal: int, num_headings: int) -> int:
    """Return the steps to the goal without obstacles."""
    cell = state // num_headings
    south, east = goal // width - cell // width, goal % width - cell % width
    steps = abs(south) + abs(east)
    if num_headings == 1:
        return steps
    heading = state % 4
    ahead, aside = (east, south) if heading in (EAST, WEST) else (south, east)
    if heading in (WEST, NORTH):
        ahead = -ahead
    if ahead < 0:
        return steps + 2
    return steps + (aside != 0)
