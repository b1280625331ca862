"""Plans to look at."""

from __future__ import annotations

from itertools import cycle

import numpy as np

from mapf_pz.arrays import Ints
from mapf_pz.instance import Instance
from mapf_pz.plans.plan import Plan, reached
from mapf_pz.render.recording import Recording


def record_plan(instance: Instance, plan: Plan, with_goals: bool = True) -> Recording:
    """Return a plan as a recording, for `mapf_pz.render.save_recording`; whether it is legal does not matter."""
    goals = instance.scenario.goals
    if not with_goals:
        shown = None
    elif goals.ndim == 2:
        shown = np.broadcast_to(goals, plan.positions.shape)
    else:
        paths = plan.positions.swapaxes(0, 1)
        shown = np.stack([_goals_in_turn(path, own) for path, own in zip(paths, goals, strict=True)], axis=1)
    return Recording(
        free=instance.grid.free,
        positions=plan.positions,
        goals=shown,
        headings=plan.headings,
        title=f"{instance.grid.name}, {plan.num_agents} agents",
    )


def _goals_in_turn(path: Ints, goals: Ints) -> Ints:
    """Return which of its goals, taken one after the other for ever, an agent has after each step: (T + 1, 2)."""
    steps = reached(path, cycle(goals))
    turn = np.searchsorted(steps, np.arange(len(path)), side="right")
    return goals[turn % len(goals)]
