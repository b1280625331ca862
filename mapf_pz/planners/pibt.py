"""PIBT as a policy, and as a planner: the fast baseline that scales to thousands of agents."""

from __future__ import annotations

import numpy as np

from mapf_pz.core.pibt import UNDECIDED, allocate_desk, cardinal_actions, plan_cells, rotating_actions
from mapf_pz.planners.base import StepPlanner
from mapf_pz.simulator import Simulator
from mapf_pz.types import Ints


class PIBT(StepPlanner):
    """Plans one step at a time, for both action models: see `mapf_pz.core.pibt`.

    An agent's priority rises while it is away from its goal, so that each reaches it at some time, if the map is such
    that every two neighbouring cells lie on a cycle; all being there at once is not promised.
    """

    def reset_states(self) -> None:
        """Forget the episode: called before each."""
        super().reset_states()
        self._fraction = self._priority = np.zeros(0)

    def decide(self, simulator: Simulator) -> Ints:
        """Return the actions (N,) int64 of all agents in the present state of the simulator's first environment."""
        simulator.require_distances()
        crew, occupant, m = simulator.state.agents[0], simulator.state.occupant[0], int(simulator.state.map[0])
        world, tables = simulator.world, simulator.tables.arrays
        if not self._priority.size:
            # Fractions decide between agents that have been away equally long: those farther away come first.
            cost = simulator.distance_to_go(0).astype(np.float64)
            self._fraction = cost / (cost.max(initial=0) + 1)
            self._priority = self._fraction.copy()
            self._desk = allocate_desk(len(crew), world.obstacle.shape[1] - 1)
        desk, rotates = self._desk, simulator.num_actions == 4
        if rotates:
            desk.want[desk.want == crew["cell"]] = UNDECIDED
        else:
            desk.want[:] = UNDECIDED
        self._priority = np.where(crew["cell"] == crew["goal"], self._fraction, self._priority + 1)
        order = np.argsort(-self._priority, kind="stable")
        ties = self._rng.random((len(crew), 5), np.float32)
        leads_to = world.leads_to[m]
        plan_cells(leads_to, world.weight[m], tables.slot[m], tables.to_go, crew, occupant, order, ties, desk)
        actions = np.empty(len(crew), np.int64)
        if rotates:
            rotating_actions(leads_to, crew, occupant, desk.want, desk.asking, actions)
        else:
            cardinal_actions(leads_to, crew, desk.want, actions)
        return actions
