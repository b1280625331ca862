"""Images of an instance: dark obstacles, a disc with a heading for each agent, and a square for its goal.

A dark bar crosses the lower half of an agent that was delayed in the last step.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mapf_pz._internal.arrays import Bools, Floats, Ints
from mapf_pz.instances.heading import Heading

Picture = NDArray[np.uint8]

FREE = (251, 250, 247)
OBSTACLE = (70, 77, 92)
GRID_LINE = (233, 231, 225)
HEADING_MARK = (255, 255, 255)
CHOSEN = (20, 22, 28)
DELAYED = (20, 22, 28)

MAX_IMAGE_SIZE = 1400  # px of the longer side, unless cells would be smaller than the minimum
MIN_CELL_SIZE, MAX_CELL_SIZE = 6, 48  # px
DETAILED_CELL = 12  # px: smaller cells have no grid lines, and discs fill them
SAMPLES = 8  # per pixel and axis, for antialiasing
DISC_RADIUS, FULL_RADIUS = 0.375, 0.49  # in cells; the first leaves a goal's frame visible, the second its corners
BAR_TOP, BAR_BOTTOM, BAR_SIDE = 0.2, 0.34, 0.46  # in cells from the center; the bar extends beyond the disc
GOAL_TINT = 0.16
GOLDEN_RATIO = 0.6180339887


def draw(
    free: Bools,
    positions: Ints,
    headings: Ints | None,
    goals: Ints,
    active: Bools | None = None,
    delayed: Bools | None = None,
    cell_size: int | None = None,
) -> Picture:
    """Draw an image. To draw many images of the same map, use a `Canvas`.

    Args:
        free: (H, W), True for free cells.
        positions: (N, 2), [row, col].
        headings: (N,), or None for agents without headings.
        goals: (N, 2), [row, col].
        active: (N,); inactive agents and their goals are omitted. None: all agents are active.
        delayed: (N,), whether each agent was delayed in the last step. None: no agent was.
        cell_size: pixels per cell. None: chosen by the size of the map.

    Returns:
        (H * cell_size, W * cell_size, 3).

    Raises:
        ValueError: if `cell_size` is less than 1.
    """
    return Canvas(free, len(positions), cell_size).draw(positions, headings, goals, active, delayed)


class Canvas:
    """Draws images of one map. It caches the background, the colors and the agents' shapes."""

    def __init__(self, free: Bools, num_agents: int, cell_size: int | None = None) -> None:
        """Prepare images of the map `free` (H, W) with `num_agents` agents; `cell_size` as in `draw`."""
        if cell_size is not None and cell_size < 1:
            raise ValueError(f"cell_size={cell_size}: expected 1 pixel or more")
        self.cell_size = cell_size or fitting_cell_size(*free.shape)
        self.free = free
        self._background = _background(free, self.cell_size)
        self._colors = agent_colors(num_agents)
        radius = DISC_RADIUS if self.cell_size >= DETAILED_CELL else FULL_RADIUS
        self._disc = _coverage(self.cell_size, lambda row, col: row**2 + col**2 <= radius**2)
        self._marks = _heading_marks(self.cell_size, radius)
        self._bar = _coverage(
            self.cell_size, lambda row, col: (row >= BAR_TOP) & (row <= BAR_BOTTOM) & (np.abs(col) <= BAR_SIDE)
        )
        self._goal = _goal_mask(self.cell_size)
        self._square = np.ones((self.cell_size, self.cell_size), np.float32)
        self._frame = _coverage(self.cell_size, lambda row, col: np.maximum(np.abs(row), np.abs(col)) >= 0.38)

    def draw(
        self,
        positions: Ints,
        headings: Ints | None,
        goals: Ints,
        active: Bools | None = None,
        delayed: Bools | None = None,
        chosen: int | None = None,
    ) -> Picture:
        """Draw an image; the arguments and the result are those of the function `draw`.

        The agent `chosen` has a frame around its cell and a filled square at its goal.
        """
        picture = self._background.copy()
        shown = np.arange(len(positions)) if active is None else np.flatnonzero(active)
        colors = self._colors[shown]
        self._blend(picture, goals[shown], colors, self._goal)
        self._blend(picture, positions[shown], colors, self._disc)
        if chosen is not None:
            here, there = positions[chosen : chosen + 1], goals[chosen : chosen + 1]
            self._blend(picture, there, self._colors[[chosen]], self._square)
            self._blend(picture, here, np.array(CHOSEN, np.float32), self._frame)
            self._blend(picture, here, self._colors[[chosen]], self._disc)
        if delayed is not None:
            self._blend(picture, positions[shown][delayed[shown]], np.array(DELAYED, np.float32), self._bar)
        if headings is not None:
            self._blend(picture, positions[shown], np.array(HEADING_MARK, np.float32), self._marks[headings[shown]])
        return picture

    def _blend(self, picture: Picture, cells: Ints, colors: Floats, masks: Floats) -> None:
        """Blend `colors` ((n,) 3) into the `cells` (n, 2) of `picture`, with the opacity `masks` ((n,) size, size)."""
        size = self.cell_size
        height, width = picture.shape[0] // size, picture.shape[1] // size
        by_cell = picture.reshape(height, size, width, size, 3).transpose(0, 2, 1, 3, 4)
        rows, cols = cells[:, 0], cells[:, 1]
        under = by_cell[rows, cols].astype(np.float32)
        over = under + (colors[..., None, None, :] - under) * masks[..., None]
        by_cell[rows, cols] = np.rint(over).astype(np.uint8)


def fitting_cell_size(height: int, width: int) -> int:
    """Return the pixels per cell for a map of `height` x `width` cells."""
    return int(np.clip(MAX_IMAGE_SIZE // max(height, width), MIN_CELL_SIZE, MAX_CELL_SIZE))


def agent_colors(num_agents: int) -> Floats:
    """Return a color per agent, (N, 3) float32 from 0 to 255: golden-ratio hues, in three alternating shades.

    The hues are in OKLCH, a perceptually uniform color space, so no agent stands out.
    """
    index = np.arange(num_agents)
    hue = 2 * np.pi * ((index * GOLDEN_RATIO + 0.7) % 1)
    lightness = np.array([0.62, 0.52, 0.70])[index % 3]
    green_red, blue_yellow = 0.16 * np.cos(hue), 0.16 * np.sin(hue)
    cones = np.stack(
        [
            lightness + 0.3963377774 * green_red + 0.2158037573 * blue_yellow,
            lightness - 0.1055613458 * green_red - 0.0638541728 * blue_yellow,
            lightness - 0.0894841775 * green_red - 1.2914855480 * blue_yellow,
        ]
    )
    to_linear = np.array(
        [
            [4.0767416621, -3.3077115913, 0.2309699292],
            [-1.2684380046, 2.6097574011, -0.3413193965],
            [-0.0041960863, -0.7034186147, 1.7076147010],
        ]
    )
    linear = np.clip((to_linear @ cones**3).T, 0, 1)
    gamma = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return (255 * gamma).astype(np.float32)


def color_codes(num_agents: int) -> list[str]:
    """Return the agents' colors as hexadecimal codes."""
    return ["#{:02x}{:02x}{:02x}".format(*map(round, color)) for color in agent_colors(num_agents).tolist()]


def _background(free: Bools, size: int) -> Picture:
    tile = np.full((size, size, 3), FREE, np.uint8)
    if size >= DETAILED_CELL:
        tile[0, :] = tile[:, 0] = GRID_LINE
    background = np.tile(tile, (*free.shape, 1))
    background[~np.kron(free, np.ones((size, size), np.bool_))] = OBSTACLE
    return background


def _coverage(size: int, inside: Callable[[Floats, Floats], Bools]) -> Floats:
    """Return the fraction of each pixel that a shape covers: (size, size) float32 from 0 to 1.

    Args:
        size: pixels per cell.
        inside: whether a point is in the shape, given its (row, col) in cells from the center, -0.5 to 0.5.
    """
    centers = (np.arange(size * SAMPLES) + 0.5) / (size * SAMPLES) - 0.5
    samples = inside(centers[:, None], centers[None, :])
    return samples.reshape(size, SAMPLES, size, SAMPLES).mean(axis=(1, 3), dtype=np.float32)


def _heading_marks(size: int, radius: float) -> Floats:
    """Return masks (4, size, size), by heading, of a triangle in a disc of `radius` cells."""
    tip, base, slope = 0.9 * radius, -0.2 * radius, 0.62
    east = _coverage(size, lambda row, col: (col >= base) & (np.abs(row) <= slope * (tip - col)))
    quarter_turns = {Heading.EAST: 0, Heading.SOUTH: -1, Heading.WEST: -2, Heading.NORTH: -3}
    return np.stack([np.rot90(east, quarter_turns[heading]) for heading in Heading])


def _goal_mask(size: int) -> Floats:
    """Return a mask (size, size) of a hollow square on whole pixels, with a light tint inside."""
    margin, stroke = round(0.03 * size), max(1, round(0.06 * size))
    mask = np.zeros((size, size), np.float32)
    mask[margin : size - margin, margin : size - margin] = 1
    inner = margin + stroke
    mask[inner : size - inner, inner : size - inner] = GOAL_TINT
    return mask
