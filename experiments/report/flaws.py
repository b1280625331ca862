"""Flaws of the report's published code, as transforms of the environment, for the reproduction."""

from __future__ import annotations

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.envs import Transform

from mapf_pz.rl.algorithms.ppo import CentralPPO
from mapf_pz.rl.config import TrainConfig
from mapf_pz.simulator.actions import Action

GOAL, OTHER_GOALS = 1, 7
"""Planes of `view`, `goal`, `orientation`, `edge_weights` (4), `other_goals`."""


class Flaw(Transform):
    """A behavior of the published code that the report does not mention."""


class ImageFlaw(Flaw):
    """Base class of flaws that change each agent's image."""

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        return self._step(tensordict, tensordict_reset)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        key: NestedKey = ("agents", "observation")
        if not isinstance(next_tensordict[key], Tensor):
            key = ("agents", "observation", "image")
        next_tensordict[key] = self.change_image(next_tensordict[key])
        return next_tensordict

    def change_image(self, image: Tensor) -> Tensor:
        """Return the changed `image` (B, N, K, h, w)."""
        raise NotImplementedError


class Bytes(ImageFlaw):
    """Observations declared as `uint8`: fractions are truncated, -1 becomes 255, and the network divides by 255."""

    def change_image(self, image: Tensor) -> Tensor:
        """Return the image as bytes, divided by 255."""
        return image.trunc().remainder(256) / 255


class AllGoals(ImageFlaw):
    """Agents cannot distinguish their own goals from those of agents in view (in the report: from any goal in view)."""

    def change_image(self, image: Tensor) -> Tensor:
        """Return the image with all goals in the plane of the own goal."""
        image = image.clone()
        image[..., GOAL, :, :] = torch.maximum(image[..., GOAL, :, :], image[..., OTHER_GOALS, :, :])
        image[..., OTHER_GOALS, :, :] = 0
        return image


class Freeze(Flaw):
    """Agents that have reached their goals never act again, not even in later episodes."""

    def __init__(self) -> None:
        """Start without frozen agents."""
        super().__init__(in_keys_inv=[("agents", "action")], out_keys_inv=[("agents", "action")])
        self._frozen = torch.zeros(0, dtype=torch.bool)

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        if not self._frozen.numel():
            self._frozen = torch.zeros_like(tensordict_reset["agents", "at_goal"].squeeze(-1))
        return tensordict_reset

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        self._frozen = self._frozen | next_tensordict["agents", "at_goal"].squeeze(-1)
        return next_tensordict

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        actions = tensordict.get(("agents", "action"), None)
        if actions is not None and self._frozen.numel():
            tensordict[("agents", "action")] = torch.where(self._frozen, int(Action.WAIT), actions)
        return tensordict


class FlawedPPO(CentralPPO):
    """The report's algorithm, in an environment with some of its flaws."""

    def __init__(self, config: TrainConfig, flaws: tuple[type[Flaw], ...]) -> None:
        """Build the networks and the loss."""
        self._flaws = flaws
        super().__init__(config)

    def transforms(self, seed: int) -> list[Transform]:
        """Return the transforms of the flaws and of the centralized form."""
        return [*(flaw() for flaw in self._flaws), *super().transforms(seed)]
