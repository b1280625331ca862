"""What a step pays: a function of before, actions and after. The terms are the fields of `RewardConfig`."""

from __future__ import annotations

import numpy as np

from mapf_pz.core.conflict import NO_MOVE, direction
from mapf_pz.core.cost_to_go import turned
from mapf_pz.core.jit import jit
from mapf_pz.core.state import Array, Rules


@jit
def pay(rules: Rules, height: int, width: int, agents: Array, actions: Array, occupant: Array, solved: bool) -> None:
    """Set every agent's reward; `solved`: all agents are on their goals at once."""
    for i in range(agents.size):
        agent = agents[i]
        agent.own_reward = 0.0
        if agent.was_active:
            earned = rules.goal if agent.arrived else _action_reward(rules, agent, actions[i])
            earned += rules.progress * agent.progress
            if not agent.at_goal:
                earned -= rules.step_cost
            if agent.blocked:
                earned -= rules.blocked
            if solved:
                earned += rules.team_goal
            agent.own_reward = earned
        agent.reward = agent.own_reward
    if rules.share != 0:
        _share(rules, height, width, agents, occupant)


@jit
def _action_reward(rules: Rules, agent: Array, action: int) -> float:
    if direction(rules.cardinal, agent.was_heading, action) != NO_MOVE:
        return rules.forward if rules.pay_blocked_forward or not agent.blocked else 0.0
    if not rules.cardinal and turned(agent.was_heading, action) != agent.was_heading:
        return rules.rotate
    return rules.wait


@jit
def note_progress(worth: float, mean_weight: float, slot: Array, to_go: Array, m: int, agents: Array) -> None:
    """Note the fall of the cost to go in units of the mean weight; 0 where there is no path, or it is worth nothing."""
    if worth == 0:
        return  # it is 0 since the episode began
    last = to_go.shape[2] - 1  # of D headings, 1 or 4
    for i in range(agents.size):
        agent = agents[i]
        table = slot[m, agent.was_goal]
        before = to_go[table, agent.was_cell, agent.was_heading & last]
        after = to_go[table, agent.cell, agent.heading & last]
        # A blocked edge of the guidance graph can be driven over.
        agent.progress = (before - after) / mean_weight if before < np.inf and after < np.inf else 0.0


@jit
def _share(rules: Rules, height: int, width: int, agents: Array, occupant: Array) -> None:
    """Add `share` times the mean own reward of the other agents within `share_radius` rows and columns."""
    radius = rules.share_radius
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
            agents[i].reward += rules.share * total / near
