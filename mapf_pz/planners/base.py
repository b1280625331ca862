"""Base classes of planners. A planner is a policy in an environment, and also solves instances offline."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import partial
from typing import Any, ClassVar, cast

import numpy as np

from mapf_pz._internal.arrays import Ints
from mapf_pz._internal.compilation.dry_run import compile_all
from mapf_pz.environment.mapf_env import MapfEnv
from mapf_pz.guidance import GuidanceGraph
from mapf_pz.guidance.library import EdgeWeights
from mapf_pz.instances.instance import ActionModel, Grid, Instance, Scenario
from mapf_pz.instances.sources import InstanceList
from mapf_pz.planners.deadline import Clock, Deadline, WorkClock
from mapf_pz.planners.following import GraphFollower, StepFollower
from mapf_pz.planners.plans.plan import Plan
from mapf_pz.planners.problem import Path, Problem, obstruction, problem_of
from mapf_pz.planners.trace import Trace
from mapf_pz.simulator.config import EnvConfig
from mapf_pz.simulator.kernels.cost_tables import compile_tables
from mapf_pz.simulator.simulator import Simulator

CLOCKS = ("wall", "work")
"""The names of the clocks of planners of whole paths."""
EXECUTIONS = ("replan", "graph", "switch", "both")
"""What planners of whole paths do when agents are delayed, by name."""


class Planner(ABC):
    """Base class of all planners.

    With an environment, a planner is a policy: `act(observations) -> actions`. Without one, it can only `solve`
    instances. Planners read the environment's state, not the observations.
    """

    env_kwargs: ClassVar[dict[str, Any]] = {"view_size": (1, 1), "channels": ("view",)}
    """Keyword arguments of an environment with the cheapest observations, as planners ignore them."""
    optimal: ClassVar[bool] = False
    """Whether plans have the lowest possible sum of costs."""
    clock: Clock = staticmethod(time.perf_counter)
    """The clock of time limits; `time.thread_time` excludes the time of other processes and threads."""

    def __init__(self, env: MapfEnv | None = None, seed: int = 0) -> None:
        """Create the planner.

        Args:
            env: the environment to act in, or a wrapper of it. With None, only `solve` can be used.
            seed: random seed, used to break ties.
        """
        self._env = None if env is None else cast("MapfEnv", env.unwrapped)
        self._seed = seed
        self.trace = Trace(self.clock)
        """The solutions of the latest call of `solve`, or of the latest plan of whole paths in an episode."""
        self.unsolvable: str | None = None
        """Why the instance of the latest call of `solve`, or the state of the latest plan of whole paths in an episode,
        has no plan at all; None: not proved."""
        self._compiled: set[ActionModel] = set()
        self.reset_states()

    def compile(self, action_model: ActionModel) -> None:
        """Compile every kernel that the planner may call with this action model, or load it from the cache.

        `act` and `solve` call this themselves, before any time limit starts. Without cached kernels it takes half a
        minute on two cores. Like `reset_states`, it resets all per-episode state.
        """
        if action_model not in self._compiled:
            compile_all(partial(self._plan_in_corridors, action_model))
            self._compiled.add(action_model)

    def _plan_in_corridors(self, action_model: ActionModel) -> None:
        """Plan for two agents in separate corridors, and reset all per-episode state."""
        compile_tables()
        simulator = _simulator_of_corridors(action_model)
        obstruction(problem_of(simulator))
        self._call_kernels(simulator)
        self.reset_states()

    def _call_kernels(self, simulator: Simulator) -> None:
        """Call every kernel that planning may call, for two agents in separate corridors."""
        self.decide(simulator)

    def reset_states(self) -> None:
        """Reset all per-episode state. Call it before each episode."""
        self._rng = np.random.default_rng(self._seed)

    def act(self, observations: dict[str, Any]) -> dict[str, int]:
        """Return an action for each agent in `observations`. Raises `RuntimeError` without an environment."""
        if self._env is None:
            name = type(self).__name__
            raise RuntimeError(f"{name}: expected an environment to act in, as in {name}(env)")
        self.compile(self._env.simulator.config.action_model)
        actions = dict(zip(self._env.possible_agents, self.decide(self._env.simulator).tolist(), strict=True))
        return {name: actions[name] for name in observations}

    @abstractmethod
    def decide(self, simulator: Simulator, b: int = 0) -> Ints:
        """Return the actions (N,) int64 of all agents in the current state of environment `b`.

        A planner has the state of one episode: several environments need a planner each.
        """

    def solve(
        self,
        instance: Instance,
        time_limit: float = 10.0,
        max_steps: int = 1000,
        edge_weights: EdgeWeights = "uniform",
        distance_bytes: int | None = None,
        partial: bool = False,
    ) -> Plan | None:
        """Return a plan that brings all agents to their goals, or None if none was found.

        Then `unsolvable` tells whether there is none.

        Args:
            instance: an instance with one goal for each agent; with headings for rotating agents, without headings for
                cardinal agents.
            time_limit: time limit in seconds, which excludes the compilation of kernels.
            max_steps: maximum number of steps of the plan.
            edge_weights: the guidance graph, as in `EnvConfig`.
            distance_bytes: maximum memory for cost-to-go tables, as in `EnvConfig`.
            partial: whether a planner of single steps returns its steps up to the limits if some agents are not at
                their goals then; planners of whole paths return None.
        """
        self.compile(action_model_of(instance))
        deadline = Deadline(time_limit, self.clock)
        self.reset_states()
        self.trace = Trace(self.clock)
        simulator = simulator_of(instance, max_steps, edge_weights, self._seed, distance_bytes)
        self.unsolvable = obstruction(problem_of(simulator))
        plan = None if self.unsolvable and not partial else self._solve(simulator, deadline)
        finished = plan is not None and not plan.away(instance).any()
        if plan is not None and finished:
            self.trace.add(plan.sum_of_costs)
        return plan if finished or partial else None

    @abstractmethod
    def _solve(self, simulator: Simulator, deadline: Deadline) -> Plan | None:
        """Return a plan of the episode, or None if none was found in time; a planner of single steps, its steps."""


class StepPlanner(Planner):
    """Base class of planners that plan one step at a time, for all agents at once."""

    def _call_kernels(self, simulator: Simulator) -> None:
        simulator.step(self.decide(simulator)[None])

    def _solve(self, simulator: Simulator, deadline: Deadline) -> Plan | None:
        agents, steps = simulator.agents[0], Steps(simulator)
        steps.add()
        run_episode(
            simulator, self, lambda _: steps.add(), until=lambda: agents["at_goal"].all() or deadline.has_passed
        )
        return steps.plan()


class PlanFollower(Planner):
    """Base class of planners that plan whole paths.

    They plan again when a goal changes, and when agents are delayed: see `execution`. If they find no plan, all agents
    wait, and they try again after 1, 2, 4, ... steps.
    """

    def __init__(
        self,
        env: MapfEnv | None = None,
        seed: int = 0,
        time_limit: float = 1.0,
        anytime: bool = True,
        clock: str = "wall",
        execution: str = "replan",
        max_lateness: int = 5,
    ) -> None:
        """Create the planner.

        Args:
            env: the environment to act in, or a wrapper of it. With None, only `solve` can be used.
            seed: random seed.
            time_limit: time limit in seconds of each call of `act` that has to plan.
            anytime: use the rest of the time limit to shorten the paths; otherwise the first solution is returned,
                which depends only on the seed.
            clock: what seconds of time limits are. `wall`: those that pass, so that results depend on the machine's
                speed and load; `work`: the planner's work, counted in units of about one second on one core, so
                that results depend only on the seed.
            execution: what to do when agents are delayed. `replan`: make another plan whenever the state is not as
                planned. `graph`: follow the plan's dependency graph (`mapf_pz.planners.DependencyGraph`), by which
                agents wait for others that are late; make another plan only if agents leave their paths. `switch`: as
                `graph`, but agents go before others that are late where that is predicted to be cheaper. `both`: as
                `graph`, and make another plan when an agent is late.
            max_lateness: with `both`, an agent is late if it executes an action at least this many steps later than in
                the latest plan; 1 or more. If no plan is found in time, lateness is measured again from this step.

        Raises `ValueError` for an unknown clock or execution, and a `max_lateness` below 1.
        """
        if clock not in CLOCKS:
            raise ValueError(f"clock={clock!r}: expected one of {', '.join(CLOCKS)}")
        if execution not in EXECUTIONS:
            raise ValueError(f"execution={execution!r}: expected one of {', '.join(EXECUTIONS)}")
        if max_lateness < 1:
            raise ValueError(f"max_lateness={max_lateness}: expected 1 or more")
        if clock == "work":
            self.clock = WorkClock()
        self._time_limit = time_limit
        self._anytime = anytime
        self._execution = execution
        self._max_lateness = max_lateness if execution == "both" else math.inf
        super().__init__(env, seed)

    def reset_states(self) -> None:
        """Reset all per-episode state. Call it before each episode."""
        super().reset_states()
        self.has_plan = False
        """Whether the latest actions are those of a plan; otherwise, all agents wait."""
        self._goals: Ints = np.zeros(0, np.int32)
        self._follower: StepFollower | GraphFollower | None = None
        self._pause = 0  # steps between the latest attempt, if it failed, and the next one
        self._pause_left = 0

    @abstractmethod
    def plan(self, problem: Problem, time_limit: float) -> Path | None:
        """Return paths that bring all agents to their goals, or None if none were found in time."""

    def _call_kernels(self, simulator: Simulator) -> None:
        super()._call_kernels(simulator)
        self.plan(problem_of(simulator), math.inf)

    def decide(self, simulator: Simulator, b: int = 0) -> Ints:
        """Return the actions (N,) int64 of all agents. Without a plan, all agents wait."""
        agents = simulator.agents[b]
        follower = self._follower if np.array_equal(self._goals, agents["goal"]) else None
        self._pause_left -= 1
        if follower is None or not follower.update(agents) or self._pause_left == 0:
            follower = self._follow(self._replan(simulator, b), simulator, b)
        elif isinstance(follower, GraphFollower) and follower.lateness >= self._max_lateness:
            path = self._replan(simulator, b)
            if path is None:
                follower.restart_clock()
            else:
                follower = self._follow(path, simulator, b)
        return follower.actions()

    def _replan(self, simulator: Simulator, b: int) -> Path | None:
        """Return paths from the current state, or None if none were found in time."""
        self.trace, self.unsolvable = Trace(self.clock), None
        return self.plan(problem_of(simulator, b), self._time_limit)

    def _follow(self, path: Path | None, simulator: Simulator, b: int) -> StepFollower | GraphFollower:
        """Follow the paths of the active agents from the current state; None: all agents wait."""
        agents = simulator.agents[b]
        self._pause = max(1, 2 * self._pause) if path is None and not self.unsolvable else 0
        self._pause_left = self._pause
        self.has_plan = path is not None
        if path is None:
            here = agents[agents["active"]][None]
            path = Path(here["cell"], here["heading"])
        self._goals = agents["goal"].copy()
        if self._execution == "replan":
            self._follower = StepFollower(path, simulator, b)
        else:
            self._follower = GraphFollower(path, simulator, b, switch=self._execution == "switch")
        return self._follower

    def _solve(self, simulator: Simulator, deadline: Deadline) -> Plan | None:
        if self.unsolvable:
            return None
        path = self.plan(problem_of(simulator), deadline.seconds_left)
        if path is None or len(path.cells) > simulator.config.max_steps + 1:
            return None
        return Plan(simulator.coordinates(path.cells), path.headings)


class Steps:
    """The steps of an environment's episode, recorded as a plan."""

    def __init__(self, simulator: Simulator, b: int = 0) -> None:
        """Record environment `b`, from the first call of `add`."""
        self._simulator, self._b = simulator, b
        self._positions: list[Ints] = []
        self._headings: list[Ints] = []

    def add(self) -> None:
        """Add the current state."""
        self._positions.append(self._simulator.positions(self._b))
        self._headings.append(self._simulator.agents[self._b]["heading"].copy())

    def plan(self) -> Plan:
        """Return the steps as a plan."""
        cardinal = self._simulator.config.action_model == "cardinal"
        return Plan(np.stack(self._positions), None if cardinal else np.stack(self._headings))


def action_model_of(instance: Instance) -> ActionModel:
    """Return the action model of the instance: `rotate` if it has headings, else `cardinal`."""
    return "cardinal" if instance.headings is None else "rotate"


def simulator_of(
    instance: Instance,
    max_steps: int,
    edge_weights: EdgeWeights,
    seed: int,
    distance_bytes: int | None = None,
) -> Simulator:
    """Return a simulator reset to the instance, with standard rules (`soft` collisions, agents stay at their goals)."""
    simulator = Simulator(
        EnvConfig(
            source=InstanceList([instance]),
            max_steps=max_steps,
            action_model=action_model_of(instance),
            view_size=(1, 1),
            edge_weights=edge_weights,
            distance_bytes=distance_bytes,
        )
    )
    simulator.reset(seeds={0: seed})
    return simulator


def guidance_of(instance: Instance, edge_weights: EdgeWeights, seed: int) -> GuidanceGraph:
    """Return the guidance graph of the episode in which an instance is solved with this seed."""
    return simulator_of(instance, 1, edge_weights, seed).guidance(0)


def lower_bound(instance: Instance, distance_bytes: int | None = None) -> int:
    """Return the sum of the costs of agents with one goal each if they were alone, as in `Plan.costs`."""
    simulator = simulator_of(instance, max_steps=1, edge_weights="uniform", seed=0, distance_bytes=distance_bytes)
    return int(np.maximum(simulator.cost_to_go()[0], 1).sum())


def _simulator_of_corridors(action_model: ActionModel) -> Simulator:
    """Return a simulator with two agents in separate corridors, on a map with weights.

    It takes two agents, because slices of arrays that are contiguous for one agent are not for several, and Numba
    compiles separate code for these.
    """
    grid = Grid(np.array([[True] * 3, [False] * 3, [True] * 3]))
    scenario = Scenario(np.array([[0, 0], [2, 0]]), np.array([[0, 2], [2, 2]]))
    headings = None if action_model == "cardinal" else np.zeros(2, np.int64)
    return simulator_of(Instance(grid, scenario, headings), max_steps=10, edge_weights="crisscross", seed=0)


def run_episode(
    simulator: Simulator,
    planner: Planner,
    on_step: Callable[[Ints], object],
    until: Callable[[], bool] = lambda: False,
) -> None:
    """Let a planner act in environment 0 until the episode is over.

    Args:
        simulator: the simulator, after a reset.
        planner: the planner.
        on_step: is called after each step with the actions (N,).
        until: is called before each step; the episode is left if it returns True.
    """
    while not (simulator.over[0] or until()):
        actions = planner.decide(simulator)
        simulator.step(actions[None])
        on_step(actions)
