"""A policy that executes plans from outside of this package, after validating them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from mapf_pz._internal.arrays import Ints
from mapf_pz.environment.mapf_env import MapfEnv
from mapf_pz.instances.instance import Instance, Scenario
from mapf_pz.planners.plans.plan import Plan, validate
from mapf_pz.planners.problem import Path
from mapf_pz.simulator.actions import wait_action


class NoPlanError(Exception):
    """There is no plan for an instance; the message says why."""


class ExternalPlan(NamedTuple):
    """A plan from outside of this package."""

    plan: Plan
    """The plan."""
    seconds: float = math.nan
    """How long the planner took; NaN: unknown."""


PlanOf = Callable[[Instance, str], ExternalPlan]
"""Returns the plan for an instance with a name, or raises `NoPlanError`."""


class PlannedPolicy:
    """A policy that executes one plan per episode. Without a legal plan, all agents wait, so that the episode fails."""

    def __init__(self, env: MapfEnv, plan_of: PlanOf) -> None:
        """Create the policy.

        Args:
            env: the environment to act in, in which agents have one goal each, and stay there.
            plan_of: returns the plan for an instance; it is called before the first step of an episode.

        Raises:
            ValueError: the environment has other rules.
        """
        self._simulator = env.simulator
        if self._simulator.config.on_target != "nothing":
            got = self._simulator.config.on_target
            raise ValueError(f"on_target={got!r}: expected 'nothing' for external planners, whose agents have one goal")
        self._names = env.possible_agents
        self._plan_of = plan_of
        self.instance_name = ""
        """Name of the next episode's instance, which `plan_of` gets."""
        self.reset_states()

    def reset_states(self) -> None:
        """Forget the plan. Call it before each episode."""
        self._path: Path | None = None
        self._actions: Ints | None = None
        self.note = ""
        """Why the plan of the episode was not executed; empty if it was."""
        self.seconds = math.nan
        """How long the planner took for the plan of the episode; NaN: unknown."""

    def act(self, observations: dict[str, Any]) -> dict[str, int]:
        """Return an action for each agent in `observations`."""
        if self._actions is None:
            self._actions = self._planned_actions()
        step = int(self._simulator.steps[0])
        if not self.note and self._path is not None and step < len(self._path.cells):
            self._check_position(self._path, step)
        waiting = self.note or step >= len(self._actions)
        wait = wait_action(self._simulator.config.action_model)
        actions = np.full(len(self._names), wait) if waiting else self._actions[step]
        by_name = dict(zip(self._names, actions.tolist(), strict=True))
        return {name: by_name[name] for name in observations}

    def _planned_actions(self) -> Ints:
        """Return the actions (T, N) of a legal plan; without one (0, N), and `note` says why."""
        instance = self._instance()
        try:
            external = self._plan_of(instance, self.instance_name)
            self.seconds = external.seconds
            _check(external.plan, instance)
        except NoPlanError as error:
            self.note = str(error)
            return np.zeros((0, len(self._names)), np.int64)
        cells = external.plan.positions @ np.array([self._simulator.shape[1], 1])
        self._path = Path(cells, external.plan.headings)
        return self._path.actions(self._simulator.leads_to(0))

    def _instance(self) -> Instance:
        """Return the instance of the episode, which has just started."""
        simulator = self._simulator
        cardinal = simulator.config.action_model == "cardinal"
        headings = None if cardinal else simulator.agents[0]["heading"].copy()
        return Instance(simulator.grid(0), Scenario(simulator.positions(0), simulator.goals(0)), headings)

    def _check_position(self, path: Path, step: int) -> None:
        """Note if the collision system has blocked moves of the plan, such as those that follow another agent."""
        if not np.array_equal(path.cells[step], self._simulator.agents[0]["cell"]):
            system = self._simulator.config.collision_system
            self.note = f"step {step}: a legal move was blocked by collision_system={system!r}"


def _check(plan: Plan, instance: Instance) -> None:
    """Raise `NoPlanError` unless the plan is legal and has the instance's action model."""
    if plan.num_agents != instance.num_agents:
        raise NoPlanError(f"illegal plan: expected {instance.num_agents} agents, got {plan.num_agents}")
    if (plan.headings is None) != (instance.headings is None):
        expected, got = ("no headings", "headings") if instance.headings is None else ("headings", "none")
        raise NoPlanError(f"illegal plan: expected {expected}, got {got}; see action_model")
    violation = validate(instance, plan)
    if violation is not None:
        raise NoPlanError(f"illegal plan: {violation}")
