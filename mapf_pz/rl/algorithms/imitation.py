"""Imitation of a planner: supervised learning of its actions, from a replay buffer."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase, TensorDictSequential
from torch import Tensor, nn
from torch.nn.functional import cross_entropy
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs import Transform

from mapf_pz.rl.algorithms.algorithm import Algorithm
from mapf_pz.rl.algorithms.expert import NO_LABEL, ExpertActions
from mapf_pz.rl.algorithms.learner import Learner
from mapf_pz.rl.algorithms.state_buffer import StateBuffer
from mapf_pz.rl.algorithms.symmetries import Symmetries
from mapf_pz.rl.config import TrainConfig
from mapf_pz.rl.environments.batched_env import OBSERVATION_DTYPES
from mapf_pz.rl.environments.execution import ExecutePreferences, SamplePreferences
from mapf_pz.rl.environments.recorded_states import RecordStates, states_of
from mapf_pz.rl.environments.transfer import to_device
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
        rate = config.optimization.learning_rate
        self.optimizer = torch.optim.Adam([{"params": parameters, "initial_lr": rate}], lr=rate)
        self._wait = wait_action(config.task.env.action_model)
        self._minibatch_size = config.optimization.minibatch_size * config.task.num_agents
        self._sample_size = config.task.num_agents if config.model.communication else 1  # in agent steps
        self._symmetries = None
        if config.imitation.augment:
            self._symmetries = Symmetries.of_env(config.task.env, config.task.source.shape).to(self.device)
        self._history = _History(config.task.env, self.device) if config.imitation.history_dropout else None
        self._states: StateBuffer | None = None
        if config.imitation.replay == "states":
            self._states = StateBuffer(
                config.task.env_config(),
                config.imitation.buffer_size // config.task.num_agents,
                config.optimization.minibatch_size,
                config.num_threads,
            )
            self.data = self._states
        self._buffer = TensorDictReplayBuffer(
            storage=LazyTensorStorage(config.imitation.buffer_size // self._sample_size, device=self.device),
            batch_size=self._minibatch_size // self._sample_size,
        )

    def learn(self, batch: TensorDictBase, done: float) -> dict[str, float]:
        """Add a batch to the buffer and update the network, as in `Learner`.

        The number of gradient steps is that of `num_epochs` passes over the batch; their samples are from the buffer.
        """
        self.anneal(done)
        agent_steps = batch.get(("agents", "expert_action")).numel()
        samples = self._samples(to_device(batch, self.device))
        agreement = self._agreement(samples)
        steps = max(1, self.config.optimization.num_epochs * agent_steps // self._minibatch_size)
        if self._states is None:
            self._buffer.extend(samples.exclude("logits"))  # those of the policy as it was
            size = len(self._buffer) * self._sample_size
        else:
            _remember(self._states, batch)
            size = len(self._states) * self.config.task.num_agents
        losses = torch.stack([self._improve(self._sample()) for _ in range(steps)])
        return {"loss": float(losses.mean()), "agreement": agreement, "buffer": float(size)}

    def _sample(self) -> TensorDictBase:
        """Return a minibatch from the buffer."""
        if self._states is None:
            return self._buffer.sample()
        imitation, num_agents = self.config.imitation, self.config.task.num_agents
        rng = np.random.default_rng(int(torch.randint(2**62, ())))
        image, features, at_goal, label = self._states.sample(rng, imitation.recent_size // num_agents)
        rests = (label == self._wait) & at_goal & (rng.random(label.shape) >= imitation.wait_share)
        label[rests] = NO_LABEL
        dtype = OBSERVATION_DTYPES[self.config.observation_precision]
        inputs = {str(k): torch.from_numpy(part).to(dtype) for k, part in enumerate((image, features))}
        entries = {name: inputs[name] for name, _ in zip(inputs, self._keys, strict=False)}
        return to_device(
            TensorDict({**entries, "label": torch.from_numpy(label)}, batch_size=[len(label)]), self.device
        )

    def _samples(self, batch: TensorDictBase) -> TensorDictBase:
        """Return the labeled agent steps of a batch; of waits at the goal only a part, since most are alike.

        With communication, they are the environment steps that have any, in which other labels are `NO_LABEL`.
        """
        agents = batch.get("agents")
        label = agents.get("expert_action")
        rests = (label == self._wait) & agents.get("at_goal").squeeze(-1)
        learned = (label != NO_LABEL) & agents.get("active").squeeze(-1)
        learned &= ~rests | (torch.rand(label.shape).to(self.device) < self.config.imitation.wait_share)
        kept = learned.any(-1) if self.config.model.communication else learned
        entries = {str(number): batch.get(key)[kept] for number, key in enumerate(self._keys)}
        label = label.masked_fill(~learned, NO_LABEL)[kept]
        logits = agents.get("logits")[kept]
        return TensorDict({**entries, "label": label, "logits": logits}, batch_size=[int(kept.sum())])

    @staticmethod
    def _agreement(samples: TensorDictBase) -> float:
        """Return the fraction of the samples in which the policy's most likely action was the expert's."""
        agrees, label = samples.get("logits").argmax(-1) == samples.get("label"), samples.get("label")
        return float(agrees[label != NO_LABEL].float().mean())

    def _improve(self, samples: TensorDictBase) -> Tensor:
        """Take one gradient step, and return the loss."""
        inputs, label = [samples.get(str(number)) for number in range(len(self._keys))], samples.get("label")
        if self._symmetries is not None:
            which = torch.randint(self._symmetries.number, (len(label),)).to(self.device)
            inputs, label = self._symmetries.transform(which, *inputs), self._symmetries.transform_actions(which, label)
        if self._history is not None:
            inputs[1] = self._history.dropped(inputs[1], self.config.imitation.history_dropout)
        with self.autocast():
            (logits,) = self._network(*inputs)
            loss = cross_entropy(logits.flatten(0, -2), label.flatten(), ignore_index=NO_LABEL)
        self.step(loss, self.config.optimization.max_grad_norm)
        return loss.detach()


def _remember(buffer: StateBuffer, batch: TensorDictBase) -> None:
    """Add the environment steps of a batch in which agents are labeled."""
    label = batch.get(("agents", "expert_action")).reshape(-1, batch.get("agents").shape[-1])
    kept = (label != NO_LABEL).any(-1).cpu().numpy()
    buffer.extend(states_of(batch, kept), label.cpu().numpy()[kept])


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
        recorded = [RecordStates()] if self.config.imitation.replay == "states" else []
        return [*recorded, ExpertActions(self.config.imitation, seed, self.config.num_threads), *self.transforms(seed)]
