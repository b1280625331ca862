"""Mixtures of maps and map families for the episodes of training runs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, TypeVar

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field

from mapf_pz._internal.config import Items, Share, as_tuple, checked, expecting
from mapf_pz.instances import generate
from mapf_pz.instances.instance import Grid
from mapf_pz.instances.library import load_map
from mapf_pz.instances.sources import FixedMap, RandomMaps, SourceMixture

SHELF_DEPTH = 2
"""Height in cells of the shelves of generated warehouses, as in the benchmark's warehouses."""


def _ascending(value: Any) -> Any:
    """Raise `ValueError` for a range that ends below its start."""
    if isinstance(value, tuple) and value[0] > value[1]:
        raise ValueError
    return value


_Item = TypeVar("_Item")
_Range = Annotated[_Item | tuple[_Item, _Item], BeforeValidator(as_tuple), AfterValidator(_ascending)]
_OR_RANGE = "or two in ascending order, a range"
Sizes = Annotated[
    _Range[Annotated[int, Field(ge=1, le=generate.MAX_SIZE)]],
    expecting(f"a whole number from 1 to {generate.MAX_SIZE}, {_OR_RANGE}"),
]
"""A number of cells, or the range of one."""
RoomSizes = Annotated[
    _Range[Annotated[int, Field(ge=2, le=generate.MAX_SIZE)]],
    expecting(f"a whole number from 2 to {generate.MAX_SIZE}, {_OR_RANGE}"),
]
"""A number of cells with a wall, or the range of one."""
Fractions = Annotated[
    _Range[Annotated[float, Field(ge=0, lt=1)]], expecting(f"at least 0 and less than 1, {_OR_RANGE}")
]
"""A number less than 1, or the range of one."""
Shares = Annotated[_Range[Share], expecting(f"a number from 0 to 1, {_OR_RANGE}")]
"""A number from 0 to 1, or the range of one."""


@checked
@dataclass(frozen=True)
class MapMixture:
    """Map families and the ranges of their parameters.

    A number is a fixed value; two numbers are an inclusive range that is sampled for every map. Raises `ValueError` for
    invalid values, or a size that is too small for one of the families.
    """

    maps: Annotated[Items[str], Field(min_length=1)] = ("random",)
    """The maps that episodes are sampled from: families (`random`, `walls`, `maze`, `primal2`, `room`, `warehouse`),
    names of maps, and paths of `.map` files. All are equally likely; one that is listed twice counts twice."""
    height: Sizes = 12
    """Number of rows of a generated map; two numbers are a range to sample from."""
    width: Sizes = 12
    """Number of columns of a generated map; two numbers are a range to sample from."""
    density: Fractions = 0.15
    """Fraction of the cells of a `random` map that are obstacles; two numbers are a range to sample from."""
    corridor: Sizes = 1
    """Width in cells of the corridors of a `maze` and the aisles of a `warehouse`; two numbers are a range."""
    room_size: RoomSizes = 5
    """Number of rows and columns of each room of a `room` map, one wall included; two numbers are a range."""
    shelf_length: Sizes = 5
    """Length in cells of the shelves of a `warehouse`; two numbers are a range."""
    loops: Fractions = 0.0
    """Fraction of the walls of a `maze` that are open in addition to those that make all cells reachable; two numbers
    are a range to sample from."""
    wall_density: Fractions = 0.3
    """Fraction of the cells of a `walls` map that are walls; two numbers are a range to sample from."""
    primal2_density: Shares = (0.0, 1.0)
    """Total length of the walls of a `primal2` maze, which may overlap, as a fraction of its cells; two numbers are a
    range to sample from."""
    primal2_components: Sizes = (4, 8)
    """Largest number of steps, of two cells each, of a wall of a `primal2` maze; two numbers are a range."""
    primal2_straight: Fractions = (0.75, 0.85)
    """Weight of a step straight on of a wall of a `primal2` maze; one minus it is the weight of each other way. Two
    numbers are a range to sample from."""

    def __post_init__(self) -> None:
        """Refuse sizes that are too small for one of the families."""
        for family in self.maps:
            if family in _FAMILIES:
                self._check_size(family)

    def source(self, num_agents: int, goals_per_agent: int = 1) -> SourceMixture:
        """Return the source of episodes with `num_agents` agents on these maps.

        All maps of a source have the shape of the largest map. Smaller maps are placed in the upper left corner and
        padded with obstacles. Generated maps without enough space for the agents are generated again.

        Raises:
            FileNotFoundError: A map file does not exist.
            FormatError: A map file is malformed.
            ValueError: A map name is unknown, or one of the maps is too small for the agents.
        """
        grids = {name: load_map(name) for name in self.maps if name not in _FAMILIES}
        shapes = [grid.shape for grid in grids.values()]
        if len(grids) < len(set(self.maps)):
            shapes.append((_bounds(self.height)[1], _bounds(self.width)[1]))
        shape = max(height for height, _ in shapes), max(width for _, width in shapes)

        def source_of(name: str) -> FixedMap | RandomMaps:
            try:
                if name in grids:
                    return FixedMap(generate.on_canvas(grids[name], shape), num_agents, goals_per_agent)
                return RandomMaps(partial(_generate, name, self, shape), num_agents, goals_per_agent)
            except ValueError as error:
                raise ValueError(f"maps: {name!r}: {error}") from None

        return SourceMixture([source_of(name) for name in self.maps])

    def _check_size(self, family: str) -> None:
        """Raise `ValueError` if the smallest size is too small for the family's largest pattern."""
        open_edge = family in ("random", "walls", "primal2")
        least = {"height": 1 if open_edge else 2, "width": 1 if open_edge else 2}
        if family == "warehouse":
            walls_and_aisles = 2 + 2 * _bounds(self.corridor)[1]
            least["height"] = walls_and_aisles + SHELF_DEPTH
            least["width"] = walls_and_aisles + _bounds(self.shelf_length)[1]
        for name, size in least.items():
            if _bounds(getattr(self, name))[0] < size:
                raise ValueError(f"{name}={getattr(self, name)!r}: expected {size} or more for maps={family!r}")


def _bounds(value: float | tuple[float, float]) -> tuple[Any, Any]:
    return value if isinstance(value, tuple) else (value, value)


def _sample(value: int | tuple[int, int], rng: np.random.Generator) -> int:
    """Return a fixed value, without sampling, or a sample from a range."""
    return int(rng.integers(*value, endpoint=True)) if isinstance(value, tuple) else value


def _fraction(value: float | tuple[float, float], rng: np.random.Generator) -> float:
    """Return a fixed value, without sampling, or a sample from a range."""
    return rng.uniform(*value) if isinstance(value, tuple) else value


def _generate(family: str, mixture: MapMixture, shape: tuple[int, int], rng: np.random.Generator) -> Grid:
    """Generate a map of a family, padded with obstacles to `shape` (H, W)."""
    height, width = _sample(mixture.height, rng), _sample(mixture.width, rng)
    return generate.on_canvas(_FAMILIES[family](mixture, height, width, rng), shape)


def _random(mixture: MapMixture, height: int, width: int, rng: np.random.Generator) -> Grid:
    return generate.random(height, width, _fraction(mixture.density, rng), rng)


def _walls(mixture: MapMixture, height: int, width: int, rng: np.random.Generator) -> Grid:
    return generate.walls(height, width, rng, _fraction(mixture.wall_density, rng))


def _maze(mixture: MapMixture, height: int, width: int, rng: np.random.Generator) -> Grid:
    corridor = _sample(mixture.corridor, rng)
    return generate.maze(height, width, rng, corridor, _fraction(mixture.loops, rng))


def _primal2(mixture: MapMixture, height: int, width: int, rng: np.random.Generator) -> Grid:
    density, straight = _fraction(mixture.primal2_density, rng), _fraction(mixture.primal2_straight, rng)
    return generate.primal2(height, width, rng, density, _sample(mixture.primal2_components, rng), straight)


def _room(mixture: MapMixture, height: int, width: int, rng: np.random.Generator) -> Grid:
    return generate.room(height, width, rng, _sample(mixture.room_size, rng))


def _warehouse(mixture: MapMixture, height: int, width: int, rng: np.random.Generator) -> Grid:
    """Generate a warehouse with the maximum number of shelves for its size."""
    length, aisle = _sample(mixture.shelf_length, rng), _sample(mixture.corridor, rng)
    columns = (width - 2 - aisle) // (length + aisle)
    rows = (height - 2 - aisle) // (SHELF_DEPTH + aisle)
    return generate.warehouse(columns, rows, length, SHELF_DEPTH, aisle, margin=aisle)


_FAMILIES: dict[str, Callable[[MapMixture, int, int, np.random.Generator], Grid]] = {
    "random": _random,
    "walls": _walls,
    "maze": _maze,
    "primal2": _primal2,
    "room": _room,
    "warehouse": _warehouse,
}
