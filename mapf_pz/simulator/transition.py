"""A step of the environment, as reward functions see it: the state before, the actions, and the state after."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from mapf_pz._internal.arrays import Bools, Floats, Ints, coordinates
from mapf_pz._internal.jit import Array


@dataclass(frozen=True)
class Transition:
    """One step of B environments of N agents.

    Arrays may be views of the simulator's own: read them, do not write to them, and copy what outlives the call.
    """

    agents: Array
    """(B, N) records `AGENT` (`mapf_pz.simulator.kernels.state`) after the step."""
    actions: Ints
    """(B, N) int64 actions that the agents chose; delayed agents waited."""
    steps: Ints
    """(B,) int32 steps taken in each episode, this one included."""
    shape: tuple[int, int]
    """(H, W) of the map."""
    _cost_to_go: Callable[[Ints, Ints, Ints], Floats]

    @property
    def positions_before(self) -> Ints:
        """(B, N, 2) int64: [row, col] of each agent before the step."""
        return self._coordinates("was_cell")

    @property
    def positions(self) -> Ints:
        """(B, N, 2) int64: [row, col] of each agent after the step."""
        return self._coordinates("cell")

    @property
    def goals(self) -> Ints:
        """(B, N, 2) int64: [row, col] of the goal that each agent had during the step."""
        return self._coordinates("was_goal")

    @property
    def headings_before(self) -> Ints:
        """(B, N) int32: each agent's `Heading` before the step."""
        return self.agents["was_heading"]

    @property
    def headings(self) -> Ints:
        """(B, N) int32: each agent's `Heading` after the step."""
        return self.agents["heading"]

    @property
    def active(self) -> Bools:
        """(B, N) bool: False for agents that had left before the step; their reward is 0."""
        return self.agents["was_active"]

    @property
    def blocked(self) -> Bools:
        """(B, N) bool: whether an obstacle or another agent prevented the agent's move."""
        return self.agents["blocked"]

    @property
    def delayed(self) -> Bools:
        """(B, N) bool: whether the agent was delayed, and waited."""
        return self.agents["delayed"]

    @property
    def at_goal(self) -> Bools:
        """(B, N) bool: whether the agent ended the step at its goal."""
        return self.agents["at_goal"]

    @property
    def arrived(self) -> Bools:
        """(B, N) bool: whether this was an arrival at a goal; with `on_target="nothing"`, the first one."""
        return self.agents["arrived"]

    @property
    def step_weights(self) -> Floats:
        """(B, N) float32: the weight of the edge that each agent took, or of waiting or turning on its cell.

        It is `inf` for a move along an edge of infinite weight, and 0 for agents that had left before the step.
        """
        return self.agents["step_weight"]

    @property
    def cost_to_go_before(self) -> Floats:
        """(B, N) float32: each agent's cost to go before the step; `inf` where there is no path."""
        return self._cost_to_go(self.agents["was_goal"], self.agents["was_cell"], self.agents["was_heading"])

    @property
    def cost_to_go(self) -> Floats:
        """(B, N) float32: each agent's cost to go to the same goal after the step."""
        return self._cost_to_go(self.agents["was_goal"], self.agents["cell"], self.agents["heading"])

    def _coordinates(self, field: str) -> Ints:
        return coordinates(self.agents[field], self.shape[1])
