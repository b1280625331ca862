"""The configuration of a training run: frozen dataclasses that hold every default. Does not import torch."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any, Literal, get_args

from pydantic import Field
from tyro.conf import arg

from mapf_pz._internal.config import (
    Coefficient,
    Count,
    Items,
    Natural,
    Positive,
    Share,
    checked,
    expecting,
    name_or_part,
)
from mapf_pz.guidance.library import random_share
from mapf_pz.instances.instance import InstanceSource
from mapf_pz.instances.mixture import MapMixture
from mapf_pz.simulator.actions import ActionMode
from mapf_pz.simulator.config import OBSERVATION_FIELDS, EnvConfig
from mapf_pz.simulator.recommended import RECOMMENDED
from mapf_pz.simulator.saved_config import SavedEnv
from mapf_pz.simulator.seeds import FIRST_EVALUATION_SEED
from mapf_pz.simulator.source import make_source

AlgorithmName = Literal["mappo", "ippo", "central-ppo", "dagger", "bc"]
EncoderName = Literal["conv", "report", "residual"]
CollectorName = Literal["single", "processes", "ray"]
LoggerName = Literal["tensorboard", "wandb", "mlflow"]
DeviceName = Literal["auto", "cpu", "cuda"]
PrecisionName = Literal["float32", "bfloat16", "auto"]
Credit = Literal["team", "agent"]
CuriosityName = Literal["none", "rnd", "random-features", "inverse-dynamics", "disagreement"]
Activation = Literal["relu", "gelu", "tanh"]
ObservationPrecision = Literal["float32", "float16"]
TRAINING_ENV = EnvConfig(num_agents=8, max_steps=96, **RECOMMENDED)
"""The default environment of a training task."""
POLICY_FIELDS = ("action_model", *OBSERVATION_FIELDS, "edge_weights")
"""The environment's keywords that determine a policy's observations and actions."""


@checked
@dataclass(frozen=True)
class OptimizationConfig:
    """The sizes of batches and the optimizer, for all algorithms."""

    num_envs: Count = 64
    """Number of environments that are stepped as one batch."""
    steps_per_batch: Count = 32
    """Number of steps of each environment between two updates."""
    num_epochs: Count = 4
    """Number of passes over each batch."""
    minibatch_size: Count = 256
    """Number of environment steps, each of all agents, per gradient step."""
    learning_rate: Positive = 7e-4
    """Initial learning rate of Adam; it decays linearly."""
    final_learning_rate: Share = 0.1
    """Learning rate at the end of the run as a fraction of the initial one; 1: it is constant."""
    max_grad_norm: Positive = 0.5
    """Maximum norm of the gradients; larger gradients are scaled down to it."""


@checked
@dataclass(frozen=True)
class PPOConfig:
    """Proximal policy optimization (Schulman et al., 2017), for many agents (Yu et al., 2022)."""

    gamma: Share = 0.98
    """Discount factor of the return."""
    lmbda: Share = 0.95
    """Lambda of generalized advantage estimation."""
    clip_epsilon: Positive = 0.2
    """Clipping range of the probability ratio: the ratio is clipped to 1 plus or minus this value."""
    entropy_coeff: Coefficient = 0.01
    """Initial weight of the entropy bonus; it decays like the learning rate."""
    critic_coeff: Coefficient = 0.5
    """Weight of the value loss."""
    credit: Credit = "agent"
    """Advantages of `central-ppo`: one for the whole `team`, or one per `agent`, as in the other algorithms."""
    warmup_updates: Natural = 0
    """Number of updates at the beginning in which only the critic learns, for a run with an `initial_policy`."""
    kl_coeff: Coefficient = 0.0
    """Weight of the reward's penalty for actions that are more likely than under the `initial_policy`: in expectation,
    the Kullback-Leibler divergence from it (Ziegler et al., 2019)."""


@checked
@dataclass(frozen=True)
class CuriosityConfig:
    """An intrinsic reward for what cannot be predicted yet, added to the task's; its encoders are like the policy's."""

    kind: Annotated[CuriosityName, arg(name="curiosity")] = "none"
    """Curiosity reward. `rnd`: error in predicting a random network's embedding of the next observation;
    `random-features`, `inverse-dynamics`: error in predicting the effect of an action on the embedding; `disagreement`:
    variance of five such predictions."""
    weight: Annotated[Coefficient, arg(name="curiosity-weight")] = 0.1
    """Weight of the curiosity reward, which is normalized to about 0.03 per step (the task's reward: about 0.1).
    Curiosity should dominate only where the task's reward is 0."""
    gamma: Annotated[Share, arg(name="curiosity-gamma")] = 0.99
    """Discount factor of the curiosity return used for normalization."""
    size: Annotated[Count, arg(name="curiosity-size")] = 64
    """Size of the embedding that is predicted for curiosity."""
    learning_rate: Annotated[Positive, arg(name="curiosity-learning-rate")] = 1e-4
    """Initial learning rate of the curiosity networks; it decays like that of the policy."""
    update_fraction: Annotated[Share, Field(gt=0), arg(name="curiosity-update-fraction")] = 0.25
    """Fraction of each minibatch that the curiosity networks are trained on."""


@checked
@dataclass(frozen=True)
class ImitationConfig:
    """Imitation of a planner, the expert: by its labels (`dagger`) or from its demonstrations (`bc`)."""

    expert: str = "windowed"
    """The planner that `dagger` imitates, with options such as `epibt:depth=3`."""
    expert_share: Share = 0.1
    """Probability that the expert instead of the policy controls an environment in a segment."""
    segment_steps: Count = 16
    """Number of steps of a segment."""
    temperature: Coefficient = 1.0
    """Temperature of the sampling of actions while data is collected; 0 takes the most likely action."""
    wait_share: Share = 0.2
    """Fraction of the expert's waits at goals that are learned from."""
    augment: bool = False
    """Whether states are turned and mirrored at random each time they are learned from (data augmentation); egocentric
    views are only mirrored. It needs a view of odd width, and users' channels and features that state their `symmetry`.
    """
    history_dropout: Share = 0.0
    """Fraction of the observations that are learned from with waits in place of the last actions, so that the policy
    does not learn that waits follow waits, as they do in plans (cf. past motion dropout: Bansal et al., 2018)."""
    replay: Literal["observations", "states"] = "observations"
    """What `dagger` keeps in its replay buffer: observations, or states, in which agents observe again when they are
    learned from. States need much less memory, and a run that is resumed still has them."""
    buffer_size: Count = 400_000
    """Number of agent steps in the replay buffer, which replaces the oldest ones."""
    recent_size: Count = 400_000
    """With states, number of the latest agent steps from which half of each minibatch is sampled; the other half is
    sampled from the whole buffer."""
    dataset: str | None = None
    """The folder that is learned from: with `bc`, demonstrations; with `dagger`, a run with `replay="states"`, whose
    labeled states are in the buffer from the start. Other algorithms ignore it."""


@checked
@dataclass(frozen=True)
class TaskConfig:
    """The training task: an environment, its maps, and how the policy observes and acts."""

    env: SavedEnv = TRAINING_ENV
    """The training environment. If it has no map, scenario or source, its episodes use the maps of `mixture`."""
    mixture: MapMixture = field(default_factory=MapMixture)
    """The training maps, used if the environment has no map, scenario or source."""
    action_mode: ActionMode = "argmax"
    """How the action matrix of `central-ppo` is converted to actions."""
    shield: bool = False
    """Whether the safety layer (`mapf_pz.planners.Shield`) executes the policy's actions during training: an agent that
    cannot take its first choice takes the next one. Not available for `central-ppo`."""

    @cached_property
    def source(self) -> InstanceSource:
        """The source of episodes; the files of the map or the scenario are read on first use."""
        return make_source(self.env, self.mixture.source)

    @property
    def num_agents(self) -> int:
        """N, the number of agents; reads the scenario's file if nothing else determines it."""
        return self.env.num_agents or self.source.num_agents

    def env_config(self) -> EnvConfig:
        """Return the configuration of the training environment: `env` with the episodes of `source`."""
        return replace(self.env, map=None, scenario=None, source=self.source)

    def env_keywords(self) -> dict[str, Any]:
        """Return the keywords of the training environment."""
        return self.env_config().keywords()

    def observation_keywords(self) -> dict[str, Any]:
        """Return the keywords that an environment needs so that a policy of this task can act in it.

        Random edge weights vary the episodes of training: the environment has uniform ones.
        """
        keywords = {name: getattr(self.env, name) for name in POLICY_FIELDS}
        return keywords | ({"edge_weights": "uniform"} if random_share(self.env.edge_weights) else {})


@checked
@dataclass(frozen=True)
class ModelConfig:
    """The networks: an encoder of observations, followed by a policy head or a value head."""

    encoder: Annotated[str, name_or_part(get_args(EncoderName))] = "conv"
    """Encoder of observations: `conv` (3 x 3 convolutions), `report` (the report's two convolutions), `residual`
    (stages of residual blocks), or `package.module:Class`, an `nn.Module` with the interface of `Encoder`."""
    conv_channels: Items[Count] = (16,)
    """Output channels of each convolution, or of each stage of `residual`; `report` has two (in the report: 32, 64)."""
    num_blocks: Natural = 2
    """Number of residual blocks in each stage of the encoder `residual`."""
    hidden: Count = 128
    """Size of the embedding of an observation."""
    recurrent: Natural = 0
    """Size of the hidden state of the policy's GRU; 0 disables recurrence. Critics are not recurrent."""
    head: Items[Count] = (128,)
    """Widths of the hidden layers of the policy head and the value head."""
    activation: Activation = "relu"
    """Activation function of these layers; encoders have ReLU."""
    communication: Natural = 0
    """Number of rounds of attention in which agents exchange embeddings; 0 disables communication. It requires the
    feature `pose`. With communication, `central-ppo` acts for any number of agents, also different from training."""
    communication_radius: Natural | None = None
    """Maximum distance of agents that exchange embeddings, in rows and in columns; None: all agents do."""
    decision_rounds: Count = 1
    """Number of rounds in which agents sample their actions: in each, those that are most certain decide, and the
    others then observe their decisions. With 1, all decide at the same time; more require `communication` and imitation
    (`dagger`)."""
    mask_actions: bool = False
    """Whether agents sample only actions that their action mask allows (Huang and Ontañón, 2022); not available for
    `central-ppo`, whose action is a matrix of real numbers."""


@checked
@dataclass(frozen=True)
class TrackingConfig:
    """How Weights & Biases and MLflow show a run; `tensorboard` ignores it."""

    project: str | None = None
    """Project of Weights & Biases, or experiment of MLflow. None: that of their environment variables
    (`WANDB_PROJECT`, `MLFLOW_EXPERIMENT_NAME`)."""
    group: str | None = None
    """Group of the run: a group of Weights & Biases, a tag of MLflow."""
    run_name: str | None = None
    """Name of the run. None: the name of its folder."""
    tags: Items[str] = ()
    """Tags of the run."""


@checked
@dataclass(frozen=True)
class TrainConfig:
    """One training run."""

    task: TaskConfig = field(default_factory=TaskConfig)
    """The training task."""
    algorithm: Annotated[str, name_or_part(get_args(AlgorithmName))] = "mappo"
    """Training algorithm: `mappo` (the critic observes the team), `ippo` (the critic observes what the agent observes),
    `central-ppo` (the report's single policy for all agents), `dagger` (imitation of a planner), `bc` (behavior cloning
    from demonstrations), or `package.module:Class`, a subclass of `Algorithm`."""
    model: ModelConfig = field(default_factory=ModelConfig)
    """Configuration of the networks."""
    optimization: OptimizationConfig = field(default_factory=OptimizationConfig)
    """Sizes of batches and configuration of the optimizer."""
    ppo: PPOConfig = field(default_factory=PPOConfig)
    """Configuration of the algorithms `mappo`, `ippo` and `central-ppo`."""
    curiosity: CuriosityConfig = field(default_factory=CuriosityConfig)
    """Configuration of the curiosity reward."""
    imitation: ImitationConfig = field(default_factory=ImitationConfig)
    """Configuration of the algorithms `dagger` and `bc`."""
    initial_policy: str | None = None
    """A trained policy to start from, the name of a bundled one or the folder of a run, with the same observations and
    the same networks. None: newly initialized networks."""
    initial_temperature: Annotated[Positive, arg(name="initial-temperature")] = 1.0
    """Number that the logits of `initial_policy` are divided by, so that it explores less if it is below 1."""
    agent_steps: Count = 2_000_000
    """Minimum length of the run in agent steps (the steps of all agents together); the last update is completed."""
    seed: Natural = 0
    """Random seed of the instances, the initial weights and exploration. Environment k starts with the seed `seed + k`,
    which must be below 1,000,000, where the seeds of evaluations start."""
    checkpoint_interval: Count = 200_000
    """Agent steps between checkpoints; a run also writes one when it finishes or is interrupted."""
    validation_interval: Natural = 0
    """Agent steps between validations on held-out instances; 0 disables validation."""
    validation_episodes: Count = 64
    """Number of episodes in each validation; their instances are always the same."""
    collector: CollectorName = "single"
    """Where environments are stepped: `single` (in the training process), `processes` (in `num_workers` processes), or
    `ray` (in `num_workers` Ray actors)."""
    num_workers: Count = 2
    """Number of processes or Ray actors that share the environments; ignored by the collector `single`."""
    device: DeviceName = "auto"
    """Device of the networks; `auto` uses a GPU if one is available. Environments are always stepped on the CPU."""
    precision: PrecisionName = "float32"
    """Precision of the networks' products during learning. `bfloat16` (mixed precision) is about 1.6 times as fast on
    CPUs with AVX512-BF16 or AMX; weights and sums remain in float32, and so does acting. `auto` selects it there and on
    GPUs that support it."""
    num_threads: Count = 1
    """Number of threads of torch, of the kernels and of the planners that label states, in each process; more than 1
    helps only on idle cores."""
    num_learners: Annotated[Count | Literal["auto"], expecting("a whole number, 1 or more, or 'auto'")] = 1
    """Number of processes that train together: they divide the environments and each minibatch among themselves, and
    average their gradients, so that an update uses the same number of samples. `auto`: as many as there are GPUs or
    cores, if the batch can be divided among them. Under `torchrun`, the number of its processes is used instead."""
    observation_precision: ObservationPrecision = "float32"
    """Precision in which observations are stored and sent to the networks' device, where they are converted to float32.
    `float16` rounds them to 11 significant bits, and halves the memory of batches and of the replay buffer."""
    compile: bool = False
    """Whether learning compiles the loss, or for imitation the network, with `torch.compile`; needs a C++ compiler."""
    overlap: bool = False
    """Whether the workers collect the next batch during an update, with the policy from before that update; requires
    the collector `processes` or `ray`."""
    loggers: Items[LoggerName] = ("tensorboard",)
    """Where progress is logged in addition to `progress.csv`: `tensorboard` (files in the run's folder), `wandb`
    (Weights & Biases) or `mlflow`, which their environment variables configure, too, such as `WANDB_MODE` and
    `MLFLOW_TRACKING_URI`."""
    tracking: TrackingConfig = field(default_factory=TrackingConfig)
    """How Weights & Biases and MLflow show the run."""

    def __post_init__(self) -> None:
        """Check fields that depend on each other, and that the environments divide evenly among the workers."""
        if self.seed + self.optimization.num_envs > FIRST_EVALUATION_SEED:
            most = FIRST_EVALUATION_SEED - self.optimization.num_envs
            raise ValueError(f"seed={self.seed}: expected at most {most}, since evaluations use the following seeds")
        if self.ppo.kl_coeff and (
            self.initial_policy is None or self.model.recurrent or self.algorithm == "central-ppo"
        ):
            expected = "0 without an initial_policy, with recurrent networks and with central-ppo"
            raise ValueError(f"kl_coeff={self.ppo.kl_coeff}: expected {expected}")
        if self.algorithm == "dagger" and self.imitation.dataset is not None and self.imitation.replay != "states":
            raise ValueError(f"dataset={self.imitation.dataset!r}: expected replay='states' with dagger")
        if self.overlap and self.collector == "single":
            raise ValueError("overlap=True: expected the collector 'processes' or 'ray'")
        obstacle = self._obstacle_to_sharing(1 if self.num_learners == "auto" else self.num_learners)
        if obstacle is not None:
            raise ValueError(obstacle)

    def _obstacle_to_sharing(self, num_learners: int) -> str | None:
        """Return why a batch and its minibatches cannot be divided among learners and their workers, or None."""
        parts = self.optimization
        for name, number in (("num_envs", parts.num_envs), ("minibatch_size", parts.minibatch_size)):
            if number % num_learners:
                return f"{name}={number}: expected a multiple of num_learners={num_learners}"
        if self.validation_episodes < num_learners:
            return f"validation_episodes={self.validation_episodes}: expected num_learners={num_learners} or more"
        if self.collector != "single" and parts.num_envs // num_learners % self.num_workers:
            each = f" for each of {num_learners} learners" if num_learners > 1 else ""
            return f"num_envs={parts.num_envs}: expected a multiple of num_workers={self.num_workers}{each}"
        return None

    @property
    def steps_per_update(self) -> int:
        """Number of agent steps between two updates."""
        return self.optimization.num_envs * self.optimization.steps_per_batch * self.task.num_agents

    @property
    def num_updates(self) -> int:
        """Number of updates of the run: `agent_steps` divided by the steps per update, rounded up."""
        return math.ceil(self.agent_steps / self.steps_per_update)

    def with_learners(self, most: int) -> TrainConfig:
        """Return the configuration with the largest number of learners, at most `most`, that can divide a batch."""
        divisors = (number for number in range(most, 0, -1) if self._obstacle_to_sharing(number) is None)
        return replace(self, num_learners=next(divisors))

    def share(self, num_learners: int) -> TrainConfig:
        """Return the configuration of one of `num_learners` learners; the number of updates stays the same."""
        if num_learners == 1:
            return self
        optimization, imitation = self.optimization, self.imitation
        share = replace(
            self,
            optimization=replace(
                optimization,
                num_envs=optimization.num_envs // num_learners,
                minibatch_size=optimization.minibatch_size // num_learners,
            ),
            imitation=replace(imitation, buffer_size=-(-imitation.buffer_size // num_learners)),
            num_learners=1,
        )
        return replace(share, agent_steps=self.num_updates * share.steps_per_update)
