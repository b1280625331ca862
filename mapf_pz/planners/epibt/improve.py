"""The improvement of EPIBT's operations: a local search by several threads in separate regions of the map.

As in the winning entries of the League of Robot Runners, any agent may ask any other agent to replan if this lowers the
sum of costs. The map is cut into strips, and an agent whose operations may all be carried out within its strip belongs
to its region. Agents replan only with others of their region, so that threads do not read what others write: the result
does not depend on the number of threads. Cuts change from round to round.
"""

from __future__ import annotations

from numba import prange

from mapf_pz._internal.jit import Array, BatchKernel, jit
from mapf_pz.planners.epibt.search import search
from mapf_pz.planners.epibt.state import NONE, EpibtState


@jit
def cut_regions(agents: Array, width: int, by_row: bool, offset: int, strip: int, state: EpibtState) -> None:
    """Find each agent's region.

    Args:
        agents: (N,) AGENT.
        width: number of columns of the map.
        by_row: whether strips consist of rows, otherwise of columns.
        offset: where the second strip begins, 1 to `strip`.
        strip: number of rows or columns of a strip.
        state: `region` (N,) is set.
    """
    num_regions, reach = state.chain.shape[0], state.used.shape[0] - 1
    for i in range(agents.size):
        row, col = divmod(agents[i].cell, width)
        place = (row if by_row else col) + strip - offset
        region = min(place // strip, num_regions - 1)
        below, above = place - region * strip, (region + 1) * strip - 1 - place
        inside = (region == 0 or below >= reach) and (region == num_regions - 1 or above >= reach)
        state.region[i] = region if inside and agents[i].active else NONE


@BatchKernel
def improve(sampled: Array, state: EpibtState) -> None:
    """For each of the agents `sampled` (K,) that has a region, search for changes that lower the sum of costs."""
    for region in prange(state.chain.shape[0]):
        _improve_region(sampled, region, state)


@jit
def _improve_region(sampled: Array, region: int, state: EpibtState) -> None:
    for i in sampled:
        if state.region[i] == region:
            for k in range(search(i, True, region, state)):
                state.visits[state.asked[region, k]] = 0
