"""Draw all channels: those that show layers of the map, then those that are looked up, then those of users."""

from __future__ import annotations

import numpy as np
from numba import prange

from mapf_pz._internal.jit import Array, BatchKernel, inlined, jit
from mapf_pz.simulator.kernels.observation.channels import ImagePlanes
from mapf_pz.simulator.kernels.observation.draw import clear, draw_lookups, mark
from mapf_pz.simulator.kernels.observation.inputs import ObservationInputs
from mapf_pz.simulator.kernels.observation.layers import (
    MapLayers,
    Span,
    ViewOrigins,
    ViewShape,
    copy_contents,
    copy_edges,
    draw_agents,
    erase_agents,
    heading_value,
)
from mapf_pz.simulator.kernels.state import Fields


class ImageWriter:
    """Draws the images of all agents in B environments."""

    def __init__(self, inputs: ObservationInputs, planes: ImagePlanes) -> None:
        """Draw `planes` from `inputs`."""
        self._inputs = inputs
        self._planes = planes
        first = (*inputs.geometry, *planes.layers, inputs.state.map, inputs.state.agents)
        self._copy_layers = _copy_layers.bind(inputs.num_threads, first, (np.empty((1,) * 5, np.float32),))

    def write(self, image: Array) -> None:
        """Fill `image` (B, N, K, h, w) float32, a C-contiguous array."""
        inputs, (layers, lookups, users) = self._inputs, self._planes
        inputs.forget()
        self._copy_layers(image)
        if not inputs.view_shape.see_through_walls:
            _hide(inputs.num_threads, inputs.visible, layers.view_at, layers.orientation_at, image)
        if max(lookups) >= 0:
            draw_lookups(inputs, lookups, image.reshape(*image.shape[:3], -1))
        for draw, at in users:
            draw(inputs, image, at)


@BatchKernel
def _copy_layers(
    shape_fields: Fields, rows: Span, columns: Span, layer_fields: Fields, turn: Array, corner: Array, view_at: int,
    goal_at: int, orientation_at: int, edges_at: int, maps: Array, all_agents: Array, image: Array
) -> None:  # fmt: skip
    """Find where each view is, and copy it from the layers."""
    view_shape, layers = ViewShape(*shape_fields), MapLayers(*layer_fields)
    has_weights = layers.edges.shape[1] > 0
    for thread in prange(layers.num_threads):
        for b in range(thread, maps.size, layers.num_threads):
            contents = layers.contents[np.int64(thread) if layers.shared else maps[b]]
            origins, agents = ViewOrigins(turn[b], corner[b]), all_agents[b]
            views = image[b].reshape(agents.size, image.shape[2], -1)
            draw_agents(view_shape, layers, origins, agents, contents)
            windows, values = layers.windows[np.int64(thread)], layers.values[np.int64(thread)]
            copy_contents(
                rows, columns, layers.stride, origins, contents, windows, values, view_at, orientation_at,
                -1 if has_weights else edges_at, views
            )  # fmt: skip
            erase_agents(view_shape, layers, agents, contents)
            _draw_observers(view_shape, origins.turn, agents, views, view_at, orientation_at)
            if edges_at >= 0 and has_weights:
                copy_edges(rows, columns, layers.stride, origins, layers.edges[maps[b]], edges_at, views)
            if goal_at >= 0:
                _draw_goals(view_shape, layers, origins, agents, views, goal_at)


@inlined
def _draw_observers(
    view_shape: ViewShape, turn: Array, agents: Array, image: Array, view_at: int, orientation_at: int
) -> None:
    """Remove observers from their own views, but show each its own heading, also in the step in which it finishes."""
    here = view_shape.row * view_shape.width + view_shape.column
    for i in range(agents.size):
        if view_at >= 0:
            image[i, view_at, here] = 0.0
        if orientation_at >= 0:
            image[i, orientation_at, here] = heading_value(turn[i], agents[i].heading)


@inlined
def _draw_goals(
    view_shape: ViewShape, layers: MapLayers, origins: ViewOrigins, agents: Array, image: Array, plane: int
) -> None:
    """Write 1 to each agent's own goal, and 0 elsewhere."""
    for i in range(agents.size):
        clear(image, i, plane)
        mark(
            view_shape.height, view_shape.width, layers.place, layers.stride, origins.turn[i], origins.corner[i],
            agents[i].goal, image, i, plane
        )  # fmt: skip


@BatchKernel
def _hide(visible: Array, view_at: int, orientation_at: int, image: Array) -> None:
    """Write -1 to the channel `view`, and 0 to `orientation`, where an obstacle hides the cell."""
    for b in prange(image.shape[0]):
        if view_at >= 0:
            _hide_plane(visible[b], image[b], view_at, -1.0)
        if orientation_at >= 0:
            _hide_plane(visible[b], image[b], orientation_at, 0.0)


@jit
def _hide_plane(visible: Array, image: Array, plane: int, hidden: float) -> None:
    for i in range(image.shape[0]):
        shown = image[i, plane].reshape(-1)
        for j in range(shown.size):
            if not visible[i, j]:
                shown[j] = hidden
