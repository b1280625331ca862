"""PIBT as a policy and as a planner: a fast baseline that scales to thousands of agents."""

from __future__ import annotations

import numpy as np

from mapf_pz._internal.arrays import Ints
from mapf_pz.environment.mapf_env import MapfEnv
from mapf_pz.planners.base import StepPlanner
from mapf_pz.planners.pibt.kernels import plan
from mapf_pz.planners.pibt.state import ELAPSED, LATE, NEAREST, Options, PibtState, allocate_pibt
from mapf_pz.simulator.simulator import Simulator

PRIORITIES = {"nearest": NEAREST, "elapsed": ELAPSED, "late": LATE}
"""The names of the priorities."""
PREFERENCES = ("random", "hindrance")
"""The names of the preferences."""


class PIBT(StepPlanner):
    """Plans one step at a time, for both action models: see `mapf_pz.planners.pibt.kernels`.

    If agents must stay at their goals, an agent's priority grows while it is away from its goal. Each agent then
    reaches its goal eventually if every two adjacent cells of the map lie on a cycle; there is no guarantee that all
    agents are at their goals at the same time. In other episodes, the option `priority` decides.
    """

    def __init__(
        self,
        env: MapfEnv | None = None,
        seed: int = 0,
        priority: str = "late",
        swap: bool = True,
        preference: str = "hindrance",
    ) -> None:
        """Create the planner.

        Args:
            env: the environment to act in, or a wrapper of it. With None, only `solve` can be used.
            seed: random seed, used to break ties.
            priority: which agents choose first, unless agents must stay at their goals (`on_target="nothing"`).
                `nearest`: those with the lowest cost to go; `elapsed`: those whose last goal is the longest ago;
                `late`: those that have needed more than four steps per unit of the cost to go since their last goal,
                then the nearest.
            swap: whether agents change places: if they must stay at their goals, those that face each other in a
                corridor; otherwise those of which one must get out of the dead end where the other one's goal is.
            preference: how ties between cells with the same cost are broken. `random`: at random; `hindrance`: in favor
                of the cell that fewer other agents need, then at random.

        Raises `ValueError` for an unknown priority or preference.
        """
        if priority not in PRIORITIES:
            raise ValueError(f"priority={priority!r}: expected one of {', '.join(PRIORITIES)}")
        if preference not in PREFERENCES:
            raise ValueError(f"preference={preference!r}: expected one of {', '.join(PREFERENCES)}")
        self._options = Options(PRIORITIES[priority], bool(swap), preference == "hindrance")
        super().__init__(env, seed)

    def reset_states(self) -> None:
        """Reset all per-episode state. Call it before each episode."""
        super().reset_states()
        self._state: PibtState | None = None

    def decide(self, simulator: Simulator, b: int = 0) -> Ints:
        """Return the actions (N,) int64 of all agents in the current state of environment `b`."""
        planning_view = simulator.planning_view(b)
        if self._state is None:
            num_agents, num_cells = planning_view.agents.size, planning_view.occupant.size - 1
            self._state = allocate_pibt(num_agents, num_cells, int(self._rng.integers(1, 2**63)))
        actions = np.empty(planning_view.agents.size, np.int64)
        plan(planning_view, simulator.config.on_target != "nothing", self._options, self._state, actions)
        return actions
