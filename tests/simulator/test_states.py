"""States that are stored: what agents observe in them is what they observed before."""

import numpy as np
import pytest

from mapf_pz.instances import RandomObstacles
from mapf_pz.simulator import Simulator
from mapf_pz.simulator.config import EnvConfig
from mapf_pz.simulator.kernels.observation.channels import CHANNELS
from mapf_pz.simulator.kernels.observation.features import FEATURES

SOURCE = RandomObstacles(7, 6, 0.2, 6)


def played(config, num_steps, num_envs=3):
    simulator = Simulator(config, num_envs)
    simulator.reset(seeds={b: b for b in range(num_envs)})
    rng = np.random.default_rng(0)
    for _ in range(num_steps):
        simulator.step(rng.integers(simulator.num_actions, size=(num_envs, simulator.num_agents)))
        if simulator.over.any():
            simulator.reset(np.flatnonzero(simulator.over).tolist())
    return simulator


@pytest.mark.parametrize("action_model", ["rotate", "cardinal"])
@pytest.mark.parametrize("num_steps", [0, 1, 5, 23])
@pytest.mark.parametrize("edge_weights", ["crisscross", "random"])
def test_observations_are_those_of_the_stored_states(action_model, num_steps, edge_weights):
    config = EnvConfig(
        source=SOURCE,
        action_model=action_model,
        max_steps=30,
        view_size=(5, 5),
        channels=tuple(CHANNELS),
        features=tuple(FEATURES),
        num_last_actions=3,
        delays="0.2:1-4",
        edge_weights=edge_weights,
    )
    simulator, other = played(config, num_steps), played(config, 7)
    other.restore(simulator.states())
    for expected, got in zip(simulator.observe(), other.observe(), strict=True):
        np.testing.assert_array_equal(got, expected)
    assert other.steps.tolist() == simulator.steps.tolist()


def test_goals_of_lifelong_episodes_and_shared_maps():
    for place in ({"map": "random-12-12-15", "num_agents": 5}, {"source": RandomObstacles(7, 6, 0.2, 6, 9)}):
        config = EnvConfig(**place, on_target="restart", max_steps=30, features=("goal_vector", "last_actions"))
        simulator, other = played(config, 20), played(config, 3)
        assert simulator.agents["arrivals"].sum() > 0 or "map" in place
        other.restore(simulator.states())
        for expected, got in zip(simulator.observe(), other.observe(), strict=True):
            np.testing.assert_array_equal(got, expected)


def test_agents_that_disappear_cannot_be_restored():
    simulator = played(EnvConfig(source=SOURCE, on_target="finish"), 2)
    with pytest.raises(ValueError, match="restore: expected agents that stay on the map"):
        simulator.restore(simulator.states())
