"""The command `mapf-pz maps`: list the bundled maps, or write their files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, subcommand

from mapf_pz.instances import generate_bundled, load_map, map_names


@dataclass(frozen=True)
class ListMaps:
    """List the bundled maps: name, rows x columns, free cells."""


@dataclass(frozen=True)
class GenerateMaps:
    """Write the files of the bundled maps."""

    folder: Positional[Path]
    """Where to; it is made where it is missing."""


def maps(
    task: Annotated[ListMaps, subcommand("list")] | Annotated[GenerateMaps, subcommand("generate")],
) -> None:
    """List the bundled maps, or write their files."""
    if isinstance(task, GenerateMaps):
        files = generate_bundled(task.folder)
        print(f"{len(files)} maps written to {task.folder}")
        return
    names = map_names()
    for name in names:
        grid = load_map(name)
        print(f"{name:{max(map(len, names))}} {grid.shape[0]:4} x {grid.shape[1]:<4} {grid.free.sum():6} free cells")
