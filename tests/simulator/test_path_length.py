"""The lengths of shortest paths: against the cost to go, and against themselves with its tables."""

import numpy as np
import pytest

from mapf_pz.simulator import Simulator
from mapf_pz.simulator.config import EnvConfig
from mapf_pz.simulator.kernels.path_length import shortest_lengths

MODELS = ("rotate", "cardinal")


@pytest.mark.parametrize("action_model", MODELS)
@pytest.mark.parametrize("density", [0.0, 0.1, 0.3, 0.45])
def test_equal_to_the_cost_to_go(action_model, density):
    """Between random cells of a map with several components, so that some goals cannot be reached."""
    rng = np.random.default_rng([round(100 * density), MODELS.index(action_model)])
    free = rng.random((9, 14)) >= density
    simulator = Simulator(EnvConfig(map=free, num_agents=2, action_model=action_model))
    simulator.reset(seeds={0: 0})
    cells, num_headings = np.flatnonzero(free), {"rotate": 4, "cardinal": 1}[action_model]
    starts, goals = rng.choice(cells, (2, 400))
    headings = rng.integers(num_headings, size=400)
    found = shortest_lengths(simulator.world, 0, starts, headings, goals, num_headings)
    for number, (goal, start, heading) in enumerate(zip(goals, starts, headings, strict=True)):
        ((cost, _),) = simulator._cost_to_go(*(np.full((1, 2), value, np.int32) for value in (goal, start, heading)))
        assert found[number] == (-1 if np.isinf(cost) else cost)
    assert (found == -1).any() == (density > 0.2)


@pytest.mark.parametrize("action_model", MODELS)
def test_metrics_are_the_same_with_tables(action_model):
    keywords = {"map": "random-12-12-15", "num_agents": 4, "action_model": action_model, "max_steps": 9}
    found = []
    for channels in (("view",), ("view", "cost_to_go")):
        simulator = Simulator(EnvConfig(**keywords, channels=channels))
        simulator.reset(seeds={0: 3})
        simulator.step(np.ones((1, 4), np.int64))
        found.append(simulator.metrics(0))
    assert found[0] == found[1]
