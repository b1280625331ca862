"""What all planners share: each is a policy in an environment, and solves instances offline."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, cast

import numpy as np

from mapf_pz.actions import Action, CardinalAction
from mapf_pz.arrays import Ints
from mapf_pz.config import ActionModel, EnvConfig, WeightsName
from mapf_pz.environment import MapfEnv
from mapf_pz.guidance import GuidanceGraph
from mapf_pz.instance import Grid, Instance, Scenario
from mapf_pz.instances.sources import InstanceList
from mapf_pz.planners.problem import Path, Problem, problem_of
from mapf_pz.plans.plan import Plan
from mapf_pz.simulator import Simulator


class Planner(ABC):
    """Bound to an environment it is a policy, `act(observations) -> actions`; unbound it only solves instances.

    A planner looks at the environment's state, not at observations.
    """

    env_kwargs: ClassVar[dict[str, Any]] = {"view_size": (1, 1), "channels": ("view",)}
    """Keywords of an environment that spends no time on observations."""

    def __init__(self, env: MapfEnv | None = None, seed: int = 0) -> None:
        """Bind the planner.

        Args:
            env: the environment to act in, or a wrapper of it; None: only `solve` can be used.
            seed: of the draws between equally good choices.
        """
        self._env = None if env is None else cast("MapfEnv", env.unwrapped)
        self._seed = seed
        self._compiled: set[ActionModel] = set()
        self.reset_states()

    def compile(self, action_model: ActionModel) -> None:
        """Compile every kernel that the planner may call for these agents, or load it from the cache.

        `act` and `solve` do this by themselves before any time limit starts. Without cached kernels it takes up to two
        minutes. Starts a new episode, as `reset_states` does.
        """
        if action_model not in self._compiled:
            self._call_kernels(_simulator_of_corridors(action_model))
            self._compiled.add(action_model)
            self.reset_states()

    def _call_kernels(self, simulator: Simulator) -> None:
        """Call every kernel that planning may call, for two agents at one end of a corridor each."""
        simulator.step(self.decide(simulator)[None])

    def reset_states(self) -> None:
        """Forget the episode: called before each."""
        self._rng = np.random.default_rng(self._seed)

    def act(self, observations: dict[str, Any]) -> dict[str, int]:
        """Return an action for each agent that observes; raises `RuntimeError` without an environment."""
        if self._env is None:
            name = type(self).__name__
            raise RuntimeError(f"{name}: expected an environment to act in, {name}(env)")
        self.compile(self._env.simulator.config.action_model)
        actions = dict(zip(self._env.possible_agents, self.decide(self._env.simulator).tolist(), strict=True))
        return {name: actions[name] for name in observations}

    @abstractmethod
    def decide(self, simulator: Simulator) -> Ints:
        """Return the actions (N,) int64 of all agents in the present state of the simulator's first environment."""

    @abstractmethod
    def solve(
        self,
        instance: Instance,
        time_limit: float = 10.0,
        max_steps: int = 1000,
        edge_weights: WeightsName | GuidanceGraph = "uniform",
        distance_bytes: int | None = None,
    ) -> Plan | None:
        """Return a plan that brings all agents to their goals, or None where none was found.

        Args:
            instance: with headings for agents that turn, without for cardinal ones; one goal for each agent.
            time_limit: seconds; compiling kernels does not count.
            max_steps: the longest plan that is allowed.
            edge_weights: the guidance graph.
            distance_bytes: the most memory for cost-to-go tables, as in `EnvConfig`.
        """


class StepPlanner(Planner):
    """Plans step by step, for all agents at once."""

    def solve(
        self,
        instance: Instance,
        time_limit: float = 10.0,
        max_steps: int = 1000,
        edge_weights: WeightsName | GuidanceGraph = "uniform",
        distance_bytes: int | None = None,
    ) -> Plan | None:
        """Return a plan that brings all agents to their goals, or None where none was found: see `Planner`."""
        self.compile(action_model_of(instance))
        self.reset_states()
        simulator = simulator_of(instance, max_steps, edge_weights, self._seed, distance_bytes)
        return record(simulator, self.decide, time_limit)


class PlanFollower(Planner):
    """Plans all the way to the goals, and follows that plan until a goal changes or the environment does otherwise."""

    def __init__(
        self, env: MapfEnv | None = None, seed: int = 0, time_limit: float = 1.0, anytime: bool = True
    ) -> None:
        """Bind the planner.

        Args:
            env: the environment to act in, or a wrapper of it; None: only `solve` can be used.
            seed: of whatever is drawn.
            time_limit: seconds, whenever it must plan to act.
            anytime: use up the time limit for shorter paths; what comes of it depends on the machine's speed. Without
                it the first solution is returned, which depends on the seed alone.
        """
        self._time_limit = time_limit
        self._anytime = anytime
        super().__init__(env, seed)

    def reset_states(self) -> None:
        """Forget the episode: called before each."""
        super().reset_states()
        self._goals: Ints = np.zeros(0, np.int32)
        self._cells: Ints = np.zeros((0, 0), np.int32)
        self._actions: Ints = np.zeros((0, 0), np.int64)
        self._step = 0

    @abstractmethod
    def plan(self, problem: Problem, time_limit: float) -> Path | None:
        """Return where all agents are until they are at their goals, or None where that was not found in time."""

    def _call_kernels(self, simulator: Simulator) -> None:
        super()._call_kernels(simulator)
        self.plan(problem_of(simulator), math.inf)

    def decide(self, simulator: Simulator) -> Ints:
        """Return the actions (N,) int64 of all agents; all of them wait where there is no plan."""
        agents = simulator.state.agents[0]
        active = agents["active"]
        expected = self._cells[min(self._step, len(self._cells) - 1)] if len(self._cells) else self._goals
        as_planned = np.array_equal(self._goals, agents["goal"]) and (expected == agents["cell"])[active].all()
        if not as_planned:
            self._follow(simulator)
        rests = self._step >= len(self._actions)
        actions = np.full(len(agents), waiting(simulator)) if rests else self._actions[self._step]
        self._step += 1
        return actions

    def _follow(self, simulator: Simulator) -> None:
        """Plan afresh from the present state."""
        agents = simulator.state.agents[0]
        active = agents["active"]
        path = self.plan(problem_of(simulator), self._time_limit)
        self._step, self._goals = 0, agents["goal"].copy()
        steps = 0 if path is None else len(path.cells) - 1
        self._cells = np.tile(agents["cell"], (steps + 1, 1))
        self._actions = np.full((steps, len(agents)), waiting(simulator), np.int64)
        if path is not None:
            self._cells[:, active] = path.cells
            self._actions[:, active] = path.actions(simulator.world.leads_to[simulator.state.map[0]])

    def solve(
        self,
        instance: Instance,
        time_limit: float = 10.0,
        max_steps: int = 1000,
        edge_weights: WeightsName | GuidanceGraph = "uniform",
        distance_bytes: int | None = None,
    ) -> Plan | None:
        """Return a plan that brings all agents to their goals, or None where none was found: see `Planner`."""
        self.compile(action_model_of(instance))
        began = time.perf_counter()
        self.reset_states()
        simulator = simulator_of(instance, max_steps, edge_weights, self._seed, distance_bytes)
        path = self.plan(problem_of(simulator), time_limit - (time.perf_counter() - began))
        if path is None or len(path.cells) > max_steps + 1:
            return None
        return Plan(simulator.places(path.cells), path.headings)


def waiting(simulator: Simulator) -> int:
    """Return the number of the action that waits."""
    return int(CardinalAction.WAIT if simulator.config.action_model == "cardinal" else Action.WAIT)


def action_model_of(instance: Instance) -> ActionModel:
    """Return the action model of the instance's agents: those with headings turn."""
    return "cardinal" if instance.headings is None else "rotate"


def simulator_of(
    instance: Instance,
    max_steps: int,
    edge_weights: WeightsName | GuidanceGraph,
    seed: int,
    distance_bytes: int | None = None,
) -> Simulator:
    """Return a simulator in which the instance's episode has begun, under standard rules (`soft`, stay at target)."""
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


def _simulator_of_corridors(action_model: ActionModel) -> Simulator:
    """Return a simulator with two agents, each with one path to its goal, on a map with weights.

    Two, as arrays of one agent are contiguous where those of several are not: kernels are compiled apart for these.
    """
    grid = Grid(np.array([[True] * 3, [False] * 3, [True] * 3]))
    scenario = Scenario(np.array([[0, 0], [2, 0]]), np.array([[0, 2], [2, 2]]))
    headings = None if action_model == "cardinal" else np.zeros(2, np.int64)
    return simulator_of(Instance(grid, scenario, headings), max_steps=10, edge_weights="crisscross", seed=0)


def record(simulator: Simulator, decide: Callable[[Simulator], Ints], time_limit: float) -> Plan | None:
    """Play the episode that has begun; return it as a plan if it ends with all at their goals, else None.

    It is given up at its last step, or after `time_limit` seconds.
    """
    agents = simulator.state.agents[0]
    cells, headings = [simulator.positions(0)], [agents["heading"].copy()]
    deadline = time.perf_counter() + time_limit
    while not agents["at_goal"].all():
        if agents["truncated"].any() or time.perf_counter() > deadline:
            return None
        simulator.step(decide(simulator)[None])
        cells.append(simulator.positions(0))
        headings.append(agents["heading"].copy())
    cardinal = simulator.config.action_model == "cardinal"
    return Plan(np.stack(cells), None if cardinal else np.stack(headings))
