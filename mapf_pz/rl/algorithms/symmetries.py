"""The symmetries of the grid: a state that is turned by a quarter or mirrored is another state of the same kind."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np
import torch
from torch import Tensor

from mapf_pz._internal.arrays import Ints
from mapf_pz.instances.heading import HEADING_STEPS
from mapf_pz.rl.algorithms.expert import NO_LABEL
from mapf_pz.rl.networks.encoders import widened
from mapf_pz.simulator.config import EnvConfig
from mapf_pz.simulator.observation import ObservationLayout

_TURN, _MIRROR = np.array([(0, -1), (1, 0)]), np.diag([1, -1])  # of a step (rows, columns)
_ACTION_STEPS = np.array([(0, 0), (-1, 0), (1, 0), (0, -1), (0, 1)])  # of each `CardinalAction`
_CELL_CHANNELS = ("view", "goal", "cost_to_go", "other_goals", "others_next", "others_at_goal")
_DIRECTED_CHANNELS = ("edge_weights", "heuristic", "others_heuristic")  # a plane for each of `HEADING_STEPS`


@dataclass(frozen=True)
class Symmetries:
    """The eight symmetries of the square, as they change agents' observations and actions."""

    image: Tensor
    """(8, K * h * w) int64: which number of the image each number of the transformed image is."""
    features: Tensor
    """(8, F, F) float32: the matrices of the features."""
    actions: Tensor
    """(8, A + 1) int64: what becomes of each action; last is `NO_LABEL`, which stays."""

    @classmethod
    def of_env(cls, config: EnvConfig) -> Symmetries:
        """Return the symmetries of an environment; the first one is the identity.

        Raises `ValueError` if agents turn, if the view is not a square with an agent's cell in its center, and for
        observations that do more than change places and signs: `orientation`, `location`, and those of users.
        """
        _check(config)
        images, features, actions = [], [], []
        for mirrored, quarters in product((False, True), range(4)):
            transform = np.linalg.matrix_power(_TURN, quarters) @ (_MIRROR if mirrored else np.eye(2, dtype=int))
            images.append(_image_source(config, mirrored, quarters, transform))
            features.append(_feature_matrix(config, transform))
            actions.append([*_permutation(_ACTION_STEPS, transform), NO_LABEL])
        return cls(torch.tensor(np.array(images)), torch.stack(features), torch.tensor(actions))

    def to(self, device: torch.device) -> Symmetries:
        """Return the same symmetries on a device."""
        return Symmetries(self.image.to(device), self.features.to(device), self.actions.to(device))

    @property
    def number(self) -> int:
        """The number of symmetries: 8."""
        return len(self.actions)

    def transform(self, which: Tensor, image: Tensor, features: Tensor | None = None) -> list[Tensor]:
        """Return observations `(B, ..., K, h, w)` and `(B, ..., F)`, each transformed by one of `which` (B,) int64."""
        flat = image.reshape(len(image), -1, self.image.shape[-1])
        moved = flat.gather(-1, self.image[which].unsqueeze(1).expand_as(flat)).view_as(image)
        if features is None:
            return [moved]
        return [moved, torch.einsum("bij,b...j->b...i", self.features[which], widened(features))]

    def transform_actions(self, which: Tensor, actions: Tensor) -> Tensor:
        """Return actions `(B, ...)`, each transformed by one of `which` (B,); `NO_LABEL` stays."""
        flat = actions.reshape(len(actions), -1)
        return self.actions[which].gather(-1, flat.remainder(self.actions.shape[-1])).view_as(actions)


def _check(config: EnvConfig) -> None:
    """Raise `ValueError` for an environment that `of_env` cannot transform."""
    height, width = config.view_size
    if config.action_model != "cardinal" or height != width or height % 2 == 0:
        raise ValueError("augment: expected action_model='cardinal' and a square view with an odd side")
    known = (*_CELL_CHANNELS, *_DIRECTED_CHANNELS, *_feature_matrices(config, _MIRROR))
    for name in (*config.channels, *config.features):
        if name not in known:
            raise ValueError(f"augment: expected channels and features among {', '.join(known)}; got {name!r}")


def _permutation(steps: Ints, transform: Ints) -> Ints:
    """Return for each of some steps the number of the one that it becomes."""
    return np.array([np.flatnonzero((steps == transform @ step).all(1)).item() for step in steps])


def _image_source(config: EnvConfig, mirrored: bool, quarters: int, transform: Ints) -> Ints:
    """Return which number of the image each number of the transformed one is, (K * h * w,)."""
    layout = ObservationLayout(config)
    numbers = np.arange(np.prod(layout.image_shape)).reshape(-1, layout.num_own_planes, *config.view_size)
    moved = np.rot90(numbers[..., ::-1] if mirrored else numbers, quarters, axes=(2, 3))
    becomes, at = _permutation(HEADING_STEPS, transform), 0
    planes = np.arange(layout.num_own_planes)
    for name, channel in zip(config.channels, layout.channels, strict=True):
        if name in _DIRECTED_CHANNELS:
            planes[at + becomes] = at + np.arange(len(becomes))
        at += channel.planes
    return moved[:, planes].reshape(-1)


def _feature_matrix(config: EnvConfig, transform: Ints) -> Tensor:
    """Return the matrix (F, F) of the features of a whole observation."""
    layout, matrices = ObservationLayout(config), _feature_matrices(config, transform)
    own = [matrices[name] for name in config.features if isinstance(name, str)]
    return torch.block_diag(*own * (layout.num_features // max(1, layout.num_own_features)))


def _feature_matrices(config: EnvConfig, transform: Ints) -> Mapping[str, Tensor]:
    """Return the matrix of each feature that can be transformed."""
    action = torch.eye(len(_ACTION_STEPS))[:, _permutation(_ACTION_STEPS, transform)]
    up_right = np.diag([-1, 1])  # of rows and columns
    goal = torch.from_numpy(up_right @ transform @ up_right).float()
    return {
        "action_advantage": action,
        "last_actions": torch.block_diag(*config.num_last_actions * [action, torch.eye(1)]),
        "goal_vector": torch.block_diag(goal, torch.eye(2)),
        "pose": torch.block_diag(torch.from_numpy(transform).float(), torch.eye(4)),  # north stays up
        "time": torch.eye(1),
    }
