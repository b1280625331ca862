"""Shards: files of demonstrations that have the same map size and number of agents.

A shard is an `.npz` file with these arrays, for E demonstrations of N agents on G different maps of H x W cells:

| array | |
| --- | --- |
| `format` | () int64: `FORMAT` |
| `shape` | (2,) int64: H, W |
| `grids`, `names` | (G, ceil(H * W / 8)) uint8: the maps, a bit for each cell, 1 if it is free; (G,) text |
| `grid` | (E,) int64: the map of each demonstration |
| `seeds` | (E,) int64 |
| `starts`, `headings` | (E, N): cell numbers; headings, 0 for cardinal agents |
| `num_goals`, `goals` | (E,): L, the number of goals of each agent; (sum of L, N): cell numbers |
| `num_steps`, `actions` | (E,): T, the number of steps; (sum of T, N) uint8 |
| `metric_names`, `metrics` | (M,) text; (E, M) float64: NaN if a demonstration does not have the metric |

Demonstrations with one goal for each agent have L = 1. Lifelong ones have L >= 2.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mapf_pz._internal.arrays import Ints, coordinates
from mapf_pz._internal.npz import read_npz, write_npz
from mapf_pz._internal.text import MAX_FILE_BYTES
from mapf_pz.errors import FormatError
from mapf_pz.instances.heading import Heading
from mapf_pz.instances.instance import ActionModel, Grid, Instance, Scenario
from mapf_pz.instances.place import components
from mapf_pz.rl.demonstrations.demonstration import METRICS, Demonstration
from mapf_pz.simulator.actions import Action, CardinalAction

FORMAT = 1
"""Version of the format."""
MAX_HEADER_BYTES = 2**12
"""Maximum size of the headers of all arrays."""
MAX_CELLS = 2**26
"""Maximum number of cells of all maps of a shard together."""
_NAMES = (
    *("format", "shape", "grids", "names", "grid", "seeds", "starts", "headings", "num_goals", "goals"),
    *("num_steps", "actions", "metric_names", "metrics"),
)
_MANY = 2**31


@dataclass(frozen=True)
class Shard:
    """The demonstrations of a file, which are decoded one at a time."""

    grids: tuple[Grid, ...]
    """The G maps."""
    grid: Ints
    """(E,): the map of each demonstration."""
    seeds: Ints
    """(E,): the seed of each demonstration."""
    starts: Ints
    """(E, N): cell numbers."""
    headings: Ints | None
    """(E, N), or None for cardinal agents."""
    goal_ends: Ints
    """(E + 1,): the goals of demonstration k are `goals[goal_ends[k] : goal_ends[k + 1]]`."""
    goals: Ints
    """(sum of L, N): cell numbers."""
    step_ends: Ints
    """(E + 1,): the actions of demonstration k are `actions[step_ends[k] : step_ends[k + 1]]`."""
    actions: Ints
    """(sum of T, N) uint8."""
    metrics: tuple[dict[str, float], ...]
    """The metrics of each demonstration."""

    def __len__(self) -> int:
        """Return E, the number of demonstrations."""
        return len(self.starts)

    def sizes(self) -> Ints:
        """Return the size of each demonstration (E, 4) int64: H, W, N, T."""
        shape = self.grids[0].shape if self.grids else (0, 0)
        same = np.tile(np.array([*shape, self.starts.shape[1]], np.int64), (len(self), 1))
        return np.column_stack([same, np.diff(self.step_ends)])

    def demonstration(self, k: int) -> Demonstration:
        """Return demonstration k."""
        grid = self.grids[self.grid[k]]
        goals = _coordinates(self.goals[self.goal_ends[k] : self.goal_ends[k + 1]].T, grid)
        scenario = Scenario(_coordinates(self.starts[k], grid), goals[:, 0] if goals.shape[1] == 1 else goals)
        headings = None if self.headings is None else self.headings[k]
        actions = self.actions[self.step_ends[k] : self.step_ends[k + 1]]
        return Demonstration(Instance(grid, scenario, headings), actions, int(self.seeds[k]), self.metrics[k])


def write_shard(path: Path, demonstrations: Sequence[Demonstration], shape: tuple[int, int], num_agents: int) -> None:
    """Write demonstrations of `num_agents` agents on maps of `shape` (H, W); the file is replaced atomically.

    Raises `ValueError` if they are too many for one file.
    """
    instances = [demonstration.instance for demonstration in demonstrations]
    grids = {(instance.grid.free.tobytes(), instance.grid.name): instance.grid for instance in instances}
    index = {key: number for number, key in enumerate(grids)}
    goals = [instance.goal_cells.T for instance in instances]
    actions = [demonstration.actions for demonstration in demonstrations]
    none = np.zeros((0, num_agents), np.int64)
    packed = -(-shape[0] * shape[1] // 8)
    arrays = {
        "format": np.int64(FORMAT),
        "shape": np.array(shape, np.int64),
        "grids": np.array([np.packbits(grid.free) for grid in grids.values()], np.uint8).reshape(len(grids), packed),
        "names": np.array([grid.name for grid in grids.values()], np.str_),
        "grid": np.array([index[instance.grid.free.tobytes(), instance.grid.name] for instance in instances], np.int64),
        "seeds": np.array([demonstration.seed for demonstration in demonstrations], np.int64),
        "starts": _small([none, *(instance.start_cells[None] for instance in instances)]),
        "headings": _small([none, *(_headings(instance)[None] for instance in instances)]),
        "num_goals": np.array([len(cells) for cells in goals], np.int64),
        "goals": _small([none, *goals]),
        "num_steps": np.array([len(steps) for steps in actions], np.int64),
        "actions": np.concatenate([none, *actions]).astype(np.uint8),
        "metric_names": np.array(METRICS),
        "metrics": np.array(
            [[d.metrics.get(name, np.nan) for name in METRICS] for d in demonstrations], np.float64
        ).reshape(-1, len(METRICS)),
    }
    size, num_cells = sum(array.nbytes for array in arrays.values()), len(grids) * shape[0] * shape[1]
    if size > MAX_FILE_BYTES or num_cells > MAX_CELLS:
        raise ValueError(f"{path}: a shard of {size} bytes and {num_cells} cells; expected a smaller shard_size")
    write_npz(path, arrays)


def read_shard(path: Path, action_model: ActionModel) -> Shard:
    """Return the demonstrations of a file.

    Raises:
        FileNotFoundError: The file does not exist.
        FormatError: The file is malformed.
    """
    arrays = read_npz(path, _NAMES, MAX_FILE_BYTES + MAX_HEADER_BYTES)
    try:
        return _shard(arrays, action_model)
    except (ValueError, LookupError, TypeError) as error:
        raise FormatError(path, f"expected demonstrations: {' '.join(str(error).split())}") from None


def _shard(arrays: Mapping[str, Any], action_model: ActionModel) -> Shard:
    """Return the shard of these arrays; raises `ValueError`, `LookupError` or `TypeError` if they do not fit."""
    if arrays["format"].shape != () or arrays["format"] != FORMAT:
        raise ValueError(f"format: expected {FORMAT}, got {arrays['format']}")
    actions = CardinalAction if action_model == "cardinal" else Action
    count, num_agents = arrays["starts"].shape
    if not num_agents:
        raise ValueError("starts: expected at least one agent")
    grids = _grids(arrays)
    cells = grids[0].free.size if grids else 0
    grid = _numbers(arrays, "grid", (count,), len(grids))
    goal_ends, step_ends = (_ends(_numbers(arrays, name, (count,), _MANY)) for name in ("num_goals", "num_steps"))
    names, metrics = arrays["metric_names"], arrays["metrics"]
    if metrics.shape != (count, *names.shape) or metrics.dtype != np.float64 or names.dtype.kind != "U":
        raise ValueError("metrics: expected a number for each demonstration and name")
    shard = Shard(
        grids=grids,
        grid=grid,
        seeds=_numbers(arrays, "seeds", (count,), 2**63),
        starts=_numbers(arrays, "starts", (count, num_agents), cells),
        headings=_numbers(arrays, "headings", (count, num_agents), len(Heading)),
        goal_ends=goal_ends,
        goals=_numbers(arrays, "goals", (int(goal_ends[-1]), num_agents), cells),
        step_ends=step_ends,
        actions=_numbers(arrays, "actions", (int(step_ends[-1]), num_agents), len(actions)),
        metrics=tuple(
            {name: value for name, value in zip(names.tolist(), row, strict=True) if not math.isnan(value)}
            for row in metrics.tolist()
        ),
    )
    if count:
        _check_cells(shard)
    return replace(shard, headings=None) if action_model == "cardinal" else shard


def _grids(arrays: Mapping[str, Any]) -> tuple[Grid, ...]:
    """Return the maps; raises `ValueError` unless they have the same size and a name each."""
    height, width = _numbers(arrays, "shape", (2,), _MANY).tolist()
    names, packed = arrays["names"], arrays["grids"]
    count = height * width
    if names.ndim != 1 or names.dtype.kind != "U" or len(names) * count > MAX_CELLS:
        raise ValueError(f"names: expected a name for each map, and at most {MAX_CELLS} cells in total")
    packed = _numbers(arrays, "grids", (len(names), -(-count // 8)), 256).astype(np.uint8)
    free = np.unpackbits(packed, axis=1, count=count).reshape(-1, height, width).astype(np.bool_)
    return tuple(map(Grid, free, names.tolist()))


def _check_cells(shard: Shard) -> None:
    """Raise `ValueError` unless the starts of each demonstration differ, and paths lead from there to all goals."""
    if (np.diff(np.sort(shard.starts, axis=1), axis=1) == 0).any():
        raise ValueError("starts: expected different cells")
    labels = np.stack([components(grid.free).ravel() for grid in shard.grids])
    starts = labels[shard.grid[:, None], shard.starts]
    num_goals = np.diff(shard.goal_ends)
    goals = labels[np.repeat(shard.grid, num_goals)[:, None], shard.goals]
    if (np.diff(shard.step_ends) < 1).any():
        raise ValueError("num_steps: expected at least one step of each demonstration")
    if (num_goals < 1).any() or (starts < 0).any() or (goals != np.repeat(starts, num_goals, axis=0)).any():
        raise ValueError("goals: expected at least one goal for each agent, and a path from its start to it")


def _numbers(arrays: Mapping[str, Any], name: str, shape: tuple[int, ...], below: int) -> Ints:
    """Return an array; raises `ValueError` unless it has this shape, and whole numbers from 0 to `below` - 1."""
    array = arrays[name]
    fits = array.shape == shape and np.issubdtype(array.dtype, np.integer)
    if not fits or (array.size and not 0 <= int(array.min()) <= int(array.max()) < below):
        raise ValueError(f"{name}: expected whole numbers from 0 to {below - 1}, of the shape {shape}")
    return array


def _ends(lengths: Ints) -> Ints:
    """Return the sums (K + 1,) of the first 0, 1, ..., K lengths."""
    return np.concatenate([np.zeros(1, np.int64), np.cumsum(lengths, dtype=np.int64)])


def _small(parts: Sequence[Ints]) -> Ints:
    """Return the concatenated parts, whole numbers from 0, in the smallest unsigned type."""
    whole = np.concatenate(parts)
    return whole.astype(np.min_scalar_type(int(whole.max(initial=0))))


def _headings(instance: Instance) -> Ints:
    return np.zeros(instance.num_agents, np.int64) if instance.headings is None else instance.headings


def _coordinates(cells: Ints, grid: Grid) -> Ints:
    return coordinates(cells.astype(np.int64), grid.shape[1])  # small types may not hold the width
