"""Draw the figures of the concepts: `python -m experiments.figures.concepts`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

import mapf_pz
from mapf_pz import GuidanceGraph, Scenario
from mapf_pz._internal.arrays import Bools, Floats
from mapf_pz.instances import load_map
from mapf_pz.instances.heading import HEADING_STEPS
from mapf_pz.simulator.actions import CardinalAction
from mapf_pz.simulator.config import CollisionSystem

IMAGES = Path(__file__).parents[2] / "docs" / "images"
WAIT, UP, DOWN, LEFT, RIGHT = CardinalAction
STEPS = {WAIT: (0, 0), UP: (-1, 0), DOWN: (1, 0), LEFT: (0, -1), RIGHT: (0, 1)}
MOVES, STAYS, WAITS = "#2a9d3f", "#d1392b", "#8a8a8a"
SYSTEMS: tuple[CollisionSystem, ...] = ("soft", "priority", "block_both")


@dataclass(frozen=True)
class Case:
    """A drawing with numbered agents, and their intended actions."""

    title: str
    drawing: tuple[str, ...]
    wants: tuple[CardinalAction, ...]

    def starts(self) -> list[tuple[int, int]]:
        """Return the agents' starts, in order."""
        cells = {char: (r, c) for r, row in enumerate(self.drawing) for c, char in enumerate(row) if char.isdigit()}
        return [cells[name] for name in sorted(cells)]

    def moved(self, system: CollisionSystem) -> list[bool]:
        """Return which agents move in the environment."""
        height, width = len(self.drawing), len(self.drawing[0])
        free = np.ones((height, width), np.bool_)
        agents = Scenario(np.array(self.starts()), np.zeros((len(self.wants), 2), np.int32) + (0, width - 1))
        settings: dict[str, Any] = {"map": free, "scenario": agents, "num_agents": len(self.wants), "view_size": (1, 1)}
        env = mapf_pz.parallel_env(**settings, action_model="cardinal", collision_system=system, on_target="restart")
        env.reset(seed=0)
        infos = env.step(dict(zip(env.agents, map(int, self.wants), strict=True)))[4]
        return [bool(info["moved"]) for info in infos.values()]


CASES = (
    Case("two want to swap", ("...", "01.", "..."), (RIGHT, LEFT)),
    Case("several want one cell", (".0.", "1..", ".2."), (DOWN, RIGHT, UP)),
    Case("a cell of one who stays", ("...", "01.", "..."), (RIGHT, WAIT)),
    Case("following, leader's index lower", ("...", "10.", "..."), (RIGHT, RIGHT)),
    Case("following, leader's index higher", ("...", "01.", "..."), (RIGHT, RIGHT)),
    Case("a ring", ("01.", "32.", "..."), (RIGHT, DOWN, LEFT, UP)),
)


def draw_conflicts() -> None:
    """Draw the results of conflicting moves: a row for each collision system, a column for each case."""
    figure = Figure(figsize=(1.75 * len(CASES) + 0.6, 1.75 * len(SYSTEMS) + 0.7), layout="constrained")
    axes = figure.subplots(len(SYSTEMS), len(CASES), squeeze=False)
    for row, system in zip(axes, SYSTEMS, strict=True):
        row[0].set_ylabel(system, fontsize=11, family="monospace")
        for axis, case in zip(row, CASES, strict=True):
            _draw_case(axis, case, case.moved(system))
    for axis, case in zip(axes[0], CASES, strict=True):
        axis.set_title("\n".join(case.title.split(", ")), fontsize=9)
    figure.supxlabel("green: moves          red: wants to move, and stays          grey: waits", fontsize=10)
    figure.savefig(IMAGES / "conflicts.png", dpi=110)


def _draw_case(axis: Axes, case: Case, moved: list[bool]) -> None:
    height, width = len(case.drawing), len(case.drawing[0])
    for row, col in np.ndindex(height, width):
        axis.add_patch(Rectangle((col - 0.5, row - 0.5), 1, 1, facecolor="white", edgecolor="#cccccc"))
    for number, ((row, col), want, moves) in enumerate(zip(case.starts(), case.wants, moved, strict=True)):
        color = WAITS if want == WAIT else MOVES if moves else STAYS
        down, right = STEPS[want]
        if want != WAIT:
            x, y = col - 0.09 * down, row + 0.09 * right  # offset, so that opposite arrows do not overlap
            style = {"arrowstyle": "-|>", "color": color, "lw": 2.2, "shrinkA": 0, "shrinkB": 0}
            axis.annotate("", (x + 0.78 * right, y + 0.78 * down), (x, y), arrowprops=style, zorder=3)
        axis.add_patch(Circle((col, row), 0.25, facecolor=color, zorder=2))
        axis.text(col, row, str(number), color="white", ha="center", va="center", fontsize=9, zorder=4)
    axis.set(xlim=(-0.55, width - 0.45), ylim=(height - 0.45, -0.55), xticks=[], yticks=[], aspect="equal")
    axis.spines[:].set_visible(False)


MAP = """
    .......
    .......
    ..###..
    .......
    .......
    .......
"""
GOAL = (4, 5)


def draw_guidance() -> None:
    """Draw the edge weights of a guidance graph, and the cost to go with and without it."""
    free = load_map(MAP).free
    graph = GuidanceGraph.crisscross(free)
    figure = Figure(figsize=(12, 3.8), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    _draw_edges(left, free, graph)
    _draw_costs(middle, free, costs(GuidanceGraph.uniform(free), free), "cost to go, uniform weights")
    _draw_costs(right, free, costs(graph, free), "cost to go, crisscross")
    figure.savefig(IMAGES / "guidance.png", dpi=110)


def costs(graph: GuidanceGraph, free: Bools) -> Floats:
    """Return the cost to go (H, W) of an agent with cardinal actions, `inf` on obstacles."""
    found = np.full(free.shape, np.inf)
    for cell in np.argwhere(free):
        agent = Scenario(cell[None], np.array([GOAL]))
        env = mapf_pz.parallel_env(
            map=free, scenario=agent, num_agents=1, view_size=(1, 1), action_model="cardinal", edge_weights=graph
        )
        env.reset(seed=0)
        found[tuple(cell)] = env.simulator.cost_to_go()[0][0]
    return found


def _draw_edges(axis: Axes, free: Bools, graph: GuidanceGraph) -> None:
    _draw_map(axis, free, "crisscross: thick edges cost 0.5, thin ones 1")
    for heading, row, col in np.argwhere(np.isfinite(graph.move)):
        down, right = HEADING_STEPS[heading]
        cheap = graph.move[heading, row, col] < 1
        # The two directions of an edge are drawn side by side.
        x, y = col + 0.18 * right - 0.14 * down, row + 0.18 * down + 0.14 * right
        style = {"arrowstyle": "-|>", "color": "#1f5fbf" if cheap else "#b0b0b0", "lw": 1.8 if cheap else 0.7}
        axis.annotate("", (x + 0.64 * right, y + 0.64 * down), (x, y), arrowprops=style)


def _draw_costs(axis: Axes, free: Bools, found: Floats, title: str) -> None:
    _draw_map(axis, free, title)
    shades = colormaps["YlGnBu"](found / 14)
    for row, col in np.argwhere(free):
        axis.add_patch(Rectangle((col - 0.5, row - 0.5), 1, 1, facecolor=shades[row, col], edgecolor="#dddddd"))
        if (row, col) != GOAL:
            axis.text(col, row, f"{found[row, col]:g}", ha="center", va="center", fontsize=10)


def _draw_map(axis: Axes, free: Bools, title: str) -> None:
    height, width = free.shape
    for row, col in np.ndindex(height, width):
        color = "white" if free[row, col] else "#444444"
        axis.add_patch(Rectangle((col - 0.5, row - 0.5), 1, 1, facecolor=color, edgecolor="#dddddd"))
    axis.plot(GOAL[1], GOAL[0], marker="*", color="#d1392b", markersize=16, zorder=3)
    axis.set(xlim=(-0.55, width - 0.45), ylim=(height - 0.45, -0.55), xticks=[], yticks=[], aspect="equal")
    axis.set_title(title, fontsize=11)
    axis.spines[:].set_visible(False)


if __name__ == "__main__":
    draw_conflicts()
    draw_guidance()
