"""The operations of EPIBT, its state between steps, and its scratch."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapf_pz._internal.jit import Array
from mapf_pz.planners.pibt.state import NO_AGENT
from mapf_pz.simulator.kernels.state import PlanningView

NONE = -1
AHEAD = 4
OPERATION_BITS = 24
"""Number of the lowest bits of an option, which are its operation; 31 bits of its cost follow, the last bits are 0."""
LAST_OPERATION = 2**OPERATION_BITS - 1


class Operations(NamedTuple):
    """P operations of D actions as a prefix tree of M nodes; node 0 is the root, every other node is an action."""

    parent: Array  # (M,) int32: the node of the previous action
    turn: Array  # (M,) int32: quarter turns to the right
    direction: Array  # (M,) int32: the direction of a move; 4: ahead; -1: no move
    action: Array  # (M,) int64: its number in the environment
    nodes: Array  # (P, D) int32: the nodes of each operation; ties are broken in favor of the first operation
    rest: Array  # (P,) int32: the operation that continues this one after its first action and ends with a wait
    wait: int  # the operation that only waits
    num_regular: int  # the number of operations that EPIBT chooses from; the others, which only turn, come last


class EpibtState(NamedTuple):
    """The operations of N agents on C cells, their alternatives, and scratch."""

    choice: Array  # (N,) int32: each agent's operation
    cell: Array  # (N,) int32: the cell after its first action; -1: no operation yet
    heading: Array  # (N,) int32: the heading after its first action
    path: Array  # (N, P, D + 1) int32: the cells of every operation, starting with the agent's cell
    cost: Array  # (N, P) float32: of each operation, plus the cost to go from its end; inf: it leads into an obstacle
    options: Array  # (N, P) int64: the operations that an agent may choose, in the lowest bits, the best first
    num_options: Array  # (N,) int32
    next_option: Array  # (N,) int32: the place in `options` of the operation that the agent tries next
    to_go: Array  # (N,) float32: cost to go from the agent's state
    away: Array  # (N,) int32: steps since the agent was at its goal if agents must stay there; else 0
    order: Array  # (N,) int32: the agents, the highest priority first
    key: Array  # (N,) float64: each agent's sort key, lower first
    merged: Array  # (N,) int32: scratch of the sort
    rank: Array  # (N,) int32: each agent's position in that order
    used: Array  # (D + 1, C + 1) int32: the agent on each cell, now and after each action; -1: none
    visits: Array  # (N,) int32: how often each agent was asked to replan
    asked: Array  # (R, N) int32: the agents that were asked
    waiting: Array  # (N,) bool: whether it is in the chain and waits for the next agent to replan
    chain: Array  # (R, N) int32: agents of each region, each of which has asked the next one to replan
    before: Array  # (R, N) int32: the previous operation of each agent in the chain
    region: Array  # (N,) int32: the region in which each agent may replan during the improvement; -1: none
    node_cell: Array  # (M,) int32: scratch for one agent
    node_heading: Array  # (M,) int32
    node_cost: Array  # (M,) float32
    node_ends: Array  # (M,) bool: the goal was passed, so further actions cost nothing


def allocate_epibt(planning_view: PlanningView, tree: Operations, num_regions: int) -> EpibtState:
    """Allocate the state for an environment, with R regions in which agents replan at the same time."""
    num_agents, cells = planning_view.agents.size, planning_view.occupant.size
    num_nodes, (size, depth) = len(tree.parent), tree.nodes.shape
    return EpibtState(
        choice=np.full(num_agents, tree.wait, np.int32),
        cell=np.full(num_agents, -1, np.int32),
        heading=np.zeros(num_agents, np.int32),
        path=np.zeros((num_agents, size, depth + 1), np.int32),
        cost=np.zeros((num_agents, size), np.float32),
        options=np.zeros((num_agents, size), np.int64),
        num_options=np.zeros(num_agents, np.int32),
        next_option=np.zeros(num_agents, np.int32),
        to_go=np.zeros(num_agents, np.float32),
        away=np.zeros(num_agents, np.int32),
        order=np.arange(num_agents, dtype=np.int32),
        key=np.zeros(num_agents, np.float64),
        merged=np.zeros(num_agents, np.int32),
        rank=np.zeros(num_agents, np.int32),
        used=np.full((depth + 1, cells), NO_AGENT, np.int32),
        visits=np.zeros(num_agents, np.int32),
        asked=np.zeros((num_regions, num_agents), np.int32),
        waiting=np.zeros(num_agents, np.bool_),
        chain=np.zeros((num_regions, num_agents), np.int32),
        before=np.zeros((num_regions, num_agents), np.int32),
        region=np.zeros(num_agents, np.int32),
        node_cell=np.zeros(num_nodes, np.int32),
        node_heading=np.zeros(num_nodes, np.int32),
        node_cost=np.zeros(num_nodes, np.float32),
        node_ends=np.zeros(num_nodes, np.bool_),
    )
