"""What channels and features are drawn from: the state of all environments, and what is in each agent's view."""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np
from numba import prange

from mapf_pz._internal.arrays import coordinates
from mapf_pz._internal.jit import Array, BatchKernel, jit
from mapf_pz.simulator.kernels.cost_lookup import least_costs
from mapf_pz.simulator.kernels.observation.layers import MapLayers, ViewOrigins, ViewShape
from mapf_pz.simulator.kernels.state import CostToGo, Distances, Fields, State, World


class OthersInView(NamedTuple):
    """The other agents in each view; M is the largest possible number of them."""

    count: Array  # (B, N) int32: how many there are
    spots: Array  # (B, N, M) uint32: the cell of the view that each is on, `row * w + column`
    agents: Array  # (B, N, M) uint32: their indices


NO_DISTANCES = Distances(
    slot=np.zeros((0, 0), np.int32),
    packed=np.zeros((0, 0), np.uint32),
    exact=np.zeros((0, 0, 0), np.float32),
    least=np.zeros((0, 0), np.float32),
)
NO_OTHERS = OthersInView(np.zeros((0, 0), np.int32), *np.zeros((2, 0, 0, 0), np.uint32))
"""Empty arrays of the same types, for kernels that do not read them."""


class ObservationInputs:
    """The state of B environments of N agents at one step, as channels and features read it.

    Arrays are views of the simulator's own: read them, do not write to them. `cells`,
    `visible` and `others` are computed once per step, on first use.
    """

    def __init__(
        self,
        view_shape: ViewShape,
        layers: MapLayers,
        origins: ViewOrigins,
        world: World,
        distances: Distances,
        state: State,
        *,
        has_distances: bool,
        cardinal: bool,
        max_steps: int,
        longest_delay: int,
        num_threads: int,
    ) -> None:
        """Keep references to the simulator's arrays."""
        self.view_shape = view_shape
        rows, columns = tuple(range(view_shape.height)), tuple(range(view_shape.width))
        self.layers = layers
        self.origins = origins
        self.geometry: Fields = (tuple(view_shape), rows, columns, tuple(layers), *origins)
        self.world = world
        self._distances = distances
        self.has_distances = has_distances
        """Whether a channel or feature declares `needs_cost_to_go`."""
        self.state = state
        self.cardinal = cardinal
        self.max_steps = max_steps
        self.longest_delay = longest_delay
        """Largest number of steps of a delay; 0: there are none."""
        self.num_threads = num_threads
        num_envs, num_agents = state.agents.shape
        num_cells = view_shape.height * view_shape.width
        each, most = (num_envs, num_agents), min(num_cells, num_agents)
        self._cells = np.empty((*each, num_cells), np.uint32)
        self._visible = np.ones((*each, num_cells), np.bool_)
        self._others = OthersInView(
            np.zeros(each, np.int32), np.empty((*each, most), np.uint32), np.empty((*each, most), np.uint32)
        )

    def forget(self) -> None:
        """Drop what was computed from the state, which has changed."""
        for name in ("cells", "visible", "others"):
            self.__dict__.pop(name, None)

    @property
    def positions(self) -> Array:
        """(B, N, 2) int64: [row, col] of each agent."""
        return self.coordinates(self.state.agents["cell"])

    @property
    def goals(self) -> Array:
        """(B, N, 2) int64: [row, col] of each agent's current goal."""
        return self.coordinates(self.state.agents["goal"])

    @property
    def headings(self) -> Array:
        """(B, N) int32: each agent's `Heading`."""
        return self.state.agents["heading"]

    @property
    def active(self) -> Array:
        """(B, N) bool: False for agents that have disappeared at their goals."""
        return self.state.agents["active"]

    @property
    def last_actions(self) -> Array:
        """(B, N, L) int8: the last L actions of each agent, newest first; -1 before the first step."""
        return self.state.history[..., 0]

    @property
    def delayed(self) -> Array:
        """(B, N) bool: which agents were delayed in the last step."""
        return self.state.agents["delayed"]

    @property
    def steps(self) -> Array:
        """(B,) int32: steps taken in the episode of each environment."""
        return self.state.time

    @property
    def free(self) -> Array:
        """(B, C + 1) bool: which cells of each environment's map are free; entry C stands for outside the map."""
        return self.world.obstacle[self.state.map] == 0

    @property
    def occupants(self) -> Array:
        """(B, C + 1) int32: the index of the agent on each cell; -1: no agent."""
        return self.state.occupant

    @property
    def distances(self) -> Distances:
        """The cost to go, as kernels read it. Raises `RuntimeError` if no channel or feature declares that it reads it.

        Without the declaration, it would not have been computed.
        """
        if not self.has_distances:
            raise RuntimeError(
                "cost_to_go: expected needs_cost_to_go=True in the Channel or Feature that reads it, got False"
            )
        return self._distances

    @property
    def cost_to_go(self) -> Array:
        """(B, N, C + 1) float32: the least cost from each cell to the agent's goal; `inf` where there is no path.

        Raises `RuntimeError` as `distances` does.
        """
        _, *to_go = self.distances
        tables = self.state.agents["table"]
        return least_costs(CostToGo(*to_go), tables.reshape(-1)).reshape(*tables.shape, -1)

    @cached_property
    def cells(self) -> Array:
        """(B, N, h * w) uint32: the cell of the map under each cell of the view; C outside the map.

        Rows of the view follow each other; (h, w) is `view_shape.height` and `view_shape.width`.
        """
        layers, width = self.layers, self.view_shape.width
        _find_cells(self.num_threads, width, layers.cell, layers.stride, *self.origins, self._cells)
        return self._cells

    @cached_property
    def visible(self) -> Array:
        """(B, N, h * w) bool: False where an obstacle hides the cell and `see_through_walls` is False."""
        if not self.view_shape.see_through_walls:
            _find_visible(
                self.num_threads, self.view_shape, self.world.obstacle, self.state.map, self.cells, self._visible
            )
        return self._visible

    @cached_property
    def others(self) -> OthersInView:
        """The other agents in each agent's view, those that it can see."""
        _find_others(self.num_threads, self.state.occupant, self.cells, self.visible, *self._others)
        return self._others

    def coordinates(self, cells: Array) -> Array:
        """Return [row, col] (..., 2) int64 of cell numbers."""
        return coordinates(cells, self.world.width)


@BatchKernel
def _find_cells(width: int, cell: Array, stride: Array, turn: Array, corner: Array, cells: Array) -> None:
    for b in prange(cells.shape[0]):
        _find_cells_of(width, cell, stride, turn[b], corner[b], cells[b])


@jit
def _find_cells_of(width: int, cell: Array, stride: Array, turn: Array, corner: Array, cells: Array) -> None:
    for i in range(cells.shape[0]):
        found, source = cells[i], np.uint64(corner[i])
        for first in range(0, found.size, width):
            for col in range(width):
                found[np.uint64(first + col)] = cell[source + np.uint64(col)]
            source += np.uint64(stride[turn[i]])


@BatchKernel
def _find_visible(view_shape: ViewShape, obstacle: Array, maps: Array, cells: Array, visible: Array) -> None:
    for b in prange(cells.shape[0]):
        _find_visible_of(view_shape, obstacle[maps[b]], cells[b], visible[b])


@jit
def _find_visible_of(view_shape: ViewShape, obstacle: Array, cells: Array, visible: Array) -> None:
    """Find the cells with no obstacle strictly between on the straight (Bresenham) line to them."""
    for i in range(cells.shape[0]):
        for j in range(cells.shape[1]):
            down, right = j // view_shape.width - view_shape.row, j % view_shape.width - view_shape.column
            length = max(abs(down), abs(right))
            visible[i, j] = True
            for k in range(1, length):
                row = view_shape.row + _between(down, k, length)
                column = view_shape.column + _between(right, k, length)
                if obstacle[cells[i, row * view_shape.width + column]] > 0:
                    visible[i, j] = False


@jit
def _between(offset: int, k: int, length: int) -> int:
    """Return step `k` of `length` toward `offset`, rounded to a whole cell, halves away from the observer."""
    return np.sign(offset) * ((2 * k * abs(offset) + length) // (2 * length))


@BatchKernel
def _find_others(occupant: Array, cells: Array, visible: Array, count: Array, spots: Array, others: Array) -> None:
    for b in prange(cells.shape[0]):
        _find_others_of(occupant[b], cells[b], visible[b], count[b], spots[b], others[b])


@jit
def _find_others_of(occupant: Array, cells: Array, visible: Array, count: Array, spots: Array, others: Array) -> None:
    for i in range(cells.shape[0]):
        found = 0
        for j in range(cells.shape[1]):
            other = occupant[cells[i, j]]
            if other >= 0 and other != i and visible[i, j]:
                spots[i, found], others[i, found] = j, other
                found += 1
        count[i] = found
