"""EPIBT as a policy, and as a planner: looks some steps ahead, and uses what time there is to do better."""

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

DRAWS = 32
"""So many agents try to improve the plan between two looks at the clock."""


class EPIBT(StepPlanner):
    """Plans operations of several actions, and acts by their first: see `mapf_pz.planners.epibt.kernels`.

    Made for lifelong episodes, in which agents near their goals come first. Where agents shall stay at their goals,
    those come first who have been away for longer. With a `time_limit`, what it does depends on the speed of the
    machine; without one, on the seed alone.
    """

    def __init__(self, env: MapfEnv | None = None, seed: int = 0, depth: int = 4, time_limit: float = 0.0) -> None:
        """Bind the planner.

        Args:
            env: the environment to act in, or a wrapper of it; None: only `solve` can be used.
            seed: of the draws.
            depth: D, the number of actions of an operation, 1 to 6.
            time_limit: seconds for a step; what is left after planning improves the plan, unless agents shall stay at
                their goals (`nothing`).

        Raises `ValueError` for another depth.
        """
        if not 1 <= depth <= 6:
            raise ValueError(f"depth={depth}: expected a number of actions, 1 to 6")
        self._depth = depth
        self._time_limit = time_limit
        super().__init__(env, seed)

    def reset_states(self) -> None:
        """Forget the episode: called before each."""
        super().reset_states()
        self._state: epibt.EpibtState | None = None

    def decide(self, simulator: Simulator) -> Ints:
        """Return the actions (N,) int64 of all agents in the present state of the simulator's first environment."""
        began = time.perf_counter()
        planning_view = simulator.planning_view()
        agents = planning_view.agents
        tree = operations(self._depth, simulator.config.action_model == "cardinal")
        if self._state is None:
            self._state = epibt.allocate_epibt(planning_view, tree)
        state = self._state
        passing = simulator.config.on_target != "nothing"
        epibt.plan(planning_view, passing, tree, state)
        # Where agents shall stay, the least sum of costs would be that nobody leaves a goal to let others pass.
        while passing and time.perf_counter() - began < self._time_limit:
            self._improve(agents, state)
        actions = np.empty(len(agents), np.int64)
        epibt.first_actions(agents, tree, state, actions)
        return actions

    def _improve(self, agents: NDArray[np.void], state: epibt.EpibtState) -> None:
        epibt.improve_sum(self._rng.integers(len(agents), size=DRAWS), agents, state)

    def _call_kernels(self, simulator: Simulator) -> None:
        super()._call_kernels(simulator)
        if self._state is not None:
            self._improve(simulator.planning_view().agents, self._state)
