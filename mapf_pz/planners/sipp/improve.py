"""Large neighborhood search: replan a neighborhood of agents at a time, while the others keep their paths.

Li et al., *Anytime Multi-Agent Path Finding via Large Neighborhood Search*, IJCAI 2021. An agent without a path counts
as a very late arrival. While there are any, half of the neighborhoods consist of one of them and the agents in its way;
their new paths may be longer, or leave another agent without a path. The other neighborhoods shorten paths, which frees
cells for all agents.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapf_pz._internal.jit import Array, jit
from mapf_pz.planners.random import draw_below
from mapf_pz.planners.sipp.neighborhood import (
    KINDS,
    Neighborhood,
    add,
    choose_around_missing,
    choose_neighborhood,
    clear,
    cost_of,
    delay,
    shortest,
    shuffle,
)
from mapf_pz.planners.sipp.reservations import NONE, Reservations, discard, reserve, withdraw
from mapf_pz.planners.sipp.search import SippProblem, SippScratch, find_path

MISSING = 2**24  # the cost of a missing path, larger than any relevant sum of arrivals
SMALLEST, LARGEST = 2, 8  # agents in a neighborhood; twice as many around an agent without a path
REACTION = 0.01  # learning rate of the success of each kind of neighborhood
LEAST_SUCCESS = 0.001  # so that every kind of neighborhood is chosen sometimes
EFFORT = 8  # the cost of choosing a neighborhood, in expanded states


class LnsState(NamedTuple):
    """The state of a large neighborhood search for N agents."""

    former: Array  # (N,) int32: the first visits of the paths that are being replaced
    success: Array  # (KINDS,) float64: recent gain of each kind of neighborhood per 1000 expanded states
    missing: Array  # (1,) int64: number of agents without a path


def allocate_lns(num_agents: int) -> LnsState:
    """Allocate the state for N agents without paths."""
    return LnsState(
        former=np.zeros(num_agents, np.int32),
        success=np.ones(KINDS),
        missing=np.array([num_agents], np.int64),
    )


@jit
def plan_and_improve(
    problem: SippProblem, order: Array, work: int, reservations: Reservations, scratch: SippScratch,
    neighborhood: Neighborhood, state: LnsState
) -> None:  # fmt: skip
    """Plan the agents in `order`, none of which has a path, then improve the paths of all agents.

    It ends when the improvement has expanded about `work` states, when the last missing path is found, or when all
    paths are shortest paths.
    """
    for agent in order:
        # Prioritized planning: a neighborhood of one agent, whose path is the earliest arrival among those before it.
        clear(neighborhood)
        add(neighborhood, agent)
        _replan(0, problem, reservations, scratch, neighborhood, state)
    random = neighborhood.random
    missing = state.missing[0]
    limit = scratch.count[1] + work
    while scratch.count[1] < limit and (missing == 0 or state.missing[0] > 0):
        if missing == 0 and _is_shortest(problem, reservations):
            return
        before = scratch.count[1]
        # Otherwise attempts that expand no states, as for agents that are not late, would never end the loop.
        scratch.count[1] += EFFORT
        wanted = SMALLEST + draw_below(random, LARGEST - SMALLEST + 1)
        # `MISSING - 1` allows longer paths in exchange for one that was missing, but not one more missing path.
        if missing > 0 and draw_below(random, 2) == 0:
            choose_around_missing(2 * wanted, problem, reservations, neighborhood)
            shuffle(neighborhood)
            _replan(MISSING - 1, problem, reservations, scratch, neighborhood, state)
            continue
        kind = _pick(state.success, random)
        choose_neighborhood(kind, wanted, problem, reservations, neighborhood)
        shuffle(neighborhood)
        gain = _replan(0, problem, reservations, scratch, neighborhood, state)
        if missing == 0:
            # Gain per unit of work, not per attempt: a kind that takes twice as long must gain twice as much.
            rate = 1000 * gain / (scratch.count[1] - before)
            state.success[kind] += REACTION * (rate - state.success[kind])
            state.success[kind] = max(state.success[kind], LEAST_SUCCESS)


@jit
def _is_shortest(problem: SippProblem, reservations: Reservations) -> bool:
    agent = 0
    while agent < problem.goals.size and delay(problem, reservations, agent) == 0:
        agent += 1
    return agent == problem.goals.size


@jit
def _pick(success: Array, random: Array) -> int:
    """Sample a number from 0 to KINDS - 1, with probabilities proportional to `success`."""
    # Roulette wheel selection of adaptive large neighborhood search, as in Li et al. 2021.
    threshold = success.sum() * draw_below(random, 2**30) / 2**30
    for kind in range(KINDS - 1):
        if threshold < success[kind]:
            return kind
        threshold -= success[kind]
    return KINDS - 1


@jit
def _replan(
    allowance: int, problem: SippProblem, reservations: Reservations, scratch: SippScratch,
    neighborhood: Neighborhood, state: LnsState
) -> int:  # fmt: skip
    """Replan the agents of the neighborhood in its order; return by how much their cost decreases.

    The former paths are restored if the cost would increase by more than `allowance`.
    """
    agents = neighborhood.agents[: neighborhood.size[0]]
    former_cost, remaining = 0, 0
    for k, agent in enumerate(agents):
        # `remaining` is a lower bound on the costs of the agents that are still to be planned.
        former_cost += MISSING if reservations.first[agent] == NONE else cost_of(reservations, agent)
        remaining += shortest(problem, agent)
        state.former[k] = withdraw(reservations, agent)
    cost, planned = 0, 0
    while planned < agents.size and cost + remaining <= former_cost + allowance:
        agent = agents[planned]
        remaining -= shortest(problem, agent)
        # A path that arrives later than this could not be accepted, so the search need not look for it.
        limit = former_cost + allowance - cost - remaining
        first = find_path(problem, agent, limit, draw_below(neighborhood.random, 4), reservations, scratch)
        if first == NONE:
            cost += MISSING
        else:
            reserve(reservations, agent, first)
            cost += cost_of(reservations, agent)
        planned += 1
    accepted = cost + remaining <= former_cost + allowance
    for k, agent in enumerate(agents):
        state.missing[0] -= state.former[k] == NONE
        discard(reservations, state.former[k] if accepted else withdraw(reservations, agent))
    for k, agent in enumerate(agents):
        if not accepted and state.former[k] != NONE:
            reserve(reservations, agent, state.former[k])
        state.missing[0] += reservations.first[agent] == NONE
    return former_cost - cost if accepted else 0
