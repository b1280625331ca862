"""Guidance graphs by name or file: what may be given as `edge_weights`."""

from __future__ import annotations

import math
import sys
from importlib import resources
from pathlib import Path
from reprlib import repr as shortened
from typing import Any, TypeGuard

import numpy as np

from mapf_pz._internal.digest import digest
from mapf_pz.guidance.files import FORMATS, load_guidance
from mapf_pz.guidance.graph import ALONG, GuidanceGraph
from mapf_pz.instances.instance import Grid

EdgeWeights = str | Path | GuidanceGraph
"""A guidance graph, its file, or its name: one of `GENERATED`, `crisscross:ALONG`, `random:SHARE`, or one of
`guidance_names()`."""
GENERATED = ("uniform", "random", "crisscross")
"""Names of the guidance graphs that are generated for any map.

`random` differs in every episode. With `random:SHARE`, the graph is random in this fraction of the episodes and uniform
in the others.
"""


def guidance_names() -> list[str]:
    """Return the names of the bundled guidance graphs, sorted."""
    return sorted(file.stem for file in _bundled().glob("*.npz"))


def is_guidance_file(weights: object) -> TypeGuard[str | Path]:
    """Return whether `weights` is the path of a file: a `Path`, or text that ends in one of `FORMATS`."""
    return isinstance(weights, Path) or (isinstance(weights, str) and weights.endswith(tuple(FORMATS)))


def guidance_file(weights: object) -> Path | None:
    """Return the file of weights that are given by a path or the name of a bundled graph; None for any others."""
    if is_guidance_file(weights):
        return Path(weights)
    return _bundled() / f"{weights}.npz" if isinstance(weights, str) and weights in guidance_names() else None


def weights_digest(weights: object) -> str:
    """Return the name of generated weights, otherwise the digest of the graph or of its file."""
    file = guidance_file(weights)
    return weights if file is None and isinstance(weights, str) else digest(weights if file is None else file)


def check_edge_weights(weights: Any) -> None:
    """Raise `ValueError` unless `weights` is a guidance graph, the path of a file or a known name."""
    if isinstance(weights, GuidanceGraph) or is_guidance_file(weights):
        return
    shown = " ".join(shortened(weights).split())
    if not isinstance(weights, str):
        raise ValueError(f"edge_weights={shown}: expected a name, the path of a file, or a GuidanceGraph")
    names = (*GENERATED, *guidance_names())
    if weights not in names and _along(weights) is None and not random_share(weights):
        advice = f"expected one of {', '.join(map(repr, names))}, or the path of a file ({', '.join(FORMATS)})"
        raise ValueError(f"edge_weights={shown}: {advice}")


def guidance_graph(weights: EdgeWeights, grid: Grid, rng: np.random.Generator | None = None) -> GuidanceGraph:
    """Return the guidance graph of the map `grid` that `weights` specifies; `rng` samples `random` (default: seed 0).

    Raises:
        FileNotFoundError: The file does not exist.
        FormatError: The file is malformed, or its weights are for another map.
        ValueError: The name is unknown, or the graph's shape is not the map's.
    """
    check_edge_weights(weights)
    if isinstance(weights, GuidanceGraph):
        if weights.shape != grid.shape:
            raise ValueError(f"edge_weights of shape {weights.shape}: the map's shape is {grid.shape}")
        return weights
    if weights == "uniform":
        return GuidanceGraph.uniform(grid.free)
    if (along := _along(weights)) is not None:
        return GuidanceGraph.crisscross(grid.free, along)
    if share := random_share(weights):
        rng = np.random.default_rng(0) if rng is None else rng
        # `random` samples nothing but the weights.
        is_random = share == 1 or rng.random() < share
        return GuidanceGraph.random(grid.free, rng) if is_random else GuidanceGraph.uniform(grid.free)
    return load_guidance(weights if is_guidance_file(weights) else _bundled() / f"{weights}.npz", grid)


def fits_any_map(weights: EdgeWeights) -> bool:
    """Return whether weights depend on neither the obstacles of a map nor the episode."""
    return isinstance(weights, GuidanceGraph) or weights == "uniform" or _along(weights) is not None


def random_share(weights: object) -> float:
    """Return the fraction of episodes whose guidance graph is random: 1 for `random`, SHARE for `random:SHARE`, or 0.

    Raises `ValueError` unless it is a number greater than 0 and at most 1.
    """
    return _named_number(weights, "random", default=1, most=1, expected="greater than 0 and at most 1") or 0


def _along(weights: object) -> float | None:
    """Return the weight along the directions of `crisscross` or `crisscross:ALONG`; None for other weights.

    Raises `ValueError` unless it is a number greater than 0.
    """
    return _named_number(weights, "crisscross", default=ALONG, most=sys.float_info.max, expected="greater than 0")


def _named_number(weights: object, name: str, default: float, most: float, expected: str) -> float | None:
    """Return the number of `NAME:NUMBER`, or `default` for `NAME`; None for other weights.

    Raises `ValueError` unless the number is greater than 0 and at most `most`.
    """
    if weights == name:
        return default
    if not isinstance(weights, str) or not weights.startswith(f"{name}:"):
        return None
    try:
        number = float(weights.removeprefix(f"{name}:"))
    except ValueError:
        number = math.nan
    if not 0 < number <= most:
        raise ValueError(f"edge_weights={weights!r}: expected a number {expected} after '{name}:'")
    return number


def _bundled() -> Path:
    return Path(str(resources.files("mapf_pz.guidance"))) / "graphs"
