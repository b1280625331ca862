"""What an algorithm is: an actor, a critic and a loss, put together from TorchRL's parts. No loops live here."""

from __future__ import annotations

from dataclasses import dataclass

from tensordict import NestedKey
from tensordict.nn import TensorDictModule
from torch import nn
from torch.distributions import Categorical
from torchrl.modules import ProbabilisticActor
from torchrl.objectives import IPPOLoss, MAPPOLoss, ValueEstimators

from mapf_pz.observation import ObservationLayout
from mapf_pz.rl.config import AlgorithmName, ModelConfig, TrainConfig
from mapf_pz.rl.models import Actor, LocalCritic, TeamCritic

Keys = list[NestedKey]


@dataclass(frozen=True)
class Algorithm:
    """What tells one algorithm from another: what its critic sees, and the loss that says so."""

    critic: type[nn.Module]
    loss: type[MAPPOLoss]


ALGORITHMS: dict[AlgorithmName, Algorithm] = {
    "mappo": Algorithm(TeamCritic, MAPPOLoss),
    "ippo": Algorithm(LocalCritic, IPPOLoss),
}


def observation_keys(layout: ObservationLayout) -> Keys:
    """Return the keys of what an agent observes, in the order that the networks take it."""
    if layout.num_features:
        return [("agents", "observation", "image"), ("agents", "observation", "features")]
    return [("agents", "observation")]


def make_network(layout: ObservationLayout, config: ModelConfig) -> Actor:
    """Return the actor's network, with fresh weights."""
    return Actor(layout.image_shape, layout.num_features, layout.num_actions, config)


def make_actor(network: nn.Module, layout: ObservationLayout) -> ProbabilisticActor:
    """Return the policy that draws each agent's action from the network's logits."""
    logits = TensorDictModule(network, in_keys=observation_keys(layout), out_keys=[("agents", "logits")])
    return ProbabilisticActor(
        logits,
        in_keys=[("agents", "logits")],
        out_keys=[("agents", "action")],
        distribution_class=Categorical,
        return_log_prob=True,
    )


def make_loss(actor: ProbabilisticActor, layout: ObservationLayout, config: TrainConfig) -> MAPPOLoss:
    """Return the loss of `config.algorithm`, its critic and its advantage estimator included.

    Truncated episodes are bootstrapped with the value of their last observation, terminated ones are not.
    """
    algorithm, ppo = ALGORITHMS[config.algorithm], config.ppo
    network = algorithm.critic(layout.image_shape, layout.num_features, config.model)
    critic = TensorDictModule(network, in_keys=observation_keys(layout), out_keys=[("agents", "state_value")])
    loss = algorithm.loss(
        actor,
        critic,
        clip_epsilon=ppo.clip_epsilon,
        entropy_coeff=ppo.entropy_coeff,
        critic_coeff=ppo.critic_coeff,
        normalize_advantage=True,
    )
    loss.set_keys(
        value=("agents", "state_value"),
        action=("agents", "action"),
        reward=("agents", "reward"),
        sample_log_prob=("agents", "action_log_prob"),
    )
    loss.make_value_estimator(ValueEstimators.MAGAE, gamma=ppo.gamma, lmbda=ppo.lmbda)
    return loss
