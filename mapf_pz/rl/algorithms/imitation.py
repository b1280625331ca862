"""Imitation of a planner."""

from __future__ import annotations

from typing import Any

from tensordict import NestedKey
from tensordict.nn import TensorDictModule, TensorDictModuleBase, TensorDictSequential
from torchrl.envs import Transform

from mapf_pz.rl.algorithms.algorithm import Algorithm
from mapf_pz.rl.algorithms.expert import ExpertActions
from mapf_pz.rl.algorithms.imitation_learner import ImitationLearner
from mapf_pz.rl.config import TrainConfig
from mapf_pz.rl.environments.execution import ExecutePreferences, SamplePreferences


class Imitation(Algorithm):
    """Base class of algorithms that learn a planner's actions.

    The policy acts by itself, or under the safety layer, as it will be used.
    """

    def __init__(self, config: TrainConfig) -> None:
        """Build the network; raises `ValueError` with `recurrent`."""
        if config.model.recurrent:
            expected = f"0 with {config.algorithm}, which uses single steps"
            raise ValueError(f"recurrent={config.model.recurrent}: expected {expected}")
        super().__init__(config)

    @staticmethod
    def acting_temperature(config: TrainConfig) -> float:
        """Return the temperature of the configuration."""
        return config.imitation.temperature

    def make_actor(self) -> TensorDictModuleBase:
        """Return the network, followed by sampling."""
        sampling = SamplePreferences(self.acting_temperature(self.config))
        keys: list[NestedKey] = [("agents", "preferences")]
        modules: list[Any] = [self.network_module(), TensorDictModule(sampling, self.parameters, keys)]
        return TensorDictSequential(*modules)

    def make_learner(self) -> ImitationLearner:
        """Return the learner of the expert's actions."""
        return ImitationLearner(self.config, self.network, self.observation_keys())

    def transforms(self, seed: int) -> list[Transform]:
        """Return the transform that executes the policy's preferences."""
        return [ExecutePreferences(self.config.task.shield)]


class Dagger(Imitation):
    """DAgger: a planner labels the states that the policy visits (Ross, Gordon and Bagnell, AISTATS 2011)."""

    def training_transforms(self, seed: int) -> list[Transform]:
        """Return the same, and before it the transform that adds the expert's actions."""
        return [ExpertActions(self.config.imitation, seed), *self.transforms(seed)]
