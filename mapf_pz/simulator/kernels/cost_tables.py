"""The cost-to-go tables in use: computed when first needed, kept while there is room, under a bound in bytes."""

from __future__ import annotations

import numpy as np

from mapf_pz._internal.arrays import Ints
from mapf_pz._internal.jit import Array, jit
from mapf_pz._internal.machine import usable_memory
from mapf_pz.simulator.kernels import cost_bfs, cost_sweeps
from mapf_pz.simulator.kernels.cost_bfs import LANES
from mapf_pz.simulator.kernels.cost_to_go import fill_tables
from mapf_pz.simulator.kernels.state import Distances, World
from mapf_pz.simulator.kernels.world import allocate

CACHE_BYTES = 2**30
"""Where no bound is given: tables that are no longer used are kept up to this size."""


def table_bytes(cells: int, num_headings: int, unit_weights: bool) -> int:
    """Return the size of a table in bytes; `cells` is C + 1, and the others are as in `CostTables`."""
    return 4 * cells * (1 if unit_weights else num_headings + 1)


class CostTables:
    """One cost-to-go table per map and goal, shared by all agents and episodes that head for it.

    Memory is only touched by tables that were computed; a bound in bytes limits how many there can be.
    """

    def __init__(
        self,
        world: World,
        num_headings: int,
        num_goals: int,
        unit_weights: bool,
        max_bytes: int | None = None,
        num_threads: int = 1,
        num_own: int = 0,
    ) -> None:
        """Reserve room for tables.

        Args:
            world: the maps.
            num_headings: 4, or 1 for cardinal agents.
            num_goals: the largest number of goals in use at the same time.
            unit_weights: whether all weights of all maps are 1, so that tables can be packed.
            max_bytes: the bound; None: `default_bytes` of what `num_goals` tables take.
            num_threads: threads that compute tables.
            num_own: how many tables are added for others to write; they come last.
        """
        self.counts_steps = unit_weights
        """Whether the cost to go is the number of steps."""
        self._world = world
        num_maps, cells = world.obstacle.shape
        self._table_bytes = table_bytes(cells, num_headings, unit_weights)
        needed = (num_goals + num_own) * self._table_bytes
        self._max_bytes = default_bytes(needed) if max_bytes is None else max_bytes
        room = max(1, min(self._max_bytes // self._table_bytes - num_own, num_maps * (cells - 1)))
        size = room + num_own
        self.arrays = Distances(
            slot=np.full((num_maps, cells), -1, np.int32),
            packed=np.empty((size if unit_weights else 0, cells), np.uint32),
            exact=np.empty((0 if unit_weights else size, cells, num_headings), np.float32),
            least=np.empty((0 if unit_weights else size, cells), np.float32),
        )
        self._unused = np.arange(room)[::-1].tolist()
        self._num_threads = num_threads
        self._scratch = np.empty((num_threads, 2, cells * num_headings), np.int32)
        self._planes = None
        if unit_weights and cells <= cost_bfs.MOST_CELLS:
            self._planes = cost_bfs.allocate_planes(num_threads, world.height, world.width, num_headings)

    def forget(self, m: int) -> None:
        """Drop the tables of map `m`, which has changed."""
        slots = self.arrays.slot[m]
        self._unused.extend(slots[slots >= 0].tolist())
        slots[:] = -1

    def has_room_for(self, maps: Ints, goals: Ints) -> bool:
        """Return whether the missing tables to `goals` (B, N) on `maps` (B,) fit beside those that are known."""
        return _count_missing(self.arrays.slot, maps, goals) <= len(self._unused)

    def assign(self, maps: Ints, agents: Array) -> None:
        """Set the field `table` of all `agents` (B, N) AGENT; computes what is missing as `require` does."""
        if not _assign(self.arrays.slot, maps, agents):
            self.require(maps, agents["goal"])
            _assign(self.arrays.slot, maps, agents)

    def require(self, maps: Ints, goals: Ints) -> None:
        """Compute the missing tables to `goals` (B, N) on `maps` (B,), which must be all that are needed at present.

        Raises `MemoryError` where these alone are more than the bound allows.
        """
        slot = self.arrays.slot
        if _all_known(slot, maps, goals):
            return
        maps, goals = np.repeat(maps, goals.shape[1]), goals.reshape(-1)
        missing = slot[maps, goals] < 0
        wanted = np.unique(np.ravel_multi_index((maps[missing], goals[missing]), slot.shape))
        count = wanted.size
        if count > len(self._unused):
            self._drop_all_but(maps, goals)
        if count > len(self._unused):
            needed = (count + int((slot >= 0).sum())) * self._table_bytes
            raise MemoryError(
                f"distance_bytes={self._max_bytes}: the cost to go to all goals in use takes {needed} bytes; pass "
                f"distance_bytes={needed} or more (on the command line --distance-bytes {needed})"
            )
        slots = np.array([self._unused.pop() for _ in range(count)], np.int32)
        slot.flat[wanted] = slots
        maps, goals = np.array(np.unravel_index(wanted, slot.shape), np.int32)
        self._fill(maps, goals, slots)

    def _fill(self, maps: Ints, goals: Ints, slots: Ints) -> None:
        """Compute the tables `slots` (K,) of `goals` (K,) on `maps` (K,), which are sorted."""
        counts = np.bincount(maps)[maps]
        together = (self._world.equal_weight[maps] == 0) & (counts >= cost_sweeps.FEWEST_GOALS)
        for m in np.unique(maps[together]):
            here = maps == m
            cost_sweeps.fill_by_sweeps(self._num_threads, self._world, int(m), goals[here], slots[here], self.arrays)
        if self._planes is not None:
            place = np.arange(maps.size) - np.searchsorted(maps, maps)  # among the goals of its map
            sizes = np.minimum(counts - place // LANES * LANES, LANES)  # of its block
            together = sizes >= cost_bfs.FEWEST_GOALS
            begins = np.flatnonzero(together & (place % LANES == 0))
            blocks = begins, sizes[begins]
            if begins.size:
                cost_bfs.fill_by_bfs(
                    self._num_threads, self._world, maps, goals, slots, *blocks, self.arrays, self._planes
                )
        if not together.all():
            work = maps[~together], goals[~together], slots[~together]
            fill_tables(self._num_threads, self._world, *work, self.arrays, self._scratch)

    def _drop_all_but(self, maps: Ints, goals: Ints) -> None:
        slot = self.arrays.slot
        kept = slot[maps, goals]
        dropped = slot.copy()
        dropped[maps, goals] = -1
        self._unused.extend(dropped[dropped >= 0].tolist())
        slot[:] = -1
        slot[maps, goals] = kept


def default_bytes(needed: int) -> int:
    """Return the bound for tables of which `needed` bytes can be in use at the same time.

    It is `CACHE_BYTES`, or as much as is needed, up to half of the memory that can be used.
    """
    return max(CACHE_BYTES, min(needed, (usable_memory() or 0) // 2))


def compile_tables() -> None:
    """Call every kernel that computes tables, so that none of them is compiled later."""
    num_goals = max(cost_sweeps.FEWEST_GOALS, LANES) + 1  # one more than a block
    for unit_weights in (True, False):
        world = allocate(1, (1, num_goals))
        world.equal_weight[0] = float(unit_weights)
        tables = CostTables(world, 4, num_goals, unit_weights)
        tables.require(np.zeros(1, np.int32), np.arange(num_goals, dtype=np.int32)[None])


@jit
def _assign(slot: Array, maps: Array, agents: Array) -> bool:
    """Set every agent's table; return whether all are known."""
    known = True
    for b in range(maps.size):
        for i in range(agents.shape[1]):
            table = slot[maps[b], agents[b, i].goal]
            agents[b, i].table = table
            known &= table >= 0
    return known


@jit
def _all_known(slot: Array, maps: Array, goals: Array) -> bool:
    for b in range(maps.size):
        for goal in goals[b]:
            if slot[maps[b], goal] < 0:
                return False
    return True


@jit
def _count_missing(slot: Array, maps: Array, goals: Array) -> int:
    counted = np.zeros(slot.shape, np.bool_)
    for b in range(maps.size):
        for goal in goals[b]:
            counted[maps[b], goal] |= slot[maps[b], goal] < 0
    return counted.sum()
