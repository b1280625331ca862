"""EPIBT as a policy and as a planner: plans several steps ahead, and uses spare time to improve the plan."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from mapf_pz.arrays import Ints
from mapf_pz.environment import MapfEnv
from mapf_pz.planners.base import StepPlanner
from mapf_pz.planners.epibt import kernels as epibt
from mapf_pz.planners.epibt.operations import operations
from mapf_pz.simulator import Simulator

BATCH_SIZE = 32
"""Number of agents that try to improve the plan between two checks of the clock."""


class EPIBT(StepPlanner):
    """Plans operations of several actions and executes the first action: see `mapf_pz.planners.epibt.kernels`.

    It is designed for lifelong episodes, in which agents nearer to their goals have priority. If agents must stay at
    their goals, priority grows with the time since an agent was at its goal. With a `time_limit`, the actions depend on
    the speed of the machine; without one, only on the seed.
    """

    def __init__(self, env: MapfEnv | None = None, seed: int = 0, depth: int = 4, time_limit: float = 0.0) -> None:
        """Create the planner.

        Args:
            env: the environment to act in, or a wrapper of it. With None, only `solve` can be used.
            seed: random seed.
            depth: number of actions of an operation, 1 to 6.
            time_limit: time limit of a step in seconds. Time that is left after planning is used to improve the plan,
                unless agents must stay at their goals (`on_target="nothing"`).

        Raises `ValueError` for any other depth.
        """
        if not 1 <= depth <= 6:
            raise ValueError(f"depth={depth}: expected a number of actions from 1 to 6")
        self._depth = depth
        self._time_limit = time_limit
        super().__init__(env, seed)

    def reset_states(self) -> None:
        """Reset all per-episode state. Call it before each episode."""
        super().reset_states()
        self._state: epibt.EpibtState | None = None

    def decide(self, simulator: Simulator) -> Ints:
        """Return the actions (N,) int64 of all agents in the current state of the simulator's first environment."""
        start = time.perf_counter()
        planning_view = simulator.planning_view()
        agents = planning_view.agents
        tree = operations(self._depth, simulator.config.action_model == "cardinal")
        if self._state is None:
            self._state = epibt.allocate_epibt(planning_view, tree)
        state = self._state
        passing = simulator.config.on_target != "nothing"
        epibt.plan(planning_view, passing, tree, state)
        # If agents must stay, the lowest sum of costs would keep agents at their goals even where others must pass.
        while passing and time.perf_counter() - start < self._time_limit:
            self._improve(agents, state)
        actions = np.empty(len(agents), np.int64)
        epibt.first_actions(agents, tree, state, actions)
        return actions

    def _improve(self, agents: NDArray[np.void], state: epibt.EpibtState) -> None:
        epibt.improve_sum(self._rng.integers(len(agents), size=BATCH_SIZE), agents, state)

    def _call_kernels(self, simulator: Simulator) -> None:
        super()._call_kernels(simulator)
        if self._state is not None:
            self._improve(simulator.planning_view().agents, self._state)
