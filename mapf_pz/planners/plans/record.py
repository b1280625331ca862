"""Recordings of plans, for rendering."""

from __future__ import annotations

from dataclasses import replace
from itertools import cycle

import numpy as np

from mapf_pz._internal.arrays import Ints
from mapf_pz.instances.instance import Instance
from mapf_pz.planners.plans.delayed import DelayedExecution
from mapf_pz.planners.plans.dependencies import NONE
from mapf_pz.planners.plans.plan import Plan, reached
from mapf_pz.render.recording import Recording


def record_plan(instance: Instance, plan: Plan, with_goals: bool = True) -> Recording:
    """Return a recording of a plan, for `mapf_pz.render.save_recording`. The plan need not be legal."""
    goals = instance.scenario.goals
    if not with_goals:
        shown = None
    elif goals.ndim == 2:
        shown = np.broadcast_to(goals, plan.positions.shape)
    else:
        paths = plan.positions.swapaxes(0, 1)
        shown = np.stack([_current_goals(path, own) for path, own in zip(paths, goals, strict=True)], axis=1)
    return Recording(
        free=instance.grid.free,
        positions=plan.positions,
        goals=shown,
        headings=plan.headings,
        lifelong=goals.ndim == 3,
        title=f"{instance.grid.name}, {plan.num_agents} agents",
    )


def record_execution(instance: Instance, execution: DelayedExecution, with_goals: bool = True) -> Recording:
    """Return a recording of an execution under delays: its page shows who was delayed, and who waited for whom."""
    # A recording has what happened in the step before each state, and nothing for the first one.
    return replace(
        record_plan(instance, execution.plan, with_goals),
        delayed=np.pad(execution.delayed, ((1, 0), (0, 0))),
        waits_for=np.pad(execution.waits_for, ((1, 0), (0, 0)), constant_values=NONE),
    )


def _current_goals(path: Ints, goals: Ints) -> Ints:
    """Return an agent's current goal (T + 1, 2) after each step; it visits its goals in order, repeatedly."""
    steps = reached(path, cycle(goals))
    count = np.searchsorted(steps, np.arange(len(path)), side="right")
    return goals[count % len(goals)]
