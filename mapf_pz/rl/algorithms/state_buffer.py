"""A replay buffer of states, in which observations are drawn again when they are learned from.

A state takes about 12 bytes for each agent, an observation hundreds to thousands. So the buffer can keep all steps of a
run, which would not fit into memory as observations.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from hashlib import blake2b
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mapf_pz._internal.arrays import Bools, Floats, Ints
from mapf_pz._internal.npz import read_npz, write_npz
from mapf_pz.errors import FormatError
from mapf_pz.guidance.library import random_share
from mapf_pz.simulator.config import EnvConfig
from mapf_pz.simulator.simulator import Simulator
from mapf_pz.simulator.states import States


@dataclass(frozen=True, eq=False)
class Steps:
    """E environment steps of N agents."""

    map: Ints
    """(E,) int32: the number of the map."""
    time: Ints
    """(E,) int32: steps taken."""
    cells: Ints
    """(E, N, 2) uint16 or int32: the cells of the agent and of its goal."""
    flags: Ints
    """(E, N, 3) int8: heading, delayed, and remaining delay, at most 127."""
    history: Ints
    """(E, N, L, 2) int8: the last actions."""
    labels: Ints
    """(E, N) int8: the expert's actions; -1: none."""

    def __len__(self) -> int:
        """Return E."""
        return len(self.map)


DATA = "data"
"""In the folder of a run: the folder of the steps that it has learned from."""
STEP_FIELDS = tuple(field.name for field in fields(Steps))


def step_files(run: Path, first: int = 0, last: int | None = None) -> list[Path]:
    """Return the files of the steps that a run has learned from, the oldest ones first.

    Each has the number of agent steps of the run as its name: from `first` to `last`, if that is not None.
    """
    files = sorted((run / DATA).glob("*.npz"))
    return [file for file in files if first <= int(file.stem) and (last is None or int(file.stem) <= last)]


class Sample(NamedTuple):
    """Steps of E environments of N agents that are learned from."""

    image: Floats
    """(E, N, ...) float32: the images."""
    features: Floats
    """(E, N, F) float32: the features."""
    at_goal: Bools
    """(E, N): which agents are at their goals."""
    labels: Ints
    """(E, N) int64: the expert's actions; -1: none."""


class StateBuffer:
    """The latest environment steps, at most a given number."""

    def __init__(self, config: EnvConfig, capacity: int, batch_size: int, num_threads: int = 1) -> None:
        """Create an empty buffer.

        Args:
            config: the environment, in which observations are drawn.
            capacity: the largest number of environment steps.
            batch_size: the number of environment steps in a sample.
            num_threads: number of threads that draw observations.

        Raises `ValueError` if observations depend on more than states.
        """
        if config.num_frames > 1 or config.on_target == "finish":
            raise ValueError("replay='states': expected num_frames=1, and agents that stay on the map")
        self._simulator = Simulator(replace(config, render_mode=None), batch_size, num_threads)
        self._capacity = capacity
        num_cells = self._simulator.shape[0] * self._simulator.shape[1]
        self._cell_type = np.uint16 if num_cells <= 2**16 else np.int32
        self._maps: dict[bytes, int] = {}
        self._free: list[np.ndarray] = []
        self._weight: list[np.ndarray] = []
        self._parts: list[Steps] = []
        self._unsaved = 0
        """Number of the last parts that are in no file."""

    def __len__(self) -> int:
        """Return the number of environment steps."""
        return sum(map(len, self._parts))

    def extend(self, states: States, labels: Ints) -> None:
        """Add E environment steps with the expert's actions `labels` (E, N); the oldest ones are dropped if need be."""
        numbers = [self._map_number(*pair) for pair in zip(states.free, states.weight, strict=True)]
        cells, flags = states.agents[..., :2], states.agents[..., 2:]
        self._parts.append(
            Steps(
                np.array(numbers, np.int32),
                states.time.astype(np.int32),
                cells.astype(self._cell_type),
                np.minimum(flags, 127).astype(np.int8),
                states.history.astype(np.int8),
                labels.astype(np.int8),
            )
        )
        self._unsaved += 1
        self._drop()

    def _drop(self) -> None:
        """Drop the oldest parts that are not needed for the capacity."""
        while len(self) - len(self._parts[0]) >= self._capacity:
            del self._parts[0]

    def sample(self, rng: np.random.Generator, recent: int) -> Sample:
        """Return a sample: half of it out of all steps, half out of the last `recent` ones.

        Each environment step has the same probability in its half; a step may be drawn several times.
        """
        ends = np.cumsum([len(part) for part in self._parts])
        size, total = self._simulator.num_envs, int(ends[-1])
        lowest = np.where(np.arange(size) < size // 2, 0, max(total - recent, 0))
        drawn = rng.integers(lowest, total)
        which = np.searchsorted(ends, drawn, side="right")
        rows = drawn - (ends[which] - [len(self._parts[k]) for k in which])
        chosen = [
            [getattr(self._parts[k], name)[row] for k, row in zip(which, rows, strict=True)] for name in STEP_FIELDS
        ]
        maps, *arrays = chosen
        time, cells, flags, history, labels = map(np.stack, arrays)
        agents = np.concatenate([cells.astype(np.int32), flags.astype(np.int32)], axis=-1)
        free, weight = (np.stack([part[k] for k in maps]) for part in (self._free, self._weight))
        self._simulator.restore(States(free, weight, time, agents, history))
        observation = self._simulator.observe()
        return Sample(observation.image, observation.features, cells[..., 0] == cells[..., 1], labels.astype(np.int64))

    def save(self, file: Path) -> None:
        """Write the steps that are in no file yet; nothing if there are none."""
        parts = self._parts[len(self._parts) - min(self._unsaved, len(self._parts)) :]
        self._unsaved = 0
        if parts:
            arrays = {name: np.concatenate([getattr(part, name) for part in parts]) for name in STEP_FIELDS}
            used, arrays["map"] = np.unique(arrays["map"], return_inverse=True)
            free, weight = (np.stack([part[k] for k in used]) for part in (self._free, self._weight))
            write_npz(file, arrays | {"free": free, "weight": weight})

    def load(self, file: Path) -> None:
        """Add the steps of a file.

        Raises `FileNotFoundError` if there is none, and `FormatError` if it is malformed, or of another environment.
        """
        arrays = read_npz(file, ("free", "weight", *STEP_FIELDS))
        free, length, num_agents = arrays.pop("free"), len(arrays["map"]), self._simulator.num_agents
        expected = self._empty(len(free), length)
        same = all(
            arrays[name].shape == part.shape and arrays[name].dtype == part.dtype for name, part in expected.items()
        )
        limits = {"map": (0, len(free)), "labels": (-1, self._simulator.num_actions)}
        if same and free.shape[1:] == self._simulator.shape:
            same = all(((low <= arrays[name]) & (arrays[name] < high)).all() for name, (low, high) in limits.items())
        if free.shape[1:] != self._simulator.shape or not same or not length:
            raise FormatError(file, f"expected steps of {num_agents} agents on maps of {self._simulator.shape} cells")
        pairs = zip(free, arrays.pop("weight"), strict=True)
        numbers = np.array([self._map_number(*pair) for pair in pairs], np.int32)
        self._parts.append(Steps(**(arrays | {"map": numbers[arrays["map"]]})))
        self._drop()

    def _empty(self, num_maps: int, length: int) -> dict[str, np.ndarray]:
        """Return arrays for numbers of maps and steps, by the names of fields; the maps are numbered within a file."""
        planes = 5 if random_share(self._simulator.config.edge_weights) else 0
        each = (length, self._simulator.num_agents)
        last = self._simulator.config.num_last_actions
        return {
            "weight": np.empty((num_maps, planes, *self._simulator.shape), np.float32),
            "map": np.empty(length, np.int64),
            "time": np.empty(length, np.int32),
            "cells": np.empty((*each, 2), self._cell_type),
            "flags": np.empty((*each, 3), np.int8),
            "history": np.empty((*each, last, 2), np.int8),
            "labels": np.empty(each, np.int8),
        }

    def _map_number(self, free: np.ndarray, weight: np.ndarray) -> int:
        """Return the number of a map with a guidance graph, which are added if they are new."""
        key = blake2b(np.packbits(free).tobytes() + weight.tobytes(), digest_size=16).digest()
        number = self._maps.setdefault(key, len(self._free))
        if number == len(self._free):
            self._free.append(free.copy())
            self._weight.append(weight.copy())
        return number
