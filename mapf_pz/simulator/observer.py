"""Observations of B environments: each agent's own, those of its neighbors, and those of previous steps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import prange

from mapf_pz._internal.arrays import Floats
from mapf_pz._internal.jit import Array, BatchKernel, jit
from mapf_pz.simulator.config import EnvConfig
from mapf_pz.simulator.kernels.observation.inputs import ObservationInputs
from mapf_pz.simulator.kernels.observation.observe import ImageWriter
from mapf_pz.simulator.observation import ObservationLayout

_FAR = np.iinfo(np.int32).max


class Observer:
    """Draws the whole observations of B environments; see `ObservationLayout` for their order.

    If there are several frames, the frame of each step is drawn in that step, whether or not it is observed then.
    """

    def __init__(self, config: EnvConfig, layout: ObservationLayout, inputs: ObservationInputs) -> None:
        """Make room for what is drawn from `inputs`."""
        self._layout = layout
        self._inputs = inputs
        self._images = ImageWriter(inputs, layout.planes)
        self._num_frames = config.num_frames
        self._num_neighbors, self._radius = config.num_neighbors, config.neighbor_radius
        self._agents_disappear = config.on_target == "finish"
        self._each = inputs.state.agents.shape
        self._image_shape = (*self._each, *layout.image_shape)
        self._features_shape = (*self._each, layout.num_features)
        if self._num_neighbors:
            self._own = (
                np.empty((*self._each, layout.num_own_planes, *config.view_size), np.float32),
                np.empty((*self._each, layout.num_own_features), np.float32),
            )
            self._neighbors, self._steps = np.empty((2, *self._each, self._num_neighbors), np.int32)
        if self._num_frames > 1:
            self._newest = 0  # index of the current frame; the next one is the oldest
            self._frames = tuple(
                np.zeros((self._num_frames, *self._each, size // self._num_frames, *rest), np.float32)
                for size, *rest in (layout.image_shape, (layout.num_features,))
            )

    def reset(self, envs: Sequence[int]) -> None:
        """Fill all frames of the environments `envs` with their current one, the first of an episode."""
        if self._num_frames > 1:
            self._draw_frame()
            for frames in self._frames:
                frames[:, envs] = frames[self._newest, envs]

    def step(self) -> None:
        """Replace the oldest frame by the current one, after a step."""
        if self._num_frames > 1:
            self._newest = (self._newest + 1) % self._num_frames
            self._draw_frame()

    def _draw_frame(self) -> None:
        image, features = self._frames
        self._draw(image[self._newest], features[self._newest])

    def observe(self) -> tuple[Floats, Floats]:
        """Return the whole images (B, N, ...) and features (B, N, ...), float32, in new arrays.

        Agents that have disappeared observe zeros, also in their earlier frames.
        """
        image, features = np.empty(self._image_shape, np.float32), np.empty(self._features_shape, np.float32)
        if self._num_frames > 1:
            for frames, whole in zip(self._frames, (image, features), strict=True):
                for k, part in enumerate(np.split(whole, self._num_frames, axis=2), start=1):
                    part[:] = frames[(self._newest + k) % self._num_frames]
        else:
            self._draw(image, features)
        if self._agents_disappear:
            gone = ~self._inputs.state.agents["was_active"]
            image[gone] = 0
            features[gone] = 0
        return image, features

    def _draw(self, image: Floats, features: Floats) -> None:
        """Fill `image` and `features` with one frame: each agent's own observation, and those of its neighbors."""
        inputs = self._inputs
        own_image, own_features = self._own if self._num_neighbors else (image, features)
        self._images.write(own_image)
        self._layout.write_features(inputs, own_features)
        self._layout.check_user_parts(own_image, own_features, inputs.state.agents["was_active"])
        if not self._num_neighbors:
            return
        agents, width = inputs.state.agents, inputs.world.width
        find_neighbors(inputs.num_threads, width, self._radius, agents, self._steps, self._neighbors)
        for own, whole in zip(self._own, (image, features), strict=True):
            parts = whole.reshape(*self._each, 1 + self._num_neighbors, -1)
            append_neighbors(inputs.num_threads, self._neighbors, own.reshape(*self._each, -1), parts)


@BatchKernel
def find_neighbors(width: int, radius: int, agents: Array, steps: Array, neighbors: Array) -> None:
    """Write the indices of each agent's nearest others to `neighbors` (B, N, K) int32, nearest first; -1: none.

    The others are at most `radius` rows and columns away. The nearest is the one that the fewest moves up, down, left
    and right lead to; of two as near, the one of the lower index comes first. Agents that have disappeared have no
    neighbors and are none. `steps` (B, N, K) int32 is scratch; the map is `width` cells wide.
    """
    for b in prange(agents.shape[0]):
        _find_neighbors_of(width, radius, agents[b], steps[b], neighbors[b])


@jit
def _find_neighbors_of(width: int, radius: int, agents: Array, steps: Array, neighbors: Array) -> None:
    for i in range(agents.size):
        steps[i, :] = _FAR
        neighbors[i, :] = -1
        if not agents[i].active:
            continue
        row, col = agents[i].cell // width, agents[i].cell % width
        for j in range(agents.size):
            rows, cols = abs(agents[j].cell // width - row), abs(agents[j].cell % width - col)
            if j != i and agents[j].active and max(rows, cols) <= radius:
                _insert(j, rows + cols, steps[i], neighbors[i])


@jit
def _insert(agent: int, distance: int, steps: Array, neighbors: Array) -> None:
    """Insert an agent into `neighbors` (K,) after those that are as near; the farthest one drops out."""
    k = neighbors.size
    while k > 0 and distance < steps[k - 1]:
        k -= 1
        if k + 1 < neighbors.size:
            steps[k + 1], neighbors[k + 1] = steps[k], neighbors[k]
    if k < neighbors.size:
        steps[k], neighbors[k] = distance, agent


@BatchKernel
def append_neighbors(neighbors: Array, own: Array, whole: Array) -> None:
    """Write each agent's `own` numbers (B, N, S), then those of its neighbors, to `whole` (B, N, 1 + K, S).

    `neighbors` (B, N, K) are indices of agents; for -1, zeros are written.
    """
    for b in prange(own.shape[0]):
        _append_neighbors_of(neighbors[b], own[b], whole[b])


@jit
def _append_neighbors_of(neighbors: Array, own: Array, whole: Array) -> None:
    for i in range(own.shape[0]):
        whole[i, 0, :] = own[i]
        for k in range(neighbors.shape[1]):
            if neighbors[i, k] >= 0:
                whole[i, k + 1, :] = own[neighbors[i, k]]
            else:
                whole[i, k + 1, :] = 0
