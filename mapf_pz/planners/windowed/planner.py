"""Windowed planning as a policy and as a planner, for lifelong episodes."""

from __future__ import annotations

from typing import NamedTuple

from mapf_pz._internal.arrays import Ints
from mapf_pz.environment.mapf_env import MapfEnv
from mapf_pz.planners.base import StepPlanner
from mapf_pz.planners.deadline import Deadline
from mapf_pz.planners.problem import Path
from mapf_pz.planners.windowed.improve import Neighborhood, allocate_neighborhood, improve
from mapf_pz.planners.windowed.paths import Paths, allocate_paths, continue_paths
from mapf_pz.planners.windowed.rollout import Rollout, allocate_rollout, roll_out, take_rollout
from mapf_pz.planners.windowed.search import SearchScratch, allocate_search
from mapf_pz.simulator.kernels.cost_lookup import num_headings
from mapf_pz.simulator.kernels.state import PlanningView
from mapf_pz.simulator.simulator import Simulator

BATCH_SIZE = 32
"""Number of attempts to improve the paths between two checks of the clock."""
JAMMED = 0.2
"""Agents are in each other's way if their mean delay is above this fraction of the window."""


class WindowedState(NamedTuple):
    """The paths of all agents within the window, and scratch."""

    paths: Paths
    scratch: SearchScratch
    neighborhood: Neighborhood
    rollout: Rollout


class WindowedLNS(StepPlanner):
    """Plans collision-free paths for the next steps and executes the first one.

    In each step, all agents continue their paths (`mapf_pz.planners.windowed.paths`), which are then improved by large
    neighborhood search (`mapf_pz.planners.windowed.improve`). If the agents are still in each other's way, a simulation
    of PIBT replaces the paths where it is better (`mapf_pz.planners.windowed.rollout`).

    It is designed for lifelong episodes, in which it reaches more goals than PIBT and EPIBT. Only crowds of agents
    that turn in which almost every second cell is occupied are better left to EPIBT. If agents must stay at their
    goals, it may leave agents at goals that others must pass; use `LaCAM`. With a `time_limit`, the actions depend on
    the speed of the machine; without one, only on the seed.
    """

    def __init__(
        self, env: MapfEnv | None = None, seed: int = 0, window: int = 20, rounds: int = 4, time_limit: float = 0.0
    ) -> None:
        """Create the planner.

        Args:
            env: the environment to act in, or a wrapper of it. With None, only `solve` can be used.
            seed: random seed.
            window: number of steps to plan, 1 to 100.
            rounds: mean number of attempts to improve the path of each agent in a step, 0 or more.
            time_limit: time limit of a step in seconds. Time that is left after these attempts is used for more.

        Raises `ValueError` for any other window or number of rounds.
        """
        if not 1 <= window <= 100:
            raise ValueError(f"window={window}: expected a number of steps from 1 to 100")
        if rounds < 0:
            raise ValueError(f"rounds={rounds}: expected a number of attempts, 0 or more")
        self._window, self._rounds, self._time_limit = window, rounds, time_limit
        super().__init__(env, seed)

    def reset_states(self) -> None:
        """Reset all per-episode state. Call it before each episode."""
        super().reset_states()
        self._state: WindowedState | None = None

    def decide(self, simulator: Simulator, b: int = 0) -> Ints:
        """Return the actions (N,) int64 of all agents in the current state of environment `b`."""
        deadline = Deadline(self._time_limit, self.clock)
        planning_view = simulator.planning_view(b)
        if self._state is None:
            self._state = self._allocate(planning_view)
        passing, mean_weight = simulator.config.on_target != "nothing", simulator.mean_weight(b)
        paths, scratch, neighborhood, rollout = self._state
        attempts = self._rounds * len(paths.cost)
        continue_paths(planning_view, passing, paths)
        improve(planning_view, passing, mean_weight, attempts, paths, scratch, neighborhood)
        if self._delay(planning_view, paths) > JAMMED * self._window * mean_weight:
            active = planning_view.agents["active"]
            if roll_out(planning_view, passing, neighborhood.random, rollout) < paths.cost[active].sum():
                take_rollout(rollout, paths)
                improve(planning_view, passing, mean_weight, attempts, paths, scratch, neighborhood)
        while not deadline.has_passed:
            improve(planning_view, passing, mean_weight, BATCH_SIZE, paths, scratch, neighborhood)
        return self._first_actions(simulator, b, paths)

    def _allocate(self, planning_view: PlanningView) -> WindowedState:
        seeds = self._rng.integers(1, 2**63, size=2).tolist()
        return WindowedState(
            paths=allocate_paths(planning_view, self._window),
            scratch=allocate_search(self._window, num_headings(planning_view.to_go)),
            neighborhood=allocate_neighborhood(self._window, seeds[0]),
            rollout=allocate_rollout(planning_view, self._window, seeds[1]),
        )

    @staticmethod
    def _delay(planning_view: PlanningView, paths: Paths) -> float:
        """Return the mean of the difference between the cost of an agent's path and its cost to go."""
        active = planning_view.agents["active"]
        return float((paths.cost - paths.least)[active].mean()) if active.any() else 0.0

    @staticmethod
    def _first_actions(simulator: Simulator, b: int, paths: Paths) -> Ints:
        """Return the first action (N,) int64 on each agent's path."""
        rotates = simulator.config.action_model == "rotate"
        step = Path(paths.cell[:, :2].T, paths.heading[:, :2].T if rotates else None)
        return step.actions(simulator.leads_to(b))[0]

    def _call_kernels(self, simulator: Simulator) -> None:
        super()._call_kernels(simulator)
        if self._state is not None:
            roll_out(simulator.planning_view(), True, self._state.neighborhood.random, self._state.rollout)
            take_rollout(self._state.rollout, self._state.paths)
