"""Planning agents anew among the others, a neighbourhood at a time: large neighbourhood search.

Li et al., *Anytime Multi-Agent Path Finding via Large Neighborhood Search*, IJCAI 2021. Agents without a path count as
arriving very late. While there are any, every other neighbourhood is one of them and those in its way, whose new paths
may be longer ones or leave another agent without one; the rest goes on to shorten paths, which makes way for all.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapf_pz.core.jit import jit
from mapf_pz.core.state import Array
from mapf_pz.planners.random import draw_below
from mapf_pz.planners.sipp.neighborhood import (
    KINDS,
    Neighborhood,
    add,
    choose_around_missing,
    choose_neighborhood,
    clear,
    delay,
    shortest,
    shuffle,
)
from mapf_pz.planners.sipp.reservations import NONE, Reservations, discard, reserve, withdraw
from mapf_pz.planners.sipp.search import SippProblem, SippScratch, find_path

MISSING = 2**24  # what a missing path costs: more than any sum of arrivals that is worth waiting for
SMALLEST, LARGEST = 2, 8  # agents in a neighbourhood; twice as many around one without a path
REACTION = 0.01  # how quickly the choice of neighbourhoods follows their success
LEAST_SUCCESS = 0.001  # no kind of neighbourhood is given up
EFFORT = 8  # for how many expanded states the choice of a neighbourhood counts


class LnsState(NamedTuple):
    """Where a large neighbourhood search of N agents stands."""

    former: Array  # (N,) int32: the first visits of the paths that are being replaced
    success: Array  # (KINDS,) float64: what each kind of neighbourhood has gained lately by 1000 expanded states
    missing: Array  # (1,) int64: how many agents have no path


def allocate_lns(num_agents: int) -> LnsState:
    """Begin the search for N agents that have no paths."""
    return LnsState(
        former=np.zeros(num_agents, np.int32),
        success=np.ones(KINDS),
        missing=np.array([num_agents], np.int64),
    )


@jit
def plan_and_improve(
    task: SippProblem, order: Array, work: int, reservations: Reservations, search: SippScratch,
    neighborhood: Neighborhood, progress: LnsState
) -> None:  # fmt: skip
    """Plan the agents in `order`, none of which has a path, then improve the paths of all.

    It ends when about `work` states were expanded for that, when the last missing path is found, or when all paths are
    shortest.
    """
    for agent in order:
        clear(neighborhood)
        add(neighborhood, agent)
        _replan(0, task, reservations, search, neighborhood, progress)
    random = neighborhood.random
    missing = progress.missing[0]
    enough = search.count[1] + work
    while search.count[1] < enough and (missing == 0 or progress.missing[0] > 0):
        if missing == 0 and _is_shortest(task, reservations):
            return
        before = search.count[1]
        search.count[1] += EFFORT
        wanted = SMALLEST + draw_below(random, LARGEST - SMALLEST + 1)
        if missing > 0 and draw_below(random, 2) == 0:
            choose_around_missing(2 * wanted, task, reservations, neighborhood)
            shuffle(neighborhood)
            _replan(MISSING - 1, task, reservations, search, neighborhood, progress)
            continue
        kind = _pick(progress.success, random)
        choose_neighborhood(kind, wanted, task, reservations, neighborhood)
        shuffle(neighborhood)
        gain = _replan(0, task, reservations, search, neighborhood, progress)
        if missing == 0:
            # Gain by work, not by attempt: a kind that takes twice as long must gain twice as much.
            rate = 1000 * gain / (search.count[1] - before)
            progress.success[kind] += REACTION * (rate - progress.success[kind])
            progress.success[kind] = max(progress.success[kind], LEAST_SUCCESS)


@jit
def _is_shortest(task: SippProblem, reservations: Reservations) -> bool:
    agent = 0
    while agent < task.goals.size and delay(task, reservations, agent) == 0:
        agent += 1
    return agent == task.goals.size


@jit
def _pick(success: Array, random: Array) -> int:
    """Return a number from 0 to KINDS - 1, each as likely as its `success` is large."""
    mark = success.sum() * draw_below(random, 2**30) / 2**30
    for kind in range(KINDS - 1):
        if mark < success[kind]:
            return kind
        mark -= success[kind]
    return KINDS - 1


@jit
def _replan(
    allowance: int, task: SippProblem, reservations: Reservations, search: SippScratch,
    neighborhood: Neighborhood, progress: LnsState
) -> int:  # fmt: skip
    """Plan the neighbourhood anew in its order; return how much less it costs.

    The former paths come back if it would cost over `allowance` more.
    """
    agents = neighborhood.agents[: neighborhood.size[0]]
    former_cost, to_come = 0, 0
    for k, agent in enumerate(agents):
        former_cost += MISSING if reservations.first[agent] == NONE else reservations.arrival[agent]
        to_come += shortest(task, agent)
        progress.former[k] = withdraw(reservations, agent)
    cost, planned = 0, 0
    while planned < agents.size and cost + to_come <= former_cost + allowance:
        agent = agents[planned]
        to_come -= shortest(task, agent)
        limit = former_cost + allowance - cost - to_come
        first = find_path(task, agent, limit, draw_below(neighborhood.random, 4), reservations, search)
        if first == NONE:
            cost += MISSING
        else:
            reserve(reservations, agent, first)
            cost += reservations.arrival[agent]
        planned += 1
    accepted = cost + to_come <= former_cost + allowance
    for k, agent in enumerate(agents):
        progress.missing[0] -= progress.former[k] == NONE
        discard(reservations, progress.former[k] if accepted else withdraw(reservations, agent))
    for k, agent in enumerate(agents):
        if not accepted and progress.former[k] != NONE:
            reserve(reservations, agent, progress.former[k])
        progress.missing[0] += reservations.first[agent] == NONE
    return former_cost - cost if accepted else 0
