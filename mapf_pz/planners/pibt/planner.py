"""PIBT as a policy and as a planner: a fast baseline that scales to thousands of agents."""

from __future__ import annotations

import numpy as np

from mapf_pz.arrays import Ints
from mapf_pz.planners.base import StepPlanner
from mapf_pz.planners.pibt.kernels import PibtState, allocate_pibt, plan
from mapf_pz.simulator import Simulator


class PIBT(StepPlanner):
    """Plans one step at a time, for both action models: see `mapf_pz.planners.pibt.kernels`.

    If agents must stay at their goals, an agent's priority grows while it is away from its goal. Each agent then
    reaches its goal eventually if every two adjacent cells of the map lie on a cycle; there is no guarantee that all
    agents are at their goals at the same time. In other episodes, agents nearer to their goals have priority, which
    increases the number of goals reached.
    """

    def reset_states(self) -> None:
        """Reset all per-episode state. Call it before each episode."""
        super().reset_states()
        self._state: PibtState | None = None

    def decide(self, simulator: Simulator) -> Ints:
        """Return the actions (N,) int64 of all agents in the current state of the simulator's first environment."""
        planning_view = simulator.planning_view()
        if self._state is None:
            self._state = allocate_pibt(planning_view, int(self._rng.integers(1, 2**63)))
        actions = np.empty(planning_view.agents.size, np.int64)
        plan(planning_view, simulator.config.on_target != "nothing", self._state, actions)
        return actions
