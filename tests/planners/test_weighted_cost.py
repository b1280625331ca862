"""Which planners lower the cost in the weights of a guidance graph, and which count steps."""

import numpy as np
import pytest

import mapf_pz
from mapf_pz import GuidanceGraph
from mapf_pz.evaluation import rollout
from mapf_pz.instances.heading import Heading
from mapf_pz.instances.sources import InstanceList
from mapf_pz.planners import PLANNERS
from tests.helpers.text_instances import drawn

LANE = drawn(".....\na...A\n.....")
"""The lane in the middle leads straight to the goal; the way around it takes two more steps."""


def slow_lane():
    """Return a graph in which moves along the lane cost 5, and all others 1."""
    move = np.ones((4, 3, 5))
    move[[Heading.EAST, Heading.WEST], 1] = 5
    return GuidanceGraph(move, np.ones((3, 5)))


@pytest.mark.parametrize("name", ["pibt", "epibt", "windowed"])
def test_planners_of_steps_lower_the_weighted_cost(name):
    """Both in plans and in the metrics of the environment; without the weights, they take the lane."""
    found = []
    for weights in (slow_lane(), "uniform"):
        plan = PLANNERS[name]().solve(LANE, edge_weights=weights)
        found.append((plan.weighted_cost(slow_lane()), plan.sum_of_costs))
    assert found == [(6, 6), (20, 4)]
    env = mapf_pz.parallel_env(source=InstanceList([LANE]), action_model="cardinal", edge_weights=slow_lane())
    metrics = rollout(env, PLANNERS[name](env), seed=0).metrics
    assert (metrics["weighted_cost"], metrics["weighted_cost_ratio"], metrics["SoC_ratio"]) == (6, 1, 6 / 4)


@pytest.mark.parametrize("name", ["prioritized", "cbs"])
def test_planners_of_paths_lower_the_number_of_steps(name):
    plan = PLANNERS[name]().solve(LANE, edge_weights=slow_lane())
    assert (plan.weighted_cost(slow_lane()), plan.sum_of_costs) == (20, 4)
