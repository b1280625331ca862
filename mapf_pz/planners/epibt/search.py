"""The search of EPIBT: new operations for an agent, and for the agents that it asks to replan."""

from __future__ import annotations

import numpy as np

from mapf_pz._internal.jit import Array, jit
from mapf_pz.planners.epibt.state import LAST_OPERATION, NONE, EpibtState
from mapf_pz.planners.pibt.state import NO_AGENT

SEVERAL = -2
MARGIN = np.float32(1e-3)
"""The smallest change of the sum of costs that is not attributed to rounding."""
MAX_VISITS = 10
"""Maximum number of times an agent may be asked to replan in one step (the value of the paper's authors)."""


@jit
def search(first: int, by_sum: bool, region: int, state: EpibtState) -> int:
    """Find a better operation for agent `first`, and new ones for the agents that it asks; else change nothing.

    With `by_sum`, the sum of all costs must decrease, and any agent of the region may be asked. Otherwise `first` takes
    the first possible operation before its own one, and only agents of lower priority may be asked.

    Write the agents that it asks for the first time to `state.asked[region]` and return their number.
    """
    choice, cost, path, used = state.choice, state.cost, state.path, state.used
    waiting, visits, next_option = state.waiting, state.visits, state.next_option
    chain, before, asked = state.chain[region], state.before[region], state.asked[region]
    depth, num_asked = 0, 0
    change = np.float32(0.0)  # of the sum of costs, by the new operations of the agents in the chain
    chain[0], before[0], next_option[first] = first, choice[first], 0
    mark(used, path[first, choice[first]], NO_AGENT)
    while True:
        i, old = chain[depth], before[depth]
        place = next_option[i]
        next_option[i] += 1
        p = state.options[i, place] & LAST_OPERATION if place < state.num_options[i] else NONE
        too_dear = by_sum and p != NONE and change + cost[i, p] - cost[i, old] > -MARGIN
        if p == NONE or too_dear or (not by_sum and depth == 0 and p == old):
            choice[i] = old
            if depth == 0:
                mark(used, path[i, old], i)
                return num_asked
            # Agent i has no possible operation: the previous agent in the chain must try another one.
            depth -= 1
            previous = chain[depth]
            mark(used, path[previous, choice[previous]], NO_AGENT)
            mark(used, path[i, old], i)
            waiting[previous] = False
            change -= cost[previous, choice[previous]] - cost[previous, before[depth]]
            continue
        other = _conflicting_agent(used, path[i, p])
        if other == NO_AGENT:
            choice[i] = p
            mark(used, path[i, p], i)
            for k in range(depth):
                waiting[chain[k]] = False
            return num_asked
        if other == SEVERAL or waiting[other] or visits[other] >= MAX_VISITS or state.region[other] != region:
            continue
        if not by_sum and state.rank[other] < state.rank[first]:
            continue
        if visits[other] == 0:
            asked[num_asked] = other
            num_asked += 1
        visits[other] += 1
        next_option[other] = 0
        mark(used, path[other, choice[other]], NO_AGENT)
        choice[i], waiting[i] = p, True
        mark(used, path[i, p], i)
        change += cost[i, p] - cost[i, old]
        depth += 1
        chain[depth], before[depth] = other, choice[other]


@jit
def mark(used: Array, path: Array, agent: int) -> None:
    """Mark the cells of `path` (D + 1,) after the first one as used by an agent, or by none."""
    for t in range(1, path.size):
        used[t, path[t]] = agent


@jit
def _conflicting_agent(used: Array, path: Array) -> int:
    """Return the agent whose operation conflicts with `path` (D + 1,), or NO_AGENT, or SEVERAL."""
    found = NO_AGENT
    for t in range(1, path.size):
        here, there = path[t - 1], path[t]
        occupant = used[t, there]
        if occupant != NO_AGENT and occupant != found:
            if found != NO_AGENT:
                return SEVERAL
            found = occupant
        leaving = used[t - 1, there]
        if here != there and leaving != NO_AGENT and leaving != found and used[t, here] == leaving:  # a swap
            if found != NO_AGENT:
                return SEVERAL
            found = leaving
    return found
