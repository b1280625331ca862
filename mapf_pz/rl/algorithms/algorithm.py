"""The base class of algorithms: each combines environment transforms, an actor and a learner.

The training loop is in `mapf_pz.rl.training.updates`, and is the same for all algorithms.
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Generator, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from typing import ClassVar

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import nn
from torchrl.collectors import BaseCollector
from torchrl.data import Unbounded
from torchrl.envs import InitTracker, TensorDictPrimer, Transform

from mapf_pz.rl.algorithms.learner import Learner
from mapf_pz.rl.config import TrainConfig
from mapf_pz.rl.environments.collect import collecting, send_weights
from mapf_pz.rl.networks.actors import Actor, add_recurrence
from mapf_pz.rl.networks.observation_shape import ObservationShape


class Algorithm(ABC):
    """Base class of algorithms: the interface that the training loop uses.

    The network is that of one agent, and all agents share it, unless a subclass overrides `make_network`.
    """

    parameters: ClassVar[list[NestedKey]] = [("agents", "logits")]
    """Keys of the network's outputs, the parameters of the action distribution."""
    centralized: ClassVar[bool] = False
    """Whether one policy acts for all agents, instead of each agent acting by itself."""
    added_layers: ClassVar[tuple[str, ...]] = ()
    """Names of the network's layers that an `Actor` with the same configuration does not have."""

    def __init__(self, config: TrainConfig) -> None:
        """Build the networks."""
        self.config = config
        self.observation_shape = ObservationShape.of_task(config.task)
        self.network = self.make_network(config)
        """The network that is saved as the policy."""
        self.actor = self.make_actor()
        """The policy that acts in the environments; its output includes the action of `transforms`."""

    def start_from(self, network: nn.Module) -> None:
        """Start from the weights of a network with the same layers, or of an `Actor` without `added_layers`.

        Raises `ValueError` if it has others.
        """
        weights = network.state_dict()
        if type(network) is Actor:
            own = self.network.state_dict().items()
            weights |= {name: weight for name, weight in own if name.partition(".")[0] in self.added_layers}
        try:
            self.network.load_state_dict(weights)
        except RuntimeError as error:
            reason = " ".join(str(error).split())
            raise ValueError(f"initial_policy: not the networks of this configuration: {reason[:200]}") from None

    @staticmethod
    def make_network(config: TrainConfig) -> nn.Module:
        """Return the policy's network, newly initialized."""
        return add_recurrence(Actor(ObservationShape.of_task(config.task), config.model), config.model)

    @abstractmethod
    def make_actor(self) -> TensorDictModuleBase:
        """Return the policy that samples actions."""

    @abstractmethod
    def make_learner(self) -> Learner:
        """Return the learner, which updates `network`."""

    def observation_keys(self) -> list[NestedKey]:
        """Return the keys of each agent's image and, if there are any, of its features."""
        if self.observation_shape.features:
            return [("agents", "observation", "image"), ("agents", "observation", "features")]
        return [("agents", "observation")]

    @classmethod
    def fixed_num_agents(cls, config: TrainConfig) -> int | None:
        """Return the number of agents that the policy acts for; None: any number."""
        return config.task.num_agents if cls.centralized else None

    @staticmethod
    def num_hidden_states(config: TrainConfig) -> int:
        """Return the number of hidden states per environment: one per agent."""
        return config.task.num_agents

    @staticmethod
    def acting_temperature(config: TrainConfig) -> float:
        """Return the temperature at which the policy's actions are sampled in training."""
        return 1.0

    def transforms(self, seed: int) -> list[Transform]:
        """Return the transforms that the actor needs to act; `seed` is the seed of those that sample."""
        size = self.config.model.recurrent
        if size == 0:
            return []
        hidden_state = Unbounded(shape=torch.Size([self.num_hidden_states(self.config), size]))
        return [InitTracker(), TensorDictPrimer({"hidden_state": hidden_state}, expand_specs=True)]

    def training_transforms(self, seed: int) -> list[Transform]:
        """Return the transforms of the environments that training data is collected in: by default `transforms`."""
        return self.transforms(seed)

    @contextmanager
    def batches(self, seed: int, updates: int) -> Generator[Iterator[TensorDictBase]]:
        """Yield an iterator over at least `updates` batches for the learner, which `seed` determines.

        By default they are those of `collecting`. Statistics of episodes are not reported for batches without `next`.
        """
        if not self.config.overlap:
            with collecting(self, self.config, seed, updates) as collector:
                yield _latest(collector)
            return
        acting = copy.deepcopy(self)  # the workers share the memory of its actor's weights
        with (
            collecting(acting, self.config, seed, updates) as collector,
            closing(_ahead(collector, acting.actor, self.actor)) as batches,
        ):
            yield batches

    def network_module(self) -> TensorDictModule:
        """Return the network with its input and output keys; a hidden state is carried from step to step."""
        if self.config.model.recurrent == 0:
            return TensorDictModule(self.network, in_keys=self.observation_keys(), out_keys=self.parameters)
        in_keys: list[NestedKey] = ["hidden_state", "is_init", *self.observation_keys()]
        return TensorDictModule(self.network, in_keys=in_keys, out_keys=[*self.parameters, ("next", "hidden_state")])


def _latest(collector: BaseCollector) -> Iterator[TensorDictBase]:
    """Yield the batches of a collector, which is given the current weights after each of them."""
    for batch in collector:
        yield batch
        send_weights(collector)


def _ahead(collector: BaseCollector, actor: nn.Module, learned: nn.Module) -> Generator[TensorDictBase]:
    """Yield the batches of a collector, of which the workers collect the next one while the caller uses this one.

    Args:
        collector: the collector.
        actor: the policy of its workers. When the next batch is started, it is given the weights of `learned`: those
            from before the update with this batch.
        learned: the policy that learns.
    """
    batches = iter(collector)
    with ThreadPoolExecutor(1) as thread:  # it only waits for the workers
        coming = thread.submit(next, batches, None)
        while (batch := coming.result()) is not None:
            actor.load_state_dict(learned.state_dict())
            send_weights(collector)
            coming = thread.submit(next, batches, None)
            yield batch
