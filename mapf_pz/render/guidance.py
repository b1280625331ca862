"""Pictures of guidance graphs: arrows in the cheaper direction of each edge, and cells colored by cost or traffic."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mapf_pz._internal.arrays import Bools, Floats, Ints
from mapf_pz._internal.atomic import write_whole
from mapf_pz.guidance.edges import open_edges, opposite_edges
from mapf_pz.guidance.graph import GuidanceGraph
from mapf_pz.instances.heading import HEADING_STEPS
from mapf_pz.instances.instance import Grid
from mapf_pz.render.gif import draw_polygons, save_png
from mapf_pz.render.rgb import FREE, OBSTACLE, fitting_cell_size

EXTENSIONS = (".png", ".svg")
"""The formats of pictures."""
FULL_RATIO = 4.0
"""Ratio of the weights of an edge's two directions from which on its arrow has full size."""
HOT = (240, 146, 104)
"""Color of the cells with the highest cost, or with the most traffic."""
ARROW = (24, 62, 118)
"""Color of arrows."""


def save_guidance_picture(
    graph: GuidanceGraph,
    grid: Grid,
    path: str | Path,
    moves: Ints | Floats | None = None,
    cell_size: int | None = None,
) -> None:
    """Draw the weights of moves.

    Between two cells, an arrow points in the cheaper direction. Its size and opacity grow with the logarithm of the
    ratio of both directions' weights, up to the ratio `FULL_RATIO`. Cells are colored by the mean cost of leaving them.

    Args:
        graph: The guidance graph.
        grid: The map.
        path: A file name that ends in `.png` or `.svg`; the file is replaced atomically.
        moves: (4, H, W), how often the agents left each cell to the east, south, west, north, as `count_moves` returns:
            cells are colored by the number of moves into them instead.
        cell_size: Pixels per cell. None: chosen by the size of the map.

    Raises:
        ValueError: The extension is another one, a shape is not that of the map, or `cell_size` is less than 1.
        ImportError: Pillow is missing, which PNG requires.
    """
    check_picture(path, cell_size)
    size = cell_size or fitting_cell_size(*grid.shape)
    colors = _colors(_heat(graph.on_map(grid.free), grid.free, moves), grid.free)
    arrows = list(_arrows(graph, grid.free))
    if Path(path).suffix == ".svg":
        write_whole(Path(path), "\n".join(_svg(colors, arrows, size)).encode())
    else:
        background = np.kron(colors, np.ones((size, size, 1))).astype(np.uint8)
        polygons = [(points * size, (*ARROW, round(255 * _opacity(strength)))) for points, strength in arrows]
        save_png(draw_polygons(background, polygons), path)


def check_picture(path: str | Path, cell_size: int | None = None) -> None:
    """Raise `ValueError` if `save_guidance_picture` would for these arguments."""
    if Path(path).suffix not in EXTENSIONS:
        raise ValueError(f"{path}: expected a file name that ends in {', '.join(EXTENSIONS)}")
    if cell_size is not None and cell_size < 1:
        raise ValueError(f"cell_size={cell_size}: expected 1 pixel or more")


def preferences(graph: GuidanceGraph, free: Bools) -> Floats:
    """Return how much cheaper each move is than the opposite one: (4, H, W), 0 to 1, by heading.

    It is the logarithm of the ratio of the weights to the base `FULL_RATIO`, at most 1; 0 for the more expensive
    direction and where there is no edge. A one-way edge has 1.
    """
    edges = open_edges(free)
    weights = np.where(edges, graph.on_map(free).move, 1)
    opposite = np.where(edges, opposite_edges(weights), 1)
    both = np.isinf(weights) & np.isinf(opposite)
    ratio = np.divide(opposite, weights, out=np.ones(weights.shape), where=~both & np.isfinite(weights))
    return np.clip(np.log(ratio) / np.log(FULL_RATIO), 0, 1)


def _arrows(graph: GuidanceGraph, free: Bools) -> Iterator[tuple[Floats, float]]:
    """Yield the corners (3, 2) of each arrow, [x, y] in cells, and its strength, more than 0 and up to 1."""
    strengths = preferences(graph, free)
    for heading, row, col in np.argwhere(strengths > 0).tolist():
        strength = float(strengths[heading, row, col])
        ahead = HEADING_STEPS[heading][::-1]
        aside = ahead[::-1] * (1, -1)
        center = np.array([col + 0.5, row + 0.5]) + ahead / 2
        length, width = 0.14 + 0.2 * strength, 0.1 + 0.1 * strength
        tail = center - length * ahead
        yield np.array([center + length * ahead, tail + width * aside, tail - width * aside]), strength


def _opacity(strength: float) -> float:
    return 0.35 + 0.65 * strength


def _heat(graph: GuidanceGraph, free: Bools, moves: Ints | Floats | None) -> Floats:
    """Return a number (H, W) from 0 to 1 per cell: the share of the largest traffic, or of the range of mean costs."""
    if moves is not None:
        if np.shape(moves) != (4, *free.shape):
            raise ValueError(f"moves: expected the shape {(4, *free.shape)}, got {np.shape(moves)}")
        entered = opposite_edges(np.asarray(moves, np.float64)).sum(axis=0)
        return entered / max(entered.max(), 1)
    usable = np.isfinite(graph.move)
    count = usable.sum(axis=0)
    total = np.where(usable, graph.move, 0).sum(axis=0)
    mean = np.divide(total, count, out=np.zeros(free.shape), where=count > 0)
    low, high = (mean[count > 0].min(), mean[count > 0].max()) if count.any() else (0.0, 0.0)
    return np.where(count > 0, mean - low, 0) / (high - low if high > low else 1.0)


def _colors(heat: Floats, free: Bools) -> NDArray[np.uint8]:
    """Return the color of each cell, (H, W, 3)."""
    blend = np.array(FREE) + heat[..., None] * (np.array(HOT) - np.array(FREE))
    return np.where(free[..., None], np.rint(blend), OBSTACLE).astype(np.uint8)


def _svg(colors: NDArray[np.uint8], arrows: list[tuple[Floats, float]], size: int) -> Iterator[str]:
    height, width = colors.shape[:2]
    yield f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width * size}">'
    yield '<g shape-rendering="crispEdges">'
    for row in range(height):
        changes = np.flatnonzero((colors[row, 1:] != colors[row, :-1]).any(axis=1)) + 1
        for first, end in zip([0, *changes.tolist()], [*changes.tolist(), width], strict=True):
            yield f'<rect x="{first}" y="{row}" width="{end - first}" height="1" fill="{_code(colors[row, first])}"/>'
    yield f'</g><g fill="{_code(np.array(ARROW))}">'
    for points, strength in arrows:
        corners = " ".join(f"{x:.3g},{y:.3g}" for x, y in points.round(3).tolist())
        yield f'<polygon points="{corners}" opacity="{_opacity(strength):.2f}"/>'
    yield "</g></svg>\n"


def _code(color: NDArray[np.integer]) -> str:
    return "#{:02x}{:02x}{:02x}".format(*color.tolist())
