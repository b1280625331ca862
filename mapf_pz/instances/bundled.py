"""The bundled maps: their files, and the recipes of those that are generated."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from functools import partial
from importlib import resources
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mapf_pz.instances import generate
from mapf_pz.instances.files.movingai import write_map
from mapf_pz.instances.instance import Grid


class Recipe(NamedTuple):
    """The recipe of a bundled map."""

    generator: Callable[..., Grid]
    """Generates the map; receives `rng` if there is a seed."""
    seed: int | None = None
    """The random seed; None if nothing is random."""
    blocked: str = "@"
    """The character for obstacles in the file."""

    def make(self) -> Grid:
        """Generate the map."""
        if self.seed is None:
            return self.generator()
        return self.generator(rng=np.random.default_rng(self.seed))


BUNDLED: dict[str, Recipe] = {
    "empty-8-8": Recipe(partial(generate.empty, 8, 8)),
    "empty-16-16": Recipe(partial(generate.empty, 16, 16)),
    "empty-32-32": Recipe(partial(generate.empty, 32, 32)),
    "empty-48-48": Recipe(partial(generate.empty, 48, 48)),
    "warehouse-10-20-10-2-1": Recipe(partial(generate.warehouse, 10, 20, 10, 2, 1), blocked="T"),
    "warehouse-10-20-10-2-2": Recipe(partial(generate.warehouse, 10, 20, 10, 2, 2), blocked="T"),
    "warehouse-20-40-10-2-2": Recipe(partial(generate.warehouse, 20, 40, 10, 2, 2), blocked="T"),
    "random-12-12-15": Recipe(partial(generate.random, 12, 12, 0.15), seed=0),
    "random-16-16-20": Recipe(partial(generate.random, 16, 16, 0.20), seed=0),
    "random-24-24-20": Recipe(partial(generate.random, 24, 24, 0.20), seed=2),
    "maze-13-13-1": Recipe(partial(generate.maze, 13, 13, corridor=1), seed=0),
    "maze-16-16-2": Recipe(partial(generate.maze, 16, 16, corridor=2), seed=0),
    "room-16-16-4": Recipe(partial(generate.room, 16, 16, size=4), seed=0),
    "room-20-20-5": Recipe(partial(generate.room, 20, 20, size=5), seed=0),
}
"""The recipes of generated maps, by name. Random maps use the smallest seed whose map is connected."""


def folder() -> Path:
    """Return the folder of the bundled maps."""
    return Path(str(resources.files("mapf_pz.maps")))


def map_names() -> list[str]:
    """Return the names of the bundled maps, sorted."""
    return sorted(file.stem for file in folder().glob("*.map"))


def map_path(name: str) -> Path:
    """Return the file of a bundled map."""
    return folder() / f"{name}.map"


def write_bundled(target: str | Path) -> list[Path]:
    """Write all bundled maps to the folder `target`, which is created if necessary, and return the files.

    Maps with a recipe are generated, the others are copied.
    """
    Path(target).mkdir(parents=True, exist_ok=True)
    files: list[Path] = []
    for name in map_names():
        files.append(Path(target) / f"{name}.map")
        if name in BUNDLED:
            write_map(BUNDLED[name].make(), files[-1], BUNDLED[name].blocked)
        else:
            shutil.copyfile(map_path(name), files[-1])
    return files
