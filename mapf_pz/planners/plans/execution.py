"""The execution of a dependency graph when agents are delayed."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import chain, repeat

import numpy as np

from mapf_pz._internal.arrays import Bools, Ints
from mapf_pz.planners.plans.dependencies import NONE, DependencyGraph
from mapf_pz.planners.plans.plan import Plan


class Execution:
    """The execution of a dependency graph, step by step: `permitted` agents act, then `advance` counts their actions.

    Delays may be unknown before a step. If all agents try to act that are permitted without delays, the collision
    system `soft` stops each agent that moves to the cell of one that stays, then those behind it. So exactly the agents
    act that are permitted with these delays.
    """

    def __init__(self, graph: DependencyGraph) -> None:
        """Start with all agents at their starts."""
        self.graph = graph
        """The graph."""
        self.done: Ints = np.zeros(graph.num_agents, np.int64)
        """(N,) int64: the number of actions that each agent has executed."""
        self.waits_for: Ints = graph.waits_for
        """(S,) int64: as in the graph."""
        self._agents = graph.agents

    @property
    def states(self) -> Ints:
        """(N,) int64: the state of each agent."""
        return self.graph.first[:-1] + self.done

    @property
    def next_states(self) -> Ints:
        """(N,) int64: the state that each agent's next action leads to; the last state if there is none."""
        return np.minimum(self.states + 1, self.graph.first[1:] - 1)

    @property
    def is_finished(self) -> bool:
        """Whether all actions have been executed."""
        return bool((self.done == self.graph.num_actions).all())

    def permitted(self, delayed: Bools | None = None) -> Bools:
        """Return which agents (N,) execute their next action in this step.

        Args:
            delayed: (N,) bool: the agents that do not act in this step. None: no agent.
        """
        states, next_states = self.states, self.next_states
        awaited = self.waits_for[next_states]
        leaders = self._agents[awaited]  # of no meaning for `NONE`, which is reached
        reached = awaited <= states[leaders]
        acts = (next_states > states) & (reached | (awaited == next_states[leaders]))
        if delayed is not None:
            acts &= ~delayed
        # An agent stays if its leader stays, or the leader's leader: chains and cycles have up to N agents.
        leaders = np.where(reached, np.arange(len(states)), leaders)
        for _ in range(len(states).bit_length()):
            acts &= acts[leaders]
            leaders = leaders[leaders]  # the next round looks twice as far
        return acts

    def waiting_for(self, delayed: Bools) -> Ints:
        """Return the agent (N,) int64 that each agent waits for in this step.

        It is `NONE` for agents that act, are delayed themselves, or have no action left.

        Args:
            delayed: (N,) bool: the agents that do not act in this step.
        """
        waits = (self.next_states > self.states) & ~delayed & ~self.permitted(delayed)
        return np.where(waits, self._agents[self.waits_for[self.next_states]], NONE)

    def allows(self, acted: Bools) -> bool:
        """Return whether exactly the agents `acted` (N,) may execute their next action in the same step."""
        return np.array_equal(self.permitted(~acted), acted)

    def advance(self, acted: Bools, delayed: Bools | None = None) -> None:
        """Count the actions that the agents have executed in a step.

        Args:
            acted: (N,) bool: the agents that acted.
            delayed: (N,) bool: the agents that were delayed, which only `SwitchableExecution` uses. None: no agent.

        Raises `ValueError` if an agent had no action left, or did not wait as the graph says.
        """
        if not self.allows(acted):
            agent = np.flatnonzero(acted & ~self.permitted(~acted))[0]
            raise ValueError(f"agent {agent}: expected it to wait in this step")
        self.done = self.done + acted

    def run(self, delayed: Bools) -> Plan:
        """Execute the actions that are left, and return the plan that is executed.

        Args:
            delayed: (T', N) bool: which agents do not act in each step; after step T', none are delayed.

        Raises `ValueError` for another shape.
        """
        delayed = np.asarray(delayed, np.bool_)
        if delayed.shape[1:] != self.done.shape:
            raise ValueError(f"delayed: expected the shape (T', {len(self.done)}), got {delayed.shape}")
        nobody = np.zeros(len(self.done), np.bool_)
        done = [*(self.done for _ in self.steps(chain(delayed, repeat(nobody)))), self.done]
        return self.graph.plan_of(np.stack(done))

    def steps(self, delayed: Iterable[Bools]) -> Iterator[Bools]:
        """Yield the delayed agents (N,) before each step, which is then executed, until all actions are executed.

        Args:
            delayed: for each step, the agents (N,) bool that do not act.
        """
        for late in delayed:
            if self.is_finished:
                return
            yield late
            self.advance(self.permitted(late), late)

    def lateness(self, step: int) -> Ints:
        """Return by how many steps (N,) each agent is behind the plan after `step` steps; 0 if it is not."""
        late = step + 1 - self.graph.steps[self.next_states]
        return np.where(self.next_states > self.states, np.maximum(late, 0), 0)
