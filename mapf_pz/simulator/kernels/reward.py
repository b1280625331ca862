"""The reward of a step: its configurable terms, and the kernels that compute them."""

from __future__ import annotations

from collections import namedtuple
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from mapf_pz._internal.config import Natural, checked
from mapf_pz._internal.jit import Array, inlined
from mapf_pz.simulator.kernels.conflict import NO_MOVE, direction
from mapf_pz.simulator.kernels.cost_lookup import cost_at, turned
from mapf_pz.simulator.kernels.state import CostToGo


@checked
@dataclass(frozen=True)
class RewardConfig:
    """The terms of each agent's reward. The defaults are the report's table (`reward="report"`)."""

    forward: float = 0.1
    """Reward for a forward move (any move, with cardinal actions) that changed the cell."""
    rotate: float = 0.01
    """Reward for turning left or right."""
    wait: float = 0.0
    """Reward for waiting."""
    goal: float = 20.0
    """Reward for the first arrival at a goal, instead of the reward for the action."""
    pay_blocked_forward: bool = False
    """Whether `forward` is also the reward for a move that was blocked, as in the report's published code."""
    progress: float = 0.0
    """Coefficient of the decrease of the cost to go in the step, in units of the mean edge weight."""
    step_cost: float = 0.0
    """Penalty for each step that ends away from the goal."""
    weighted_step_cost: float = 0.0
    """Penalty for the edge weight of each step, in units of the mean edge weight; staying at the goal is free."""
    blocked: float = 0.0
    """Penalty for a move that is blocked by an obstacle or another agent."""
    team_goal: float = 0.0
    """Reward for every agent when all agents are at their goals at the same time."""
    share: float = 0.0
    """Coefficient of the mean reward of the other agents nearby, added to each agent's reward."""
    share_radius: Natural = 4
    """Maximum distance to such agents, in rows and in columns."""


REWARDS: dict[str, RewardConfig] = {
    "report": RewardConfig(),
    "progress": RewardConfig(
        forward=0.0,
        rotate=0.0,
        goal=0.0,
        progress=0.2,
        step_cost=0.05,
        blocked=0.05,
        team_goal=2.0,
        share=2.0,
        share_radius=2,
    ),
}
"""The rewards that have a name."""


_named_tuple: Any = namedtuple
RewardTerms = _named_tuple("RewardTerms", [field.name for field in fields(RewardConfig)])
"""The fields of `RewardConfig` as kernels take them."""


def reward_terms(config: RewardConfig) -> Any:
    """Return the terms, each as a value of its field's type, for which kernels are compiled once."""
    return RewardTerms(*(type(field.default)(getattr(config, field.name)) for field in fields(config)))


@inlined
def compute_rewards(
    terms: Any, cardinal: bool, mean_weight: float, height: int, width: int, agents: Array, actions: Array,
    occupant: Array, solved: bool
) -> None:  # fmt: skip
    """Set every agent's reward; `solved`: all agents are on their goals at once."""
    for i in range(agents.size):
        agent = agents[i]
        agent.own_reward = 0.0
        if agent.was_active:
            reward = terms.goal if agent.arrived else _action_reward(terms, cardinal, agent, actions[i])
            reward += terms.progress * agent.progress
            if not agent.at_goal:
                reward -= terms.step_cost
            if terms.weighted_step_cost != 0 and not (agent.at_goal and agent.was_cell == agent.was_goal):
                reward -= terms.weighted_step_cost * agent.step_weight / mean_weight
            if agent.blocked:
                reward -= terms.blocked
            if solved:
                reward += terms.team_goal
            agent.own_reward = reward
        agent.reward = agent.own_reward
    if terms.share != 0:
        _share(terms.share, terms.share_radius, height, width, agents, occupant)


@inlined
def _action_reward(terms: Any, cardinal: bool, agent: Array, action: int) -> float:
    if direction(cardinal, agent.was_heading, action) != NO_MOVE:
        return terms.forward if terms.pay_blocked_forward or not agent.blocked else 0.0
    if not cardinal and turned(agent.was_heading, action) != agent.was_heading:
        return terms.rotate
    return terms.wait


@inlined
def measure_progress(coefficient: float, mean_weight: float, to_go: CostToGo, agents: Array) -> None:
    """Set the decrease of the cost to go in units of the mean weight; 0 where there is no path."""
    if coefficient == 0:
        return  # it is 0 since the reset
    for i in range(agents.size):
        agent = agents[i]
        before = cost_at(to_go, agent.table, agent.was_cell, agent.was_heading)
        after = cost_at(to_go, agent.table, agent.cell, agent.heading)
        # Agents can move along a blocked edge of the guidance graph.
        agent.progress = (before - after) / mean_weight if before < np.inf and after < np.inf else 0.0


@inlined
def _share(share: float, radius: int, height: int, width: int, agents: Array, occupant: Array) -> None:
    """Add `share` times the mean reward, before sharing, of the other agents within `radius` rows and columns."""
    for i in range(agents.size):
        if not agents[i].was_active:
            continue
        row, col = divmod(agents[i].cell, width)
        total, near = 0.0, 0
        for r in range(max(row - radius, 0), min(row + radius + 1, height)):
            for c in range(max(col - radius, 0), min(col + radius + 1, width)):
                other = occupant[r * width + c]
                if other >= 0 and other != i:
                    total += agents[other].own_reward
                    near += 1
        if near:
            agents[i].reward += share * total / near
