"""Instances drawn as text, and what planners are given of an instance."""

import numpy as np

from mapf_pz.instances.instance import Grid, Instance, Scenario
from mapf_pz.planners.base import simulator_of
from mapf_pz.planners.problem import problem_of


def drawn(text, headings=None):
    """Read agents a, b, ... and their goals A, B, ... off a drawing; a goal under an agent is `a` alone."""
    rows = [list(line) for line in text.split()]
    free = np.array([[cell != "#" for cell in row] for row in rows])
    at = {cell: (row, col) for row, line in enumerate(rows) for col, cell in enumerate(line)}
    names = sorted(name for name in at if name.islower())
    scenario = Scenario([at[name] for name in names], [at.get(name.upper(), at[name]) for name in names])
    return Instance(Grid(free, "drawn"), scenario, headings)


def problem(instance, weights="uniform"):
    """Return the problem that planners solve."""
    return problem_of(simulator_of(instance, 1000, weights, 0))
