"""The experiment on edge weights: the costs."""

import numpy as np

import mapf_pz
from experiments.ideas import edge_weights
from mapf_pz.environment.policy import simulator_of
from mapf_pz.guidance import GuidanceGraph
from mapf_pz.simulator.actions import CardinalAction


def test_costs_are_the_weights_of_edges_and_of_waiting():
    east, south, west, north = [2.0, 3.0, np.inf], [np.inf] * 3, [np.inf, 5.0, 7.0], [np.inf] * 3
    graph = GuidanceGraph(np.array([[east], [south], [west], [north]]), np.array([[11.0, 13.0, 17.0]]))
    env = mapf_pz.parallel_env(
        map="...\n", num_agents=1, action_model="cardinal", edge_weights=graph, on_target="restart", max_steps=100
    )
    env.reset(seed=0)
    simulator = simulator_of(env)
    for _ in range(2):
        env.step({"agent_0": CardinalAction.LEFT})  # to the left end
    costs = edge_weights.Costs(simulator)
    costs.add()
    for action in ("RIGHT", "RIGHT", "RIGHT", "LEFT", "WAIT"):  # the third is blocked at the right end
        env.step({"agent_0": CardinalAction[action]})
        costs.add()
    assert costs.total == 2 + 3 + 17 + 7 + 13
