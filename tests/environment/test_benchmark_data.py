"""Episodes on bundled instances of the benchmark, up to many agents."""

import numpy as np
import pytest

import mapf_pz
from mapf_pz.instances import load_map, load_scenario

WAREHOUSE, PARIS = "warehouse-10-20-10-2-1", "Paris_1_256"
DISTANCES = {"channels": ("view", "goal", "cost_to_go"), "reward": "progress"}


@pytest.mark.parametrize(
    ("name", "num_agents", "keywords"),
    [
        (WAREHOUSE, 10, DISTANCES),
        (WAREHOUSE, 100, DISTANCES),
        (WAREHOUSE, 800, {}),
        (PARIS, 100, DISTANCES | {"distance_bytes": 2**28}),
    ],
)
def test_random_steps_of_benchmark_instances(name, num_agents, keywords):
    env = mapf_pz.parallel_env(map=name, scenario="random-1", num_agents=num_agents, max_steps=64, **keywords)
    observations, _ = env.reset(seed=0)
    scenario = load_scenario("random-1", load_map(name))
    assert np.array_equal(env.positions, scenario.starts[:num_agents])
    assert np.array_equal(env.goals, scenario.goals[:num_agents])
    rng = np.random.default_rng(0)
    start = env.positions
    for _ in range(20):
        actions = rng.choice(4, num_agents, p=(0.7, 0.1, 0.1, 0.1)).tolist()
        observations, *_ = env.step(dict(zip(env.agents, actions, strict=True)))
    assert len(np.unique(env.positions, axis=0)) == num_agents
    assert env.grid[tuple(env.positions.T)].all()
    assert not np.array_equal(env.positions, start)
    assert len(observations) == num_agents
    assert all(env.observation_space(agent).contains(seen) for agent, seen in observations.items())
    assert env.state_space.contains(env.state())
    assert env.metrics()["SoC_ratio"] > 0


@pytest.mark.parametrize("name", [WAREHOUSE, PARIS])
def test_a_cheapest_path_leads_to_the_goal(name):
    """Following the best action of `action_advantage`, an agent alone arrives after its cost to go."""
    env = mapf_pz.parallel_env(
        map=name,
        scenario="random-1",
        num_agents=1,
        max_steps=2000,
        features=("action_advantage",),
    )
    observations, _ = env.reset(seed=0)
    shortest = env.simulator.cost_to_go()[0][0]
    while env.agents:
        best = int(observations["agent_0"]["features"].argmax())
        assert observations["agent_0"]["features"][best] == 0
        observations, *_ = env.step({"agent_0": best})
    assert env.step_count == shortest
    assert env.metrics() == {
        "CSR": 1, "ISR": 1, "SoC": shortest, "makespan": shortest, "ep_length": shortest, "SoC_ratio": 1,
    }  # fmt: skip
