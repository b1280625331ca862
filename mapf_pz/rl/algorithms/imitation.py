"""Imitation of a planner: supervised learning of its actions, from a replay buffer."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase, TensorDictSequential
from torch import Tensor, nn
from torch.nn.functional import cross_entropy
from torchrl.envs import Transform

from mapf_pz.rl.algorithms.algorithm import Algorithm
from mapf_pz.rl.algorithms.expert import NO_LABEL, ExpertActions, is_labeled
from mapf_pz.rl.algorithms.learner import Learner
from mapf_pz.rl.algorithms.replay import make_replay
from mapf_pz.rl.algorithms.symmetries import Symmetries
from mapf_pz.rl.config import TrainConfig
from mapf_pz.rl.environments.execution import ExecutePreferences, SamplePreferences
from mapf_pz.rl.environments.recorded_states import RecordStates
from mapf_pz.rl.networks.joint_actor import DecisionRounds, JointActor, random_decisions
from mapf_pz.rl.networks.observation_shape import ObservationShape
from mapf_pz.simulator.actions import wait_action
from mapf_pz.simulator.config import EnvConfig
from mapf_pz.simulator.observation import ObservationLayout


class ImitationLearner(Learner):
    """Minimizes the cross entropy of the expert's actions over samples of all steps that are still in the buffer."""

    def __init__(self, config: TrainConfig, network: nn.Module, keys: list[NestedKey]) -> None:
        """Create the optimizer and the buffer; raises `ValueError` if `augment` cannot transform the observations.

        Args:
            config: the configuration of the run.
            network: the network of the logits of an agent's action.
            keys: the keys of the observation, the network's inputs.
        """
        self.config = config
        self.modules = {"policy": network}
        parameters = list(network.parameters())
        self.device = parameters[0].device
        self._network, self._keys = self.compiled(network), keys
        self._undecided = network.undecided if isinstance(network, JointActor) else None
        rate = config.optimization.learning_rate
        self.optimizer = torch.optim.Adam([{"params": parameters, "initial_lr": rate}], lr=rate)
        self._symmetries = None
        if config.imitation.augment:
            self._symmetries = Symmetries.of_env(config.task.env, config.task.source.shape).to(self.device)
        self._history = _History(config.task.env, self.device) if config.imitation.history_dropout else None
        self._replay = make_replay(config, keys, self.device)
        self.data = self._replay.data
        self._minibatch_size = config.optimization.minibatch_size * config.task.num_agents

    def learn(self, batch: TensorDictBase, done: float) -> dict[str, float]:
        """Add a batch to the buffer and update the network, as in `Learner`.

        The number of gradient steps is that of `num_epochs` passes over the batch; their samples are from the buffer.
        """
        self.anneal(done)
        self._replay.extend(batch)
        agent_steps = batch.get(("agents", "expert_action")).numel()
        steps = max(1, self.config.optimization.num_epochs * agent_steps // self._minibatch_size)
        losses = torch.stack([self._improve(self._replay.sample()) for _ in range(steps)])
        return {"loss": float(losses.mean()), "agreement": self._agreement(batch), "buffer": float(len(self._replay))}

    def _agreement(self, batch: TensorDictBase) -> float:
        """Return the fraction of the labels that were the policy's most likely action.

        Waits at goals count as much as they are learned from.
        """
        agents = batch.get("agents")
        label = agents.get("expert_action")
        rests = (label == wait_action(self.config.task.env.action_model)) & agents.get("at_goal").squeeze(-1)
        weights = torch.where(rests, self.config.imitation.wait_share, 1.0) * is_labeled(agents)
        return float((weights * (agents.get("logits").argmax(-1) == label)).sum() / weights.sum())

    def _improve(self, samples: TensorDictBase) -> Tensor:
        """Take one gradient step, and return the loss."""
        inputs, actions = [samples.get(str(number)) for number in range(len(self._keys))], samples.get("expert_action")
        if self._symmetries is not None:
            which = torch.randint(self._symmetries.number, (len(actions),)).to(self.device)
            inputs = self._symmetries.transform(which, *inputs)
            actions = self._symmetries.transform_actions(which, actions)
        learned = samples.get("learned")
        if self._history is not None:
            inputs[1] = self._history.dropped(inputs[1], self.config.imitation.history_dropout)
        if self._undecided is not None:
            rounds = self.config.model.decision_rounds
            decided = random_decisions(actions, actions != NO_LABEL, rounds, self._undecided)
            inputs, learned = [*inputs, decided], learned & (decided == self._undecided)
        label = actions.masked_fill(~learned, NO_LABEL)
        with self.autocast():
            (logits,) = self._network(*inputs)
            losses = cross_entropy(logits.flatten(0, -2), label.flatten(), ignore_index=NO_LABEL, reduction="sum")
            loss = losses / learned.sum().clamp(min=1)
        self.step(loss, self.config.optimization.max_grad_norm)
        return loss.detach()


class _History:
    """The last actions in the features of observations."""

    def __init__(self, config: EnvConfig, device: torch.device) -> None:
        """Find them; raises `ValueError` if they are not observed."""
        layout = ObservationLayout(config)
        place = layout.own_feature("last_actions")
        if place is None:
            raise ValueError("history_dropout: expected the feature 'last_actions'")
        one = torch.zeros(layout.num_actions + 1, device=device)  # which action it was, and whether the agent moved
        one[wait_action(config.action_model)] = 1
        self._place, self._waits = place, one.repeat(config.num_last_actions)

    def dropped(self, features: Tensor, share: float) -> Tensor:
        """Return features (..., F) in which a share of the agents, chosen at random, have only waited."""
        chosen = torch.rand((*features.shape[:-1], 1), device=features.device) < share
        waited = features.clone()
        waited[..., self._place] = self._waits.to(features.dtype)
        return torch.where(chosen, waited, features)


class Imitation(Algorithm):
    """Base class of algorithms that learn a planner's actions.

    The policy acts by itself, or under the safety layer, as it will be used.
    """

    added_layers = ("decision",)

    def __init__(self, config: TrainConfig) -> None:
        """Build the network; raises `ValueError` with `recurrent`, and as `JointActor`."""
        if config.model.recurrent:
            expected = f"0 with {config.algorithm}, which uses single steps"
            raise ValueError(f"recurrent={config.model.recurrent}: expected {expected}")
        super().__init__(config)

    @staticmethod
    def make_network(config: TrainConfig) -> nn.Module:
        """Return the network of the logits, newly initialized."""
        if config.model.decision_rounds > 1:
            return JointActor(ObservationShape.of_task(config.task), config.model)
        return Algorithm.make_network(config)

    @staticmethod
    def acting_temperature(config: TrainConfig) -> float:
        """Return the temperature of the configuration."""
        return config.imitation.temperature

    def make_actor(self) -> TensorDictModuleBase:
        """Return the network, followed by sampling, or sampling in rounds."""
        keys: list[NestedKey] = [("agents", "preferences")]
        temperature = self.acting_temperature(self.config)
        if isinstance(self.network, JointActor):
            sampler = DecisionRounds(self.network, self.config.model.decision_rounds, temperature)
            return TensorDictModule(sampler, self.observation_keys(), [*self.parameters, *keys])
        sampling = SamplePreferences(temperature)
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
        recorded = [RecordStates()] if self.config.imitation.replay == "states" else []
        return [*recorded, ExpertActions(self.config.imitation, seed, self.config.num_threads), *self.transforms(seed)]
