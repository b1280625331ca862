"""The experiments on weights: what policies observe of them, and what plans cost in them."""

import numpy as np
import pytest

import mapf_pz
from experiments.ideas import observed_weights
from experiments.planners import weighted_cost
from mapf_pz.guidance import GuidanceGraph
from mapf_pz.instances.instance import Grid, Instance, Scenario
from mapf_pz.planners import planner_of

RULES = {
    "map": "......\n.@@.@.\n......\n.@....\n",
    "num_agents": 3,
    "view_size": (5, 5),
    "view": "centered",
    "on_target": "finish",
    "max_steps": 30,
}
CHANNELS = ("cost_to_go", observed_weights.steps_to_go)
FEATURES = ("action_advantage", observed_weights.step_advantage)


def observed(seed, **keywords):
    """Return the images and features of all agents in an episode of random actions."""
    env = mapf_pz.parallel_env(**RULES, **keywords)
    observations, _ = env.reset(seed=seed)
    rng = np.random.default_rng(seed)
    seen = []
    while env.agents:
        seen += [(one["image"], one["features"]) for one in observations.values()]
        observations, *_ = env.step({agent: int(rng.integers(4)) for agent in env.agents})
    return seen


@pytest.mark.parametrize("seed", range(5))
def test_steps_to_go_are_the_cost_to_go_of_uniform_weights(seed):
    for image, features in observed(seed, channels=CHANNELS, features=FEATURES):
        np.testing.assert_allclose(image[1], image[0], atol=1e-6)
        np.testing.assert_allclose(features[4:], features[:4], atol=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_observed_steps_do_not_depend_on_the_weights(seed):
    free = np.array([[cell == "." for cell in row] for row in RULES["map"].split()])
    parts = {"channels": CHANNELS[1:], "features": FEATURES[1:]}
    uniform = observed(seed, **parts)
    weighted = observed(seed, **parts, edge_weights=GuidanceGraph.random(free, np.random.default_rng(seed)))
    assert len(uniform) == len(weighted) > 0
    for one, other in zip(uniform, weighted, strict=True):
        for part, same in zip(one, other, strict=True):
            np.testing.assert_array_equal(part, same)


def detour():
    """An instance with two ways of equal length from the left to the right, of which the upper one is expensive."""
    grid = Grid(np.array([[True] * 3, [True, False, True], [True] * 3]))
    move = np.full((4, 3, 3), np.inf)
    graph = GuidanceGraph.uniform(grid.free)
    move[:] = graph.move
    move[:, 0] *= 5
    return Instance(grid, Scenario([[1, 0]], [[1, 2]]), [3]), GuidanceGraph(move, graph.wait)


def test_a_plan_for_uniform_weights_costs_more():
    instance, graph = detour()
    known, unknown = weighted_cost.priced(planner_of("pibt"), instance, graph, 1.0)
    assert unknown == 1 + 1 + 5 + 5 + 1 + 5  # north, a turn, two east, a turn, south
    assert known == 2 + 1 + 1 + 1 + 1 + 1 + 1  # two turns, south, a turn, two east, a turn, north


def test_references_pay_the_weights_of_the_episode(monkeypatch):
    instance, graph = detour()
    monkeypatch.setattr(observed_weights, "NUM_AGENTS", 1)
    for weights, expected in ((graph, 8), ("uniform", 18)):
        found = observed_weights.planned(instance, weights, graph)
        assert found["CSR"] == 1
        assert found["weighted_cost_ratio"] == pytest.approx(expected / 8)
