"""Mixtures of maps and map families for the episodes of training runs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import partial
from typing import Any

import numpy as np

from mapf_pz.instances import generate
from mapf_pz.instances.instance import Grid
from mapf_pz.instances.library import load_map
from mapf_pz.instances.sources import FixedMap, RandomMaps, SourceMixture

SHELF_DEPTH = 2
"""Height in cells of the shelves of generated warehouses, as in the benchmark's warehouses."""


@dataclass(frozen=True)
class MapMixture:
    """Map families and the ranges of their parameters.

    A number is a fixed value; two numbers are an inclusive range that is sampled for every map. Raises `ValueError` for
    invalid values, or a size that is too small for one of the families.
    """

    maps: tuple[str, ...] = ("random",)
    """The maps that episodes are sampled from: families (`random`, `walls`, `maze`, `primal2`, `room`, `warehouse`),
    names of maps, and paths of `.map` files. All are equally likely; one that is listed twice counts twice."""
    height: int | tuple[int, int] = 12
    """Number of rows of a generated map; two numbers are a range to sample from."""
    width: int | tuple[int, int] = 12
    """Number of columns of a generated map; two numbers are a range to sample from."""
    density: float | tuple[float, float] = 0.15
    """Fraction of the cells of a `random` map that are obstacles; two numbers are a range to sample from."""
    corridor: int | tuple[int, int] = 1
    """Width in cells of the corridors of a `maze` and the aisles of a `warehouse`; two numbers are a range."""
    room_size: int | tuple[int, int] = 5
    """Number of rows and columns of each room of a `room` map, one wall included; two numbers are a range."""
    shelf_length: int | tuple[int, int] = 5
    """Length in cells of the shelves of a `warehouse`; two numbers are a range."""
    loops: float | tuple[float, float] = 0.0
    """Fraction of the walls of a `maze` that are open in addition to those that make all cells reachable; two numbers
    are a range to sample from."""
    wall_density: float | tuple[float, float] = 0.3
    """Fraction of the cells of a `walls` map that are walls; two numbers are a range to sample from."""
    primal2_density: float | tuple[float, float] = (0.0, 1.0)
    """Total length of the walls of a `primal2` maze, which may overlap, as a fraction of its cells; two numbers are a
    range to sample from."""
    primal2_components: int | tuple[int, int] = (4, 8)
    """Largest number of steps, of two cells each, of a wall of a `primal2` maze; two numbers are a range."""
    primal2_straight: float | tuple[float, float] = (0.75, 0.85)
    """Weight of a step straight on of a wall of a `primal2` maze; one minus it is the weight of each other way. Two
    numbers are a range to sample from."""

    def __post_init__(self) -> None:
        """Check every field, and turn lists into tuples."""
        for field in fields(self):
            if isinstance(value := getattr(self, field.name), list):
                object.__setattr__(self, field.name, tuple(value))
        _check_names("maps", self.maps)
        for name, least in (("height", 1), ("width", 1), ("corridor", 1), ("room_size", 2), ("shelf_length", 1)):
            _check_range(name, getattr(self, name), int, least)
        _check_range("primal2_components", self.primal2_components, int, 1)
        for name in ("density", "wall_density", "loops", "primal2_density", "primal2_straight"):
            _check_range(name, getattr(self, name), (int, float), 0)
            most = _bounds(getattr(self, name))[1]
            if most > 1 or (most == 1 and name != "primal2_density"):
                raise ValueError(f"{name}={getattr(self, name)!r}: expected at least 0 and less than 1")
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


def _check_names(name: str, value: Any) -> None:
    if not isinstance(value, tuple) or not value or not all(isinstance(item, str) for item in value):
        raise ValueError(f"{name}={value!r}: expected a tuple of names, at least one")


def _check_range(name: str, value: Any, kind: Any, least: int) -> None:
    """Raise `ValueError` unless `value` is a number from `least` to `MAX_SIZE`, or two in ascending order."""
    ends = _bounds(value)
    numbers = all(isinstance(end, kind) and not isinstance(end, bool) for end in ends)
    if len(ends) != 2 or not numbers or not least <= ends[0] <= ends[1]:
        raise ValueError(f"{name}={value!r}: expected {least} or more, or a range such as ({least}, {least + 4})")
    if ends[1] > generate.MAX_SIZE:
        raise ValueError(f"{name}={value!r}: expected at most {generate.MAX_SIZE}")


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
