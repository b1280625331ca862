"""The state of PIBT between steps, its scratch, and its options as kernels take them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapf_pz._internal.jit import Array, inlined
from mapf_pz.planners.random import seeded
from mapf_pz.simulator.kernels.cost_lookup import cost_at
from mapf_pz.simulator.kernels.state import PlanningView

NO_AGENT, UNDECIDED, STAY = -1, -1, 4
NEAREST, ELAPSED, LATE = range(3)
"""The priorities, as in `mapf_pz.planners.pibt.priority`."""


class Options(NamedTuple):
    """The options of `mapf_pz.planners.PIBT`."""

    priority: int  # NEAREST, ELAPSED or LATE
    swap: bool  # agents change places: see `mapf_pz.planners.pibt.swap`
    hindrance: bool  # ties are broken in favor of cells that hinder fewer agents


class PibtState(NamedTuple):
    """State of N agents on C cells between steps, and scratch."""

    want: Array  # (N,) int32: the cell that each agent has reserved or wants to reach; -1: undecided
    away: Array  # (N,) int32: steps since the agent was at a goal; -1: first step
    first_cost: Array  # (N,) float32: cost to go when `away` was last 0, or in the first step if agents must stay
    order: Array  # (N,) int32: the agents, the highest priority first
    key: Array  # (N,) float64: each agent's sort key, lower first
    merged: Array  # (N,) int32: scratch of the sort
    taken: Array  # (C + 1,) int32: the agent that has reserved each cell; -1: none
    rank: Array  # (N, 5) int64: of moving in each direction and of staying, the best first; last 3 bits: the choice
    closer: Array  # (N,) int8: the directions in which the cost to go decreases, one bit each
    demand: Array  # (C + 1,) int32: number of agents that reduce their cost to go by moving to each cell
    pull: Array  # (N,) int8: the direction of the agent that follows when this one moves away; -1: none
    tried: Array  # (N,) int8: number of choices tried so far
    choice: Array  # (N,) int8: the direction of `want`
    chain: Array  # (N,) int32: agents, each of which has asked the next one to move away
    resolved: Array  # (N,) bool: whether it is known if the agent can move
    random: Array  # (1,) uint64: state of the random numbers that break ties


def allocate_pibt(num_agents: int, num_cells: int, seed: int) -> PibtState:
    """Allocate the state for N agents on C cells; `seed`, which must not be 0, breaks ties."""
    return PibtState(
        want=np.full(num_agents, UNDECIDED, np.int32),
        away=np.full(num_agents, -1, np.int32),
        first_cost=np.zeros(num_agents, np.float32),
        order=np.arange(num_agents, dtype=np.int32),
        key=np.zeros(num_agents, np.float64),
        merged=np.zeros(num_agents, np.int32),
        taken=np.full(num_cells + 1, NO_AGENT, np.int32),
        rank=np.zeros((num_agents, 5), np.int64),
        closer=np.zeros(num_agents, np.int8),
        demand=np.zeros(num_cells + 1, np.int32),
        pull=np.full(num_agents, -1, np.int8),
        tried=np.zeros(num_agents, np.int8),
        choice=np.full(num_agents, STAY, np.int8),
        chain=np.zeros(num_agents, np.int32),
        resolved=np.zeros(num_agents, np.bool_),
        random=seeded(seed),
    )


@inlined
def to_go(planning_view: PlanningView, agent: Array, cell: int, heading: int) -> np.float32:
    """Return the cost to go from a cell and heading to the agent's goal."""
    return cost_at(planning_view.to_go, planning_view.slot[agent.goal], cell, heading)
