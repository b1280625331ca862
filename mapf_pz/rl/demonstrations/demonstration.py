"""A demonstration: an instance, and the actions of all agents in one episode."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mapf_pz._internal.arrays import Ints
from mapf_pz.instances.instance import Instance, Scenario
from mapf_pz.planners import Planner
from mapf_pz.planners.base import run_episode
from mapf_pz.simulator.simulator import Simulator

METRICS = ("CSR", "ISR", "SoC", "SoC_ratio", "makespan", "ep_length", "avg_throughput")
"""The metrics that are stored, those that the episode has: see `mapf_pz.simulator.metrics`."""


@dataclass(frozen=True, eq=False)
class Demonstration:
    """One episode of a planner."""

    instance: Instance
    """The instance. In a lifelong episode, each agent has as many goals as the most successful agent had."""
    actions: Ints
    """(T, N) uint8: the actions of all agents in each step."""
    seed: int = 0
    """The seed of the episode in which the instance was sampled."""
    metrics: dict[str, float] = field(default_factory=dict[str, float])
    """The metrics of the episode by name, out of `METRICS`."""

    @property
    def num_steps(self) -> int:
        """T, the number of steps."""
        return len(self.actions)

    @property
    def num_agents(self) -> int:
        """N, the number of agents."""
        return self.instance.num_agents


def demonstrate(simulator: Simulator, planner: Planner, seed: int) -> Demonstration:
    """Return an episode of the planner, on the instance that environment 0 of `simulator` samples with this seed."""
    simulator.reset([0], {0: seed})
    planner.reset_states()
    agents = simulator.agents[0]
    starts, headings = simulator.positions(0), agents["heading"].copy()
    actions: list[Ints] = []
    run_episode(simulator, planner, actions.append)
    config, metrics = simulator.config, simulator.metrics(0)
    scenario = Scenario(starts, _goals(simulator))
    return Demonstration(
        Instance(simulator.grid(0), scenario, None if config.action_model == "cardinal" else headings),
        np.array(actions, np.uint8).reshape(-1, len(agents)),
        seed,
        {name: metrics[name] for name in METRICS if name in metrics},
    )


def _goals(simulator: Simulator) -> Ints:
    """Return the goals that agents had in the episode of environment 0: (N, 2), or lifelong (N, L, 2)."""
    if simulator.config.on_target != "restart":
        return simulator.coordinates(simulator.state.goals[0, :, 0])
    reached = int(simulator.agents[0]["arrivals"].max())
    return simulator.coordinates(simulator.state.goals[0, :, : max(reached + 1, 2)])
