import numpy as np
import pytest

from mapf_pz.instances import load_map
from mapf_pz.instances.instance import Grid, Instance, Scenario
from mapf_pz.planners import PIBT, Plan, record_plan, validate

GRID = Grid(np.ones((1, 4), np.bool_), "corridor")


def test_a_plan_becomes_a_recording():
    instance = Instance(load_map("empty-8-8"), Scenario([[0, 0], [3, 3]], [[5, 5], [0, 0]]), np.array([0, 1]))
    plan = PIBT().solve(instance, time_limit=5.0)
    recording = record_plan(instance, plan)
    np.testing.assert_array_equal(recording.positions, plan.positions)
    np.testing.assert_array_equal(recording.headings, plan.headings)
    assert (recording.goals == instance.scenario.goals).all()
    assert recording.title == "empty-8-8, 2 agents"


def test_several_goals_in_order():
    instance = Instance(GRID, Scenario([[0, 0]], [[[0, 1], [0, 3]]]))
    cells = [[[0, 0]], [[0, 1]], [[0, 2]], [[0, 3]], [[0, 2]], [[0, 1]], [[0, 1]]]
    goals = record_plan(instance, Plan(np.array(cells))).goals
    assert goals[:, 0, 1].tolist() == [1, 3, 3, 1, 1, 3, 3]


@pytest.mark.parametrize("with_goals", [True, False])
def test_illegal_plans_can_be_recorded(with_goals):
    instance = Instance(GRID, Scenario([[0, 0]], [[0, 3]]))
    plan = Plan(np.array([[[0, 0]], [[0, 3]]]))
    assert validate(instance, plan) is not None
    assert (record_plan(instance, plan, with_goals).goals is None) == (not with_goals)
