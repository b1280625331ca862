"""Packs: `.npz` files of whole numbers and names, each array compressed by LZMA.

`python -m experiments.data.benchmark_packs` writes them from the public data. Cells are numbers, `row * W + col`.
"""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np


def folder() -> Path:
    """Return the folder of the packs."""
    return Path(str(resources.files("mapf_pz.instances.benchmarks")))


def read_arrays(pack: str, *names: str) -> list[Any]:
    """Return some arrays of a pack; only these are decompressed."""
    with np.load(folder() / f"{pack}.npz", allow_pickle=False) as arrays:
        return [arrays[name] for name in names]


def array_names(pack: str) -> list[str]:
    """Return the names of a pack's arrays."""
    with np.load(folder() / f"{pack}.npz", allow_pickle=False) as arrays:
        return list(arrays)
