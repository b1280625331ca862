"""How planners of whole paths follow them in an episode: step by step, or in the order of the dependency graph."""

from __future__ import annotations

from typing import Any

import numpy as np

from mapf_pz._internal.arrays import Bools, Ints
from mapf_pz.planners.plans.dependencies import DependencyGraph
from mapf_pz.planners.plans.execution import Execution
from mapf_pz.planners.plans.plan import Plan
from mapf_pz.planners.plans.switching import SwitchableExecution
from mapf_pz.planners.problem import Path
from mapf_pz.simulator.actions import wait_action
from mapf_pz.simulator.simulator import Simulator

Agents = Any  # (N,) records `AGENT` (`mapf_pz.simulator.kernels.state`)


class StepFollower:
    """Follows paths step by step, as planned."""

    def __init__(self, path: Path, simulator: Simulator, b: int = 0) -> None:
        """Start from the present state of environment `b`; `path` is that of its M active agents."""
        active = simulator.agents[b]["active"]
        self._members = np.flatnonzero(active)
        self._cells = path.cells
        self._actions = _waits(simulator, len(path.cells))
        self._actions[:-1, active] = path.actions(simulator.leads_to(b))
        self._step = 0

    def update(self, agents: Agents) -> bool:
        """Return whether the active agents are where they are in the plan after this step."""
        mine, expected = agents[self._members], self._cells[min(self._step, len(self._cells) - 1)]
        return bool((mine["cell"] == expected)[mine["active"]].all())

    def actions(self) -> Ints:
        """Return the actions (N,) int64 of all agents in the next step; after the plan, they wait."""
        actions = self._actions[min(self._step, len(self._actions) - 1)].copy()
        self._step += 1
        return actions


class GraphFollower:
    """Follows paths in the order of their dependency graph: agents wait for others that are delayed, as it says.

    The collision system should be `soft`: in the others, agents do not move in cycles, so that they may wait forever.
    """

    def __init__(self, path: Path, simulator: Simulator, b: int = 0, switch: bool = False) -> None:
        """Start from the present state of environment `b`; `path` is that of its M active agents.

        With `switch`, agents may go before others that are late: see `SwitchableExecution`.

        Raises `ValueError` if the paths conflict.
        """
        agents, (height, width) = simulator.agents[b], simulator.shape
        active = agents["active"]
        self._members = np.flatnonzero(active)
        cells = path.cells
        if simulator.config.on_target == "finish":
            cells = _leaving(cells, agents["goal"][active], height * width)
        self._graph = DependencyGraph.from_plan(Plan(simulator.coordinates(cells), path.headings))
        self._execution = SwitchableExecution(self._graph) if switch else Execution(self._graph)
        # By state:
        self._cells = self._graph.positions @ (width, 1)
        self._outside = self._cells >= height * width
        self._waits = _waits(simulator, 1)
        actions = np.concatenate([self._waits[:, active], path.actions(simulator.leads_to(b))])
        self._actions = actions[self._graph.steps, self._graph.agents]
        self._step = 0

    def update(self, agents: Agents) -> bool:
        """Take the present state of all agents (N,); return whether the graph allows the actions that led to it."""
        self._step += 1
        mine, execution = agents[self._members], self._execution
        gone = ~mine["active"]
        execution.done[gone] = self._graph.num_actions[gone]
        states, next_states = execution.states, execution.next_states
        acted = self._at(mine, next_states) & (next_states > states)
        if not (acted | self._at(mine, states) | gone).all() or not execution.allows(acted):
            return False
        execution.advance(acted, mine["delayed"])
        return True

    def actions(self) -> Ints:
        """Return the actions (N,) int64 of all agents in the next step."""
        # An agent at its goal that disappears does so after this step.
        acts = self._execution.permitted(delayed=self._outside[self._execution.next_states])
        actions = self._waits[0].copy()
        actions[self._members] = np.where(acts, self._actions[self._execution.next_states], actions[self._members])
        return actions

    @property
    def lateness(self) -> int:
        """By how many steps the agent that is farthest behind the plan is late, since the start or `restart_clock`."""
        return int(self._execution.lateness(self._step).max(initial=0))

    def restart_clock(self) -> None:
        """Measure lateness from the present state."""
        self._step -= self.lateness

    def _at(self, agents: Agents, states: Ints) -> Bools:
        """Return which agents (M,) are in these states."""
        at = agents["cell"] == self._cells[states]
        if self._graph.headings is not None:
            at &= agents["heading"] == self._graph.headings[states]
        return at


def _waits(simulator: Simulator, num_steps: int) -> Ints:
    """Return actions (T, N) int64 with which all agents wait."""
    return np.full((num_steps, simulator.num_agents), wait_action(simulator.config.action_model), np.int64)


def _leaving(cells: Ints, goals: Ints, num_cells: int) -> Ints:
    """Return the paths `cells` (T + 1, M) of agents that disappear after the step of their arrival.

    Each moves to a separate cell outside of the map in the next step, in which others may enter its goal.
    """
    arrived = np.logical_or.accumulate(cells[1:] == goals, axis=0)
    outside = num_cells + np.arange(len(goals))
    return np.concatenate([cells[:2], np.where(arrived[:-1], outside, cells[2:])])
