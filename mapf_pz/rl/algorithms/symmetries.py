"""Data augmentation: what the symmetries of the grid make of agents' observations and actions, as tensors."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import TypeVar

import numpy as np
import torch
from torch import Tensor

from mapf_pz._internal.arrays import Floats, Ints
from mapf_pz.rl.algorithms.expert import NO_LABEL
from mapf_pz.rl.networks.encoders import widened
from mapf_pz.simulator.config import EnvConfig
from mapf_pz.simulator.kernels.observation.layers import ViewShape
from mapf_pz.simulator.kernels.observation.symmetry import Symmetry, block_diagonal
from mapf_pz.simulator.observation import ObservationLayout

Stated = TypeVar("Stated")


@dataclass(frozen=True)
class Symmetries:
    """The S symmetries of the square that keep the view's shape; each changes agents' observations and actions."""

    image: Tensor
    """(S, K * h * w) int64: which number of the image each number of the transformed image is."""
    heading_planes: Tensor
    """(P,) int64: the planes of the image that show headings."""
    headings: Tensor
    """(S, 5) float32: what the value of no heading, 0, and that of each heading k, `(1 + k) / 4`, becomes."""
    features: Tensor
    """(S, F, F) float32: the matrices of the features."""
    actions: Tensor
    """(S, A + 1) int64: what becomes of each action; last is `NO_LABEL`, which stays."""

    @classmethod
    def of_env(cls, config: EnvConfig, shape: tuple[int, int]) -> Symmetries:
        """Return the symmetries of an environment on maps of `shape` (H, W); the first one is the identity.

        Raises `ValueError` if no other symmetry keeps the shape of the view, and for channels and features that do not
        state their symmetry.
        """
        layout = ObservationLayout(config)
        for name, channel in zip(config.channels, layout.channels, strict=True):
            _stated(name, channel.symmetry)
        cardinal, egocentric = config.action_model == "cardinal", config.resolved_frame == "egocentric"
        candidates = [Symmetry(*each, shape, cardinal, egocentric) for each in product((False, True), range(4))]
        cells = {each: _moved_cells(layout.view_shape(), each) for each in candidates}
        images = {each: _image_source(layout, each, moved) for each, moved in cells.items() if moved is not None}
        chosen = list(images)
        if all(np.array_equal(each.in_view, np.eye(2)) for each in chosen):
            raise ValueError(f"augment: expected a view_size with an odd width, got {config.view_size}")
        return cls(
            torch.tensor(np.array(list(images.values()))),
            torch.tensor(_heading_planes(layout)),
            torch.tensor(np.array([_heading_values(each) for each in chosen]), dtype=torch.float32),
            torch.tensor(np.array([_feature_matrix(config, each) for each in chosen]), dtype=torch.float32),
            torch.tensor(np.array([[*each.actions, NO_LABEL] for each in chosen])),
        )

    def to(self, device: torch.device) -> Symmetries:
        """Return the same symmetries on a device."""
        return Symmetries(*(tensor.to(device) for tensor in vars(self).values()))

    @property
    def number(self) -> int:
        """S, the number of symmetries: at most 8."""
        return len(self.actions)

    def transform(self, which: Tensor, image: Tensor, features: Tensor | None = None) -> list[Tensor]:
        """Return observations `(B, ..., K, h, w)` and `(B, ..., F)`, each transformed by one of `which` (B,) int64."""
        flat = self._transform_headings(which, image).reshape(len(image), -1, self.image.shape[-1])
        moved = flat.gather(-1, self.image[which].unsqueeze(1).expand_as(flat)).view_as(image)
        if features is None:
            return [moved]
        return [moved, torch.einsum("bij,b...j->b...i", self.features[which], widened(features))]

    def transform_actions(self, which: Tensor, actions: Tensor) -> Tensor:
        """Return actions `(B, ...)`, each transformed by one of `which` (B,); `NO_LABEL` stays."""
        flat = actions.reshape(len(actions), -1)
        return self.actions[which].gather(-1, flat.remainder(self.actions.shape[-1])).view_as(actions)

    def _transform_headings(self, which: Tensor, image: Tensor) -> Tensor:
        """Return the image with other values in the planes that show headings."""
        if not len(self.heading_planes):
            return image
        planes = image.index_select(-3, self.heading_planes)
        headings = (4 * planes).round().long().flatten(1)
        values = self.headings[which].gather(1, headings).view_as(planes)
        return image.index_copy(-3, self.heading_planes, values.to(image.dtype))


def _stated(part: object, symmetry: Stated | None) -> Stated:
    """Return the symmetry of a channel or a feature; raises `ValueError` if it does not state one."""
    if symmetry is None:
        raise ValueError(f"augment: expected channels and features that state their symmetry, got {part!r}")
    return symmetry


def _moved_cells(view: ViewShape, symmetry: Symmetry) -> Ints | None:
    """Return which cell of the view, `row * w + column`, each becomes, (h * w,); None: some would be outside of it."""
    own = np.array([view.row, view.column])
    cells = np.indices((view.height, view.width)).reshape(2, -1).T
    rows, columns = (own + (cells - own) @ symmetry.in_view.T).T
    if rows.min() < 0 or columns.min() < 0 or rows.max() >= view.height or columns.max() >= view.width:
        return None
    return rows * view.width + columns


def _image_source(layout: ObservationLayout, symmetry: Symmetry, moved_cells: Ints) -> Ints:
    """Return which number of the image each number of the transformed one is, (K * h * w,)."""
    planes, at = np.arange(layout.num_own_planes), 0
    for channel in layout.channels:
        if channel.symmetry == "directions":
            planes[at + symmetry.directions] = at + np.arange(channel.planes)
        at += channel.planes
    numbers = np.arange(np.prod(layout.image_shape)).reshape(-1, len(planes), len(moved_cells))
    return numbers[:, planes][:, :, moved_cells.argsort()].reshape(-1)


def _heading_planes(layout: ObservationLayout) -> Ints:
    """Return the planes of the whole image that show headings."""
    own = [channel.symmetry == "headings" for channel in layout.channels for _ in range(channel.planes)]
    return np.flatnonzero(np.tile(own, layout.image_shape[0] // len(own)))


def _heading_values(symmetry: Symmetry) -> Floats:
    """Return what the values of no heading and of each heading become, (5,)."""
    return np.array([0, *(1 + symmetry.headings_in_view)]) / 4


def _feature_matrix(config: EnvConfig, symmetry: Symmetry) -> Floats:
    """Return the matrix (F, F) of the features of a whole observation."""
    layout, own = ObservationLayout(config), list[Floats]()
    for name, feature, size in zip(config.features, layout.features, layout.feature_sizes, strict=True):
        matrix = _stated(name, feature.symmetry)(symmetry, size)
        if np.shape(matrix) != (size, size):
            raise ValueError(f"augment: expected a matrix {size, size} of {name!r}, got {np.shape(matrix)}")
        own.append(matrix)
    return block_diagonal(*own * (layout.num_features // max(1, layout.num_own_features)))
