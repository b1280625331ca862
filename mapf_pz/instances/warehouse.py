"""Warehouses: maps with workstations and endpoints, between which goals alternate."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mapf_pz._internal.arrays import Bools, EqualByValue, Ints, frozen
from mapf_pz._internal.json import parse_object
from mapf_pz._internal.text import read_text
from mapf_pz.instances.files.layout import ENDPOINT, PASSABLE, WORKSTATION, cells_of, layout_rows
from mapf_pz.instances.files.movingai import map_rows, parse_map
from mapf_pz.instances.instance import Grid, Instance, Scenario
from mapf_pz.instances.library import LAYOUT_ENDING, map_file
from mapf_pz.instances.place import largest_component

LORR_WORKSTATION, LORR_ENDPOINT = "E", "S"
"""Characters of workstations and endpoints in `.map` files of the League of Robot Runners."""


class Warehouse(NamedTuple):
    """A map with stations."""

    grid: Grid
    """The map."""
    workstations: Ints
    """(W, 2) int32, [row, col]."""
    endpoints: Ints
    """(E, 2) int32, [row, col]: the cells next to shelves."""


def load_warehouse(map: str | Path) -> Warehouse:
    """Read a map with its workstations and endpoints.

    Args:
        map: The path of a GGO map (`.json`), in which `w` are workstations and `e` endpoints; or the name or the path
            of a `.map` file, in which these are `E` and `S`, as in the League of Robot Runners.

    Raises:
        FileNotFoundError: The file does not exist.
        FormatError: The file is malformed.
        ValueError: The name is unknown.
    """
    path = map_file(map)
    text = read_text(path)
    if str(path).endswith(LAYOUT_ENDING):
        rows = layout_rows(parse_object(text, path), path)
        grid = Grid(cells_of(rows, PASSABLE), path.stem)
        return Warehouse(grid, _places(cells_of(rows, WORKSTATION)), _places(cells_of(rows, ENDPOINT)))
    grid = parse_map(text, path)
    rows = map_rows(text, grid.shape[0])
    return Warehouse(grid, _places(cells_of(rows, LORR_WORKSTATION)), _places(cells_of(rows, LORR_ENDPOINT)))


@dataclass(frozen=True, eq=False)
class WarehouseTasks(EqualByValue):
    """Samples starts, and goals that alternate between workstations and endpoints, in each episode.

    Starts are different free cells, all equally likely. An agent that starts on a workstation gets an endpoint first,
    and one that starts on an endpoint a workstation; for others, both are equally likely. Each goal is sampled
    uniformly among the stations of its kind, so several agents may have the same one. These are the tasks of Zhang et
    al., *Guidance Graph Optimization for Lifelong MAPF*, IJCAI 2024.

    Raises `ValueError` if there are no stations of a kind, a station is of both kinds or not in the map's largest
    component, or this component has fewer cells than there are agents.
    """

    grid: Grid
    """The map."""
    workstations: Ints
    """(W, 2) int32, [row, col]."""
    endpoints: Ints
    """(E, 2) int32, [row, col]."""
    num_agents: int
    """N, the number of agents."""
    goals_per_agent: int
    """L, the number of goals of each agent, 2 or more."""
    _cells: Ints = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Copy the arrays, and check them against the map."""
        object.__setattr__(self, "_cells", largest_component(self.grid.free))
        connected = _mask(self._cells, self.grid.shape)
        for name in ("workstations", "endpoints"):
            places = frozen(getattr(self, name), np.int32, name)
            if places.ndim != 2 or places.shape[1] != 2 or len(places) == 0:
                raise ValueError(f"{name}: expected cells [row, col], one or more, got the shape {places.shape}")
            for row, col in places.tolist():
                inside = 0 <= row < self.grid.shape[0] and 0 <= col < self.grid.shape[1]
                if not inside or not connected[row, col]:
                    place = f"[row {row}, col {col}] is not in the largest component of map {self.grid.name!r}"
                    raise ValueError(f"{name}: {place}")
            object.__setattr__(self, name, places)
        if (_mask(self.workstations, self.grid.shape) & _mask(self.endpoints, self.grid.shape)).any():
            raise ValueError("workstations, endpoints: expected different cells")
        if not 1 <= self.num_agents <= len(self._cells):
            raise ValueError(f"num_agents={self.num_agents}: expected 1 to {len(self._cells)}, the cells of the map")
        if self.goals_per_agent < 2:
            raise ValueError(f"goals_per_agent={self.goals_per_agent}: expected 2 or more goals, which alternate")

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W)."""
        return self.grid.shape

    def sample(self, rng: np.random.Generator) -> Instance:
        """Sample starts and goals."""
        starts = self._cells[rng.choice(len(self._cells), self.num_agents, replace=False)]
        rows, cols = starts.T
        from_workstation = rng.integers(2, size=self.num_agents).astype(np.bool_)
        from_workstation |= _mask(self.workstations, self.shape)[rows, cols]
        from_workstation &= ~_mask(self.endpoints, self.shape)[rows, cols]
        size = self.num_agents, self.goals_per_agent
        to_endpoint: Bools = from_workstation[:, None] ^ (np.arange(self.goals_per_agent) % 2 == 1)
        endpoints = self.endpoints[rng.integers(len(self.endpoints), size=size)]
        workstations = self.workstations[rng.integers(len(self.workstations), size=size)]
        return Instance(self.grid, Scenario(starts, np.where(to_endpoint[..., None], endpoints, workstations)))


def _places(cells: Bools) -> Ints:
    return np.argwhere(cells).astype(np.int32)


def _mask(places: Ints, shape: tuple[int, int]) -> Bools:
    """Return an array (H, W) that is True at `places` (M, 2)."""
    mask = np.zeros(shape, np.bool_)
    mask[places[:, 0], places[:, 1]] = True
    return mask
