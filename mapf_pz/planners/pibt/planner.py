"""PIBT as a policy, and as a planner: the fast baseline that scales to thousands of agents."""

from __future__ import annotations

import numpy as np

from mapf_pz.arrays import Ints
from mapf_pz.planners.base import StepPlanner
from mapf_pz.planners.pibt.kernels import PibtState, allocate_pibt, plan
from mapf_pz.simulator import Simulator


class PIBT(StepPlanner):
    """Plans one step at a time, for both action models: see `mapf_pz.planners.pibt.kernels`.

    Where agents shall stay at their goals, an agent's priority rises while it is away, so that each reaches its goal at
    some time, if the map is such that every two neighbouring cells lie on a cycle; all being there at once is not
    promised. In other episodes, agents near their goals come first: more goals are reached in that way.
    """

    def reset_states(self) -> None:
        """Forget the episode: called before each."""
        super().reset_states()
        self._state: PibtState | None = None

    def decide(self, simulator: Simulator) -> Ints:
        """Return the actions (N,) int64 of all agents in the present state of the simulator's first environment."""
        planning_view = simulator.planning_view()
        if self._state is None:
            self._state = allocate_pibt(planning_view, int(self._rng.integers(1, 2**63)))
        actions = np.empty(planning_view.agents.size, np.int64)
        plan(planning_view, simulator.config.on_target != "nothing", self._state, actions)
        return actions
