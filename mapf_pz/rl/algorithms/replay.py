"""Replay buffers of labeled steps: what imitation learns from."""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path

import numpy as np
import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer

from mapf_pz.rl.algorithms.expert import NO_LABEL, is_labeled
from mapf_pz.rl.algorithms.learner import Data
from mapf_pz.rl.algorithms.state_buffer import StateBuffer, step_files
from mapf_pz.rl.config import TrainConfig
from mapf_pz.rl.config_file import CONFIG, config_values, load_config
from mapf_pz.rl.environments.batched_env import OBSERVATION_DTYPES
from mapf_pz.rl.environments.recorded_states import states_of
from mapf_pz.rl.environments.transfer import to_device
from mapf_pz.simulator.actions import wait_action


class Replay(ABC):
    """A buffer of labeled agent steps, and minibatches of them.

    A minibatch has the network's inputs as `"0"`, `"1"`, ..., the expert's actions as `"expert_action"`, and as
    `"learned"` (bool) which of them are learned from: those of present agents in labeled states. Of waits at goals only
    a part is learned from, since most are alike.
    """

    data: Data | None = None
    """What is kept beside checkpoints; None: nothing."""

    def __init__(self, config: TrainConfig, keys: list[NestedKey], device: torch.device) -> None:
        """Create an empty buffer.

        Args:
            config: the configuration of the run.
            keys: the keys of the observation, the network's inputs.
            device: the device of minibatches.
        """
        self._keys, self._device = keys, device
        self._imitation, self._num_agents = config.imitation, config.task.num_agents
        self._wait = wait_action(config.task.env.action_model)

    @abstractmethod
    def __len__(self) -> int:
        """Return the number of agent steps."""

    @abstractmethod
    def extend(self, batch: TensorDictBase) -> None:
        """Add the labeled steps of a batch; the oldest ones are dropped if need be."""

    @abstractmethod
    def sample(self) -> TensorDictBase:
        """Return a minibatch."""

    def _repeats(self, label: Tensor, at_goal: Tensor) -> Tensor:
        """Return which agent steps are waits at goals that are not learned from."""
        drawn = torch.rand(label.shape).to(label.device)
        return (label == self._wait) & at_goal & (drawn >= self._imitation.wait_share)


class ObservationReplay(Replay):
    """Observations, on the device of the networks.

    With communication, its items are environment steps of all agents, otherwise agent steps.
    """

    def __init__(self, config: TrainConfig, keys: list[NestedKey], device: torch.device) -> None:
        """Create an empty buffer: see `Replay`."""
        super().__init__(config, keys, device)
        self._whole_teams = bool(config.model.communication)
        self._item_size = self._num_agents if self._whole_teams else 1  # in agent steps
        minibatch_size = config.optimization.minibatch_size * self._num_agents
        self._buffer = TensorDictReplayBuffer(
            storage=LazyTensorStorage(config.imitation.buffer_size // self._item_size, device=device),
            batch_size=minibatch_size // self._item_size,
        )

    def __len__(self) -> int:
        """Return the number of agent steps."""
        return len(self._buffer) * self._item_size

    def extend(self, batch: TensorDictBase) -> None:
        """Add the labeled steps of a batch; the oldest ones are dropped if need be."""
        batch = to_device(batch, self._device)
        agents, label = batch.get("agents"), batch.get(("agents", "expert_action"))
        learned = is_labeled(agents) & ~self._repeats(label, agents.get("at_goal").squeeze(-1))
        kept = learned.any(-1) if self._whole_teams else learned
        entries = {str(number): batch.get(key)[kept] for number, key in enumerate(self._keys)}
        entries |= {"expert_action": label[kept], "learned": learned[kept]}
        self._buffer.extend(TensorDict(entries, batch_size=[int(kept.sum())]))

    def sample(self) -> TensorDictBase:
        """Return a minibatch; each item has the same probability."""
        return self._buffer.sample()


_ALIKE = ("action_model", "on_target", "edge_weights")
"""What labels depend on, apart from states: fields of the environment."""


class StateReplay(Replay):
    """States, in which agents observe again when they are learned from."""

    def __init__(self, config: TrainConfig, keys: list[NestedKey], device: torch.device) -> None:
        """Create a buffer, see `Replay`, with the steps of the run `dataset`, if there is one.

        Raises `FileNotFoundError` if that run has none, and `ValueError` (`FormatError`) if they are of another
        environment.
        """
        super().__init__(config, keys, device)
        self._states = StateBuffer(
            config.task.env_config(),
            config.imitation.buffer_size // self._num_agents,
            config.optimization.minibatch_size,
            config.num_threads,
        )
        if config.imitation.dataset is not None:
            self._load(Path(config.imitation.dataset), config)
        self.data = self._states
        self._dtype = OBSERVATION_DTYPES[config.observation_precision]

    def _load(self, run: Path, config: TrainConfig) -> None:
        """Add the steps of a run; raises as `__init__`."""
        files = step_files(run)
        if not files:
            raise FileNotFoundError(f"{run}: expected the folder of a run with replay='states', and a checkpoint")
        other = load_config(run / CONFIG, trust_remote_code=True)  # has been checked at the start of the run
        mine, theirs = (config_values(one)["task"]["env"] for one in (config, other))
        for name in _ALIKE:
            if theirs[name] != mine[name]:
                expected = f"a run with {name}={mine[name]!r}, got {theirs[name]!r}"
                raise ValueError(f"dataset={str(run)!r}: expected {expected}")
        for file in files:
            self._states.load(file)

    def __len__(self) -> int:
        """Return the number of agent steps."""
        return len(self._states) * self._num_agents

    def extend(self, batch: TensorDictBase) -> None:
        """Add the environment steps of a batch in which agents are labeled; the oldest are dropped if need be."""
        label = batch.get(("agents", "expert_action")).reshape(-1, self._num_agents)
        kept = (label != NO_LABEL).any(-1).cpu().numpy()
        self._states.extend(states_of(batch, kept), label.cpu().numpy()[kept])

    def sample(self) -> TensorDictBase:
        """Return a minibatch, half of it out of all environment steps, half out of the most recent ones."""
        rng = np.random.default_rng(int(torch.randint(2**62, ())))
        image, features, at_goal, actions = self._states.sample(rng, self._imitation.recent_size // self._num_agents)
        label = torch.from_numpy(actions)
        learned = (label != NO_LABEL) & ~self._repeats(label, torch.from_numpy(at_goal))
        entries = {str(k): torch.from_numpy(part).to(self._dtype) for k, part in enumerate((image, features))}
        inputs = {name: entries[name] for name, _ in zip(entries, self._keys, strict=False)}
        found = TensorDict({**inputs, "expert_action": label, "learned": learned}, batch_size=[len(label)])
        return to_device(found, self._device)


def make_replay(config: TrainConfig, keys: list[NestedKey], device: torch.device) -> Replay:
    """Return the replay buffer of a configuration; raises `ValueError` and others as its class."""
    make = StateReplay if config.imitation.replay == "states" else ObservationReplay
    return make(config, keys, device)
