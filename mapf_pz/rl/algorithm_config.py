"""The configurations of optimization and of the algorithms, parts of a `TrainConfig`. Does not import torch."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal

from tyro.conf import arg

from mapf_pz.rl.checks import check_counts, check_from_zero, check_names, check_positive

Credit = Literal["team", "agent"]
CuriosityName = Literal["none", "rnd", "random-features", "inverse-dynamics"]
ObservationPrecision = Literal["float32", "float16"]


@dataclass(frozen=True)
class OptimizationConfig:
    """The sizes of batches and the optimizer, for all algorithms."""

    num_envs: int = 64
    """Number of environments that are stepped as one batch."""
    steps_per_batch: int = 32
    """Number of steps of each environment between two updates."""
    num_epochs: int = 4
    """Number of passes over each batch."""
    minibatch_size: int = 256
    """Number of environment steps, each of all agents, per gradient step."""
    learning_rate: float = 7e-4
    """Initial learning rate of Adam; it decays linearly to a tenth."""
    max_grad_norm: float = 0.5
    """Maximum norm of the gradients; larger gradients are scaled down to it."""

    def __post_init__(self) -> None:
        """Check numbers."""
        check_counts(self, 1, "num_envs", "steps_per_batch", "num_epochs", "minibatch_size")
        check_positive(self, math.inf, "learning_rate", "max_grad_norm")


@dataclass(frozen=True)
class PPOConfig:
    """Proximal policy optimization (Schulman et al., 2017), for many agents (Yu et al., 2022)."""

    gamma: float = 0.98
    """Discount factor of the return."""
    lmbda: float = 0.95
    """Lambda of generalized advantage estimation."""
    clip_epsilon: float = 0.2
    """Clipping range of the probability ratio: the ratio is clipped to 1 plus or minus this value."""
    entropy_coeff: float = 0.01
    """Initial weight of the entropy bonus; it decays linearly to a tenth."""
    critic_coeff: float = 0.5
    """Weight of the value loss."""
    credit: Credit = "agent"
    """Advantages of `central-ppo`: one for the whole `team`, or one per `agent`, as in the other algorithms."""
    warmup_updates: int = 0
    """Number of updates at the beginning in which only the critic learns, for a run with an `initial_policy`."""
    kl_coeff: float = 0.0
    """Weight of the reward's penalty for actions that are more likely than under the `initial_policy`: in expectation,
    the Kullback-Leibler divergence from it (Ziegler et al., 2019)."""

    def __post_init__(self) -> None:
        """Check names and numbers."""
        check_names(self)
        check_counts(self, 0, "warmup_updates")
        check_positive(self, math.inf, "clip_epsilon")
        check_from_zero(self, 1, "gamma", "lmbda")
        check_from_zero(self, math.inf, "entropy_coeff", "critic_coeff", "kl_coeff")


@dataclass(frozen=True)
class CuriosityConfig:
    """An intrinsic reward for prediction errors, added to the task's reward; its encoders are like the policy's."""

    kind: Annotated[CuriosityName, arg(name="curiosity")] = "none"
    """Curiosity reward. `rnd`: error in predicting a random network's embedding of the next observation;
    `random-features`, `inverse-dynamics`: error in predicting the effect of an action on the embedding."""
    weight: Annotated[float, arg(name="curiosity-weight")] = 0.1
    """Weight of the curiosity reward, which is normalized to about 0.03 per step (the task's reward: about 0.1).
    Curiosity should dominate only where the task's reward is 0."""
    gamma: Annotated[float, arg(name="curiosity-gamma")] = 0.99
    """Discount factor of the curiosity return used for normalization."""
    size: Annotated[int, arg(name="curiosity-size")] = 64
    """Size of the embedding that is predicted for curiosity."""
    learning_rate: Annotated[float, arg(name="curiosity-learning-rate")] = 1e-4
    """Initial learning rate of the curiosity networks; it decays linearly to a tenth."""
    update_fraction: Annotated[float, arg(name="curiosity-update-fraction")] = 0.25
    """Fraction of each minibatch that the curiosity networks are trained on."""

    def __post_init__(self) -> None:
        """Check names and numbers."""
        check_names(self)
        check_counts(self, 1, "size")
        check_positive(self, math.inf, "learning_rate")
        check_positive(self, 1, "update_fraction")
        check_from_zero(self, 1, "gamma")
        check_from_zero(self, math.inf, "weight")


@dataclass(frozen=True)
class ImitationConfig:
    """Imitation of a planner, the expert: by its labels (`dagger`) or from its demonstrations (`bc`)."""

    expert: str = "windowed"
    """The planner that `dagger` imitates, with options such as `epibt:depth=3`."""
    expert_share: float = 0.1
    """Probability that the expert instead of the policy controls an environment in a segment."""
    segment_steps: int = 16
    """Number of steps of a segment."""
    temperature: float = 1.0
    """Temperature of the sampling of actions while data is collected; 0 takes the most likely action."""
    wait_share: float = 0.2
    """Fraction of the expert's waits at goals that are learned from."""
    buffer_size: int = 400_000
    """Number of agent steps in the replay buffer, which replaces the oldest ones."""
    dataset: str | None = None
    """The folder of demonstrations that `bc` learns from; other algorithms ignore it."""

    def __post_init__(self) -> None:
        """Check numbers."""
        check_from_zero(self, 1, "expert_share", "wait_share")
        check_from_zero(self, math.inf, "temperature")
        check_counts(self, 1, "segment_steps", "buffer_size")
