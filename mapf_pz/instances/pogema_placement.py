"""Starts and goals as POGEMA 1.4.0 samples them from a seed: the same ones, with NumPy alone.

Source: github.com/Cognitive-AI-Systems/pogema, `generator.py`, `grid.py` and `envs.py` of version 1.4.0 (Apache-2.0).
Cells are [row, col].
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from mapf_pz._internal.arrays import Bools, Ints
from mapf_pz.instances.place import components

Cell: TypeAlias = tuple[int, int]
OBS_RADIUS = 5
"""POGEMA's default radius of observations. On maps with marked cells, it decides which goals are drawn again."""


@dataclass(frozen=True)
class PogemaMap:
    """A map on which POGEMA places agents."""

    free: Bools
    """(H, W): True where an agent can stand."""
    starts: tuple[Cell, ...] | None = None
    """The cells where agents may start, in row-major order; None: anywhere."""
    goals: tuple[Cell, ...] | None = None
    """The cells where goals may be, in row-major order; None: anywhere."""


def place_agents(map: PogemaMap, num_agents: int, seed: int, num_steps: int = 0) -> tuple[list[Cell], list[list[Cell]]]:
    """Return the starts of agents, and the sequences of their goals.

    Args:
        map: the map.
        num_agents: number of agents.
        seed: the seed of POGEMA's configuration.
        num_steps: The length of each agent's path along its goals, in rows and columns, is at least this many steps,
            so the sequence does not end earlier. 0: one goal for each agent (one-shot).

    Raises:
        ValueError: the map has too few cells for the agents.
    """
    if map.starts is None or map.goals is None:
        labels = components(map.free)
        starts, goals = _pairs(labels, num_agents, seed)
        found = [int(labels[goal]) for goal in goals]
        targets = {label: _cells_of(labels, label) for label in set(found)}
        choices = [targets[label] for label in found]
        offset = 0
    else:
        starts, goals, shuffled = _marked(map.starts, map.goals, num_agents, seed)
        choices, offset = [shuffled] * num_agents, OBS_RADIUS
    seeds = np.random.default_rng(seed).integers(np.iinfo(np.int32).max, size=num_agents)
    sequences = [
        _sequence(start, goal, cells, np.random.default_rng(own), num_steps, offset)
        for start, goal, cells, own in zip(starts, goals, choices, seeds, strict=True)
    ]
    return starts, sequences


def _sequence(
    start: Cell, goal: Cell, cells: list[Cell], rng: np.random.Generator, num_steps: int, offset: int
) -> list[Cell]:
    """Return an agent's goals, which are drawn from `cells`.

    A goal on the agent's cell is drawn again. POGEMA adds its border, `offset`, to the agent's cell, but not to marked
    goals.
    """
    sequence, length = [goal], _distance(start, goal)
    while length < num_steps:
        at = sequence[-1]
        taken = at[0] + offset, at[1] + offset
        following = taken
        while following == taken:
            following = cells[int(rng.choice(len(cells), 1)[0])]
        length += _distance(at, following)
        sequence.append(following)
    return sequence


def _distance(one: Cell, other: Cell) -> int:
    return abs(one[0] - other[0]) + abs(one[1] - other[1])


def _cells_of(labels: Ints, label: int) -> list[Cell]:
    return [(row, col) for row, col in np.argwhere(labels == label).tolist()]


def _pairs(labels: Ints, num_agents: int, seed: int) -> tuple[list[Cell], list[Cell]]:
    """Return starts and goals anywhere: cells in random order are in turn a start and a goal of their component."""
    order = [(row, col) for row, col in np.argwhere(labels >= 0).tolist()]
    np.random.default_rng(seed).shuffle(order)
    left = np.bincount(labels[labels >= 0])
    waiting: dict[int, int] = {}
    starts: list[Cell] = []
    goals: dict[int, Cell] = {}
    for cell in order:
        label = int(labels[cell])
        if label in waiting:
            goals[waiting.pop(label)] = cell
        elif len(starts) < num_agents and left[label] >= 2:
            left[label] -= 2
            waiting[label] = len(starts)
            starts.append(cell)
        if len(goals) == num_agents:
            return starts, [goals[agent] for agent in range(num_agents)]
    raise ValueError(f"the map has no cells for {num_agents} agents with goals that they can reach")


def _marked(
    starts: tuple[Cell, ...], goals: tuple[Cell, ...], num_agents: int, seed: int
) -> tuple[list[Cell], list[Cell], list[Cell]]:
    """Return starts and goals on marked cells, and the marked goals in the order from which later goals are drawn."""
    if min(len(starts), len(goals)) < max(num_agents, 2):
        raise ValueError(f"the map has {len(starts)} starts and {len(goals)} goals for {num_agents} agents")
    rng = np.random.default_rng(seed)
    shuffled_starts, shuffled_goals = list(starts), list(goals)
    rng.shuffle(shuffled_starts)
    rng.shuffle(shuffled_goals)
    return shuffled_starts[:num_agents], shuffled_goals[:num_agents], shuffled_goals
