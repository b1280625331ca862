"""Arrays of users are copied, and never changed without a word."""

import numpy as np
import pytest

from mapf_pz.guidance import GuidanceGraph
from mapf_pz.instances.instance import Grid, Instance, Scenario
from mapf_pz.planners.plans.plan import Plan

GRID = Grid(np.ones((3, 3), bool))
ONE = Scenario([[1, 0]], [[1, 1]])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Scenario([[0.7, 0]], [[1, 1]]), "scenario starts: expected whole numbers"),
        (lambda: Scenario([[1, 0]], [[2**32, 1]]), "scenario goals: expected whole numbers"),
        (lambda: Scenario([[2**70, 0]], [[1, 1]]), "scenario starts: expected whole numbers"),
        (lambda: Scenario([[np.nan, 0]], [[1, 1]]), "scenario starts: expected whole numbers"),
        (lambda: Scenario([[1, 0]], [[[1, 1]]], [1.5]), "scenario goal_counts: expected whole numbers that int32"),
        (lambda: Instance(GRID, ONE, [256]), "headings: expected whole numbers that int8"),
        (lambda: Grid(np.array([[2, 0]])), "map 'custom': expected whole numbers that bool"),
        (lambda: Plan(np.array([[[0.5, 0]]]), None), "plan positions: expected whole numbers that int32"),
        (
            lambda: GuidanceGraph(np.full((4, 3, 3), 1e39), np.ones((3, 3))),
            "move weights: expected finite numbers that float32",
        ),
    ],
)
def test_numbers_that_would_change_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_whole_numbers_of_any_data_type_are_accepted():
    scenario = Scenario(np.array([[1.0, 0.0]]), np.array([[1, 1]], np.uint64))
    assert scenario.starts.dtype == scenario.goals.dtype == np.int32
    assert scenario == Scenario([[1, 0]], [[1, 1]])
    assert np.isinf(GuidanceGraph(np.full((4, 1, 1), np.inf), np.ones((1, 1))).move).all()
    assert GuidanceGraph(np.full((4, 1, 1), 0.1), np.ones((1, 1))).move[0, 0, 0] == np.float32(0.1)
