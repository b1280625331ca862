"""What all planners share: each is a policy in an environment, and solves instances offline."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, cast

import numpy as np

from mapf_pz.config import EnvConfig, WeightsName
from mapf_pz.environment import MapfEnv
from mapf_pz.guidance import GuidanceGraph
from mapf_pz.instances.sources import InstanceList
from mapf_pz.planners.plan import Plan
from mapf_pz.simulator import Simulator
from mapf_pz.types import Instance, Ints


class Planner(ABC):
    """Bound to an environment it is a policy, `act(observations) -> actions`; unbound it only solves instances.

    A planner looks at the environment's state, not at observations.
    """

    def __init__(self, env: MapfEnv | None = None, seed: int = 0) -> None:
        """Bind the planner.

        Args:
            env: the environment to act in, or a wrapper of it; None: only `solve` can be used.
            seed: of the draws between equally good choices.
        """
        self._env = None if env is None else cast("MapfEnv", env.unwrapped)
        self._seed = seed
        self.reset_states()

    def reset_states(self) -> None:
        """Forget the episode: called before each."""
        self._rng = np.random.default_rng(self._seed)

    def act(self, observations: dict[str, Any]) -> dict[str, int]:
        """Return an action for each agent that observes; raises `RuntimeError` without an environment."""
        if self._env is None:
            name = type(self).__name__
            raise RuntimeError(f"{name}: expected an environment to act in, {name}(env)")
        actions = dict(zip(self._env.possible_agents, self.decide(self._env.simulator).tolist(), strict=True))
        return {name: actions[name] for name in observations}

    @abstractmethod
    def decide(self, simulator: Simulator) -> Ints:
        """Return the actions (N,) int64 of all agents in the present state of the simulator's first environment."""

    @abstractmethod
    def solve(
        self,
        instance: Instance,
        time_limit: float = 10.0,
        max_steps: int = 1000,
        edge_weights: WeightsName | GuidanceGraph = "uniform",
    ) -> Plan | None:
        """Return a plan that brings all agents to their goals, or None where none was found.

        Args:
            instance: with headings for agents that turn, without for cardinal ones; one goal for each agent.
            time_limit: seconds.
            max_steps: the longest plan that is allowed.
            edge_weights: the guidance graph.
        """


class StepPlanner(Planner):
    """Plans step by step, for all agents at once."""

    def solve(
        self,
        instance: Instance,
        time_limit: float = 10.0,
        max_steps: int = 1000,
        edge_weights: WeightsName | GuidanceGraph = "uniform",
    ) -> Plan | None:
        """Return a plan that brings all agents to their goals, or None where none was found: see `Planner`."""
        began = time.perf_counter()
        self.reset_states()
        simulator = simulator_of(instance, max_steps, edge_weights, self._seed)
        return record(simulator, self.decide, until=lambda: time.perf_counter() - began > time_limit)


def simulator_of(instance: Instance, max_steps: int, edge_weights: WeightsName | GuidanceGraph, seed: int) -> Simulator:
    """Return a simulator in which the instance's episode has begun, under standard rules (`soft`, stay at target)."""
    simulator = Simulator(
        EnvConfig(
            source=InstanceList([instance]),
            max_steps=max_steps,
            action_model="cardinal" if instance.headings is None else "rotate",
            view_size=(1, 1),
            edge_weights=edge_weights,
        )
    )
    simulator.reset(seeds={0: seed})
    return simulator


def record(simulator: Simulator, decide: Callable[[Simulator], Ints], until: Callable[[], bool]) -> Plan | None:
    """Play the episode that has begun; return it as a plan if it ends with all at their goals, else None.

    It is given up at its last step, or when `until()` says so.
    """
    crew = simulator.state.agents[0]
    cells, headings = [simulator.positions(0)], [crew["heading"].copy()]
    while not crew["at_goal"].all():
        if crew["truncated"].any() or until():
            return None
        simulator.step(decide(simulator)[None])
        cells.append(simulator.positions(0))
        headings.append(crew["heading"].copy())
    cardinal = simulator.config.action_model == "cardinal"
    return Plan(np.stack(cells), None if cardinal else np.stack(headings))
