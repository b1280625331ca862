"""Instances of the page: from JSON to the package's own, and weights in both directions."""

from __future__ import annotations

import base64

import numpy as np

from mapf_pz.editor.requests import Cell, EditedInstance, Refusal
from mapf_pz.guidance import GuidanceGraph
from mapf_pz.instances import Grid, Instance, Scenario, parse_map
from mapf_pz.instances.place import check_reachable

MAX_SIDE = 1024
"""Maximum number of rows and of columns of a map."""
MAX_AGENTS = 10_000
"""Maximum number of agents."""
MAX_GOALS = 1_000_000
"""Maximum number of goals of all agents, with sequences of one length."""


def grid_of(text: str, name: str) -> Grid:
    """Return the map in the text of a `.map` file.

    Raises:
        FormatError: the text is malformed.
        Refusal: the map is too large.
    """
    grid = parse_map(text, name if name.endswith(".map") else f"{name}.map")
    check_shape(*grid.shape)
    return grid


def check_shape(height: float, width: float) -> None:
    """Raise `Refusal` unless a map of this size is small enough."""
    if height > MAX_SIDE or width > MAX_SIDE:
        raise Refusal(400, f"map: expected at most {MAX_SIDE} x {MAX_SIDE} cells, got {height} x {width}")


def instance_of(edited: EditedInstance, lifelong: bool) -> Instance:
    """Return the instance, with one goal for each agent or, if `lifelong`, with a sequence of goals for each.

    Raises:
        FormatError: the map is malformed.
        ValueError: an agent is outside the map, on an obstacle or on the start of another one, or cannot reach a goal.
        Refusal: there are no or too many agents, or a number of goals or headings is wrong.
    """
    grid = grid_of(edited.map, edited.name)
    if not 1 <= len(edited.starts) <= MAX_AGENTS:
        raise Refusal(400, f"expected 1 to {MAX_AGENTS} agents, got {len(edited.starts)}")
    if len(edited.goals) != len(edited.starts):
        raise Refusal(400, f"goals: expected a list for each of {len(edited.starts)} agents, got {len(edited.goals)}")
    scenario = _lifelong(edited) if lifelong else Scenario(np.array(edited.starts), np.array(_only_goals(edited)))
    instance = Instance(grid, scenario, None if edited.headings is None else np.array(edited.headings))
    check_reachable(instance)
    return instance


def _only_goals(edited: EditedInstance) -> list[Cell]:
    """Return the goals of agents with one goal each; raises `Refusal` for another number of goals."""
    for agent, goals in enumerate(edited.goals):
        if len(goals) != 1:
            raise Refusal(400, f"agent {agent}: expected one goal unless the run is lifelong, got {len(goals)}")
    return [goals[0] for goals in edited.goals]


def _lifelong(edited: EditedInstance) -> Scenario:
    """Return the scenario of agents with sequences of goals; raises `Refusal` for an empty sequence or too many."""
    counts = [len(goals) for goals in edited.goals]
    if 0 in counts:
        raise Refusal(400, f"agent {counts.index(0)}: expected at least one goal")
    longest = max(counts)
    if longest * len(counts) > MAX_GOALS:
        raise Refusal(400, f"goals: expected at most {MAX_GOALS // len(counts)} for each of {len(counts)} agents")
    padded = [goals + goals[:1] * (longest - len(goals)) for goals in edited.goals]
    return Scenario(np.array(edited.starts), np.array(padded), np.array(counts))


def graph_of(weights: str, grid: Grid) -> GuidanceGraph:
    """Return the guidance graph with these weights, as in `EditedInstance.weights`.

    Raises `Refusal` unless they are base64 of (5, H, W) float32, and `ValueError` unless all are greater than 0.
    """
    shape = (5, *grid.shape)
    try:
        values = np.frombuffer(base64.b64decode(weights, validate=True), "<f4").reshape(shape)
    except ValueError:
        raise Refusal(400, f"weights: expected base64 of float32 numbers of the shape {shape}") from None
    return GuidanceGraph(values[:4], values[4]).on_map(grid.free)


def weights_text(graph: GuidanceGraph) -> str:
    """Return the weights of a guidance graph as in `EditedInstance.weights`."""
    return base64.b64encode(np.concatenate([graph.move, graph.wait[None]]).astype("<f4").tobytes()).decode()
