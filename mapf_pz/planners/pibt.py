"""PIBT as a policy, and as a planner: the fast baseline that scales to thousands of agents."""

from __future__ import annotations

import numpy as np

from mapf_pz.core.pibt import Desk, allocate_desk, plan
from mapf_pz.planners.base import StepPlanner
from mapf_pz.simulator import Simulator
from mapf_pz.types import Ints


class PIBT(StepPlanner):
    """Plans one step at a time, for both action models: see `mapf_pz.core.pibt`.

    Where agents shall stay at their goals, an agent's priority rises while it is away, so that each reaches its goal at
    some time, if the map is such that every two neighbouring cells lie on a cycle; all being there at once is not
    promised. In other episodes, agents near their goals come first: more goals are reached in that way.
    """

    def reset_states(self) -> None:
        """Forget the episode: called before each."""
        super().reset_states()
        self._desk: Desk | None = None

    def decide(self, simulator: Simulator) -> Ints:
        """Return the actions (N,) int64 of all agents in the present state of the simulator's first environment."""
        arena = simulator.arena()
        if self._desk is None:
            self._desk = allocate_desk(arena, int(self._rng.integers(1, 2**63)))
        actions = np.empty(arena.crew.size, np.int64)
        plan(arena, simulator.config.on_target != "nothing", self._desk, actions)
        return actions
