"""Scenarios of the MovingAI benchmark that come with the package: `MAP-random-1` to `MAP-random-10` of some maps."""

from __future__ import annotations

import re
from functools import cache

from mapf_pz._internal.arrays import coordinates
from mapf_pz.instances.benchmarks.packs import array_names, read_arrays
from mapf_pz.instances.instance import Grid, Scenario

PACK = "movingai"
NUM_SCENARIOS = 10
"""Number of scenarios of each map."""
_SCENARIO = re.compile(r"(.+)-random-([1-9]\d*)")


@cache
def scenario_maps() -> tuple[str, ...]:
    """Return the names of the maps with bundled scenarios, sorted."""
    return tuple(sorted(array_names(PACK)))


def scenario_names() -> list[str]:
    """Return the names of the bundled scenarios."""
    return [f"{name}-random-{number}" for name in scenario_maps() for number in range(1, NUM_SCENARIOS + 1)]


def map_of(scenario: str) -> str | None:
    """Return the name of a bundled scenario's map; None if there is no such scenario."""
    named = _SCENARIO.fullmatch(scenario)
    if named is None or named[1] not in scenario_maps() or int(named[2]) > NUM_SCENARIOS:
        return None
    return named[1]


def read_scenario(scenario: str, grid: Grid) -> Scenario:
    """Return a bundled scenario, whose map is `grid`."""
    name, _, number = scenario.rpartition("-random-")
    (cells,) = read_arrays(PACK, name)
    starts, goals = coordinates(cells[int(number) - 1], grid.shape[1]).swapaxes(0, 1)
    return Scenario(starts, goals)
