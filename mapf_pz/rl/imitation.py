"""Imitation of a planner."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import NestedKey
from tensordict.nn import TensorDictModule, TensorDictModuleBase, TensorDictSequential
from torch import Tensor, nn
from torchrl.envs import Transform

from mapf_pz.rl.algorithm import Algorithm
from mapf_pz.rl.config import TrainConfig
from mapf_pz.rl.execution import ExecutePreferences
from mapf_pz.rl.expert import ExpertActions
from mapf_pz.rl.imitation_learner import ImitationLearner


class Dagger(Algorithm):
    """DAgger: a planner labels the states that the policy visits (Ross, Gordon and Bagnell, AISTATS 2011).

    The policy acts by itself, or under the safety layer, as it will be used.
    """

    def __init__(self, config: TrainConfig) -> None:
        """Build the network; raises `ValueError` with `recurrent`."""
        if config.model.recurrent:
            raise ValueError(f"recurrent={config.model.recurrent}: expected 0 with dagger, which uses single steps")
        super().__init__(config)

    def make_actor(self) -> TensorDictModuleBase:
        """Return the network, followed by sampling."""
        sampling = SamplePreferences(self.config.imitation.temperature)
        keys: list[NestedKey] = [("agents", "preferences")]
        modules: list[Any] = [self.network_module(), TensorDictModule(sampling, self.parameters, keys)]
        return TensorDictSequential(*modules)

    def make_learner(self) -> ImitationLearner:
        """Return the learner of the expert's actions."""
        return ImitationLearner(self.config, self.network, self.observation_keys())

    def transforms(self, seed: int) -> list[Transform]:
        """Return the transform that executes the policy's preferences."""
        return [ExecutePreferences(self.config.imitation.shield)]

    def training_transforms(self, seed: int) -> list[Transform]:
        """Return the same, and before it the transform that adds the expert's actions."""
        return [ExpertActions(self.config.imitation, seed), *self.transforms(seed)]


class SamplePreferences(nn.Module):
    """Preferences from logits: the order of the actions is a sample without replacement from their distribution.

    Adding Gumbel noise to logits and taking the largest is sampling (Kool et al., *Stochastic Beams and Where to Find
    Them*, ICML 2019).
    """

    def __init__(self, temperature: float) -> None:
        """Create the module: logits are divided by `temperature`; with 0, they are the preferences."""
        super().__init__()
        self._temperature = temperature

    def forward(self, logits: Tensor) -> Tensor:
        """Return the preferences (..., A)."""
        if self._temperature == 0:
            return logits
        return logits / self._temperature - torch.empty_like(logits).exponential_().log()
