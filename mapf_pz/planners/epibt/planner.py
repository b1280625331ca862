"""EPIBT as a policy and as a planner: plans several steps ahead, and uses spare time to improve the plan."""

from __future__ import annotations

import numpy as np

from mapf_pz._internal.arrays import Ints
from mapf_pz._internal.jit import numba_config
from mapf_pz.environment.mapf_env import MapfEnv
from mapf_pz.planners.base import StepPlanner
from mapf_pz.planners.deadline import Deadline
from mapf_pz.planners.epibt.improve import cut_regions, improve
from mapf_pz.planners.epibt.kernels import first_actions, plan
from mapf_pz.planners.epibt.operations import operations
from mapf_pz.planners.epibt.state import EpibtState, allocate_epibt
from mapf_pz.simulator.simulator import Simulator

BATCH_SIZE = 64
"""Number of agents per region that try to improve the plan in a round."""


class EPIBT(StepPlanner):
    """Plans operations of several actions and executes the first action: see `mapf_pz.planners.epibt.kernels`.

    It is designed for lifelong episodes, in which agents nearer to their goals have priority. If agents must stay at
    their goals, priority grows with the time since an agent was at its goal. With a `time_limit`, the actions depend on
    the speed of the machine; without one, only on the seed.
    """

    def __init__(
        self,
        env: MapfEnv | None = None,
        seed: int = 0,
        depth: int = 4,
        time_limit: float = 0.0,
        rounds: int = 0,
        num_threads: int = 1,
    ) -> None:
        """Create the planner.

        Args:
            env: the environment to act in, or a wrapper of it. With None, only `solve` can be used.
            seed: random seed.
            depth: number of actions of an operation, 1 to 8. Agents that turn need at least 3. One more action triples
                the number of operations of agents that turn, and time and memory with it.
            time_limit: time limit of a step in seconds. Time that is left after planning is used to improve the plan,
                unless agents must stay at their goals (`on_target="nothing"`).
            rounds: number of rounds of this improvement in each step that are made in any case.
            num_threads: number of threads that improve the plan. The result of a round does not depend on it.

        Raises `ValueError` for any other depth, negative rounds, and a number of threads below 1.
        """
        if not 1 <= depth <= 8:
            raise ValueError(f"depth={depth}: expected a number of actions from 1 to 8")
        if rounds < 0:
            raise ValueError(f"rounds={rounds}: expected a number of rounds, 0 or more")
        if num_threads < 1:
            raise ValueError(f"num_threads={num_threads}: expected a number of threads, 1 or more")
        self._depth = depth
        self._time_limit = time_limit
        self._rounds = rounds
        self._num_threads = min(num_threads, numba_config.NUMBA_NUM_THREADS)
        super().__init__(env, seed)

    def reset_states(self) -> None:
        """Reset all per-episode state. Call it before each episode."""
        super().reset_states()
        self._state: EpibtState | None = None

    def decide(self, simulator: Simulator, b: int = 0) -> Ints:
        """Return the actions (N,) int64 of all agents in the current state of environment `b`."""
        deadline = Deadline(self._time_limit, self.clock)
        planning_view = simulator.planning_view(b)
        tree = operations(self._depth, simulator.config.action_model == "cardinal")
        if self._state is None:
            self._state = allocate_epibt(planning_view, tree, self._num_regions(simulator))
        passing = simulator.config.on_target != "nothing"
        plan(planning_view, passing, tree, self._state)
        rounds = 0
        # If agents must stay, the lowest sum of costs would keep agents at their goals even where others must pass.
        while passing and (rounds < self._rounds or not deadline.has_passed):
            self._improve(simulator, b, self._state)
            rounds += 1
        actions = np.empty(planning_view.agents.size, np.int64)
        first_actions(planning_view.agents, tree, self._state, actions)
        return actions

    def _num_regions(self, simulator: Simulator) -> int:
        """Return the number of regions, such that in all directions about half of the agents are inside one."""
        side = min(simulator.shape)
        return max(side // (3 * self._depth), 2 if side >= 4 * self._depth else 1)

    def _improve(self, simulator: Simulator, b: int, state: EpibtState) -> None:
        """Let some agents of each region try to improve the plan."""
        agents, num_regions = simulator.agents[b], len(state.chain)
        by_row = bool(self._rng.integers(2))
        strip = -(-simulator.shape[not by_row] // num_regions)
        offset = int(self._rng.integers(1, strip + 1))
        cut_regions(agents, simulator.shape[1], by_row, offset, strip, state)
        improve(
            min(self._num_threads, num_regions), self._rng.integers(len(agents), size=BATCH_SIZE * num_regions), state
        )

    def _call_kernels(self, simulator: Simulator) -> None:
        super()._call_kernels(simulator)
        if self._state is not None:
            self._improve(simulator, 0, self._state)
