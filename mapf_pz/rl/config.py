"""The configuration of a training run: frozen dataclasses, the one home of every default. Needs no torch."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal, get_args

from pydantic import ConfigDict, PlainSerializer, PlainValidator
from tyro.conf import arg

from mapf_pz.action_modes import ActionMode
from mapf_pz.config import DEFAULT_NUM_AGENTS, REWARDS, EnvConfig
from mapf_pz.instance import InstanceSource
from mapf_pz.instances.configured import goals_per_agent, make_source
from mapf_pz.instances.mixture import MapMixture
from mapf_pz.rl.checks import check_counts, check_from_zero, check_names, check_part, check_positive
from mapf_pz.rl.saved_env import dump_env, load_env

AlgorithmName = Literal["mappo", "ippo", "central-ppo"]
CollectorName = Literal["single", "processes", "ray"]
Credit = Literal["team", "agent"]
CuriosityName = Literal["none", "rnd", "random-features", "inverse-dynamics"]
DeviceName = Literal["auto", "cpu", "cuda"]
EncoderName = Literal["conv", "report", "residual"]

TRAINING_ENV = EnvConfig(
    num_agents=8,
    max_steps=96,
    view_size=(7, 7),
    view="centered",
    channels=("view", "cost_to_go", "orientation", "others_next", "others_at_goal"),
    features=("action_advantage", "last_actions"),
    num_last_actions=2,
    reward=REWARDS["progress"],
)
"""The environment that a task has by default."""

OBSERVATION_FIELDS = (
    "action_model",
    "view_size",
    "view",
    "frame",
    "see_through_walls",
    "channels",
    "features",
    "num_last_actions",
    "edge_weights",
)
"""The keywords of the environment that decide what a policy observes and does."""


@dataclass(frozen=True)
class TaskConfig:
    """What the agents train on: an environment, and what is not part of one."""

    env: Annotated[EnvConfig, PlainValidator(load_env), PlainSerializer(dump_env)] = TRAINING_ENV
    """The environment. If it has no map, scenario or source, episodes take place on the maps of `mixture`."""
    mixture: MapMixture = field(default_factory=MapMixture)
    """The maps to train on, if the environment has no map, scenario or source."""
    num_frames: int = 1
    """Number of latest observations that each agent sees, stacked; 1 is the current one only."""
    neighbors: int = 0
    """Number of nearest other agents whose observations each agent sees after its own."""
    neighbor_radius: int = 8
    """Maximum distance to such a neighbor, in rows and in columns."""
    action_mode: ActionMode = "argmax"
    """How the action matrix of `central-ppo` is turned into actions."""

    def __post_init__(self) -> None:
        """Check names and numbers; what depends on the map is checked when the environment is created."""
        check_names(self)
        check_counts(self, 1, "num_frames")
        check_counts(self, 0, "neighbors", "neighbor_radius")

    @cached_property
    def source(self) -> InstanceSource:
        """Where episodes come from; reads the files of the map or the scenario on first use."""
        env = self.env
        if (env.map, env.scenario, env.source) != (None, None, None):
            return make_source(env)
        return self.mixture.source(env.num_agents or DEFAULT_NUM_AGENTS, goals_per_agent(env))

    @property
    def num_agents(self) -> int:
        """N; reads the scenario's file if that alone determines it."""
        return self.env.num_agents or self.source.num_agents

    def env_config(self) -> EnvConfig:
        """Return the environment to train in: `env`, whose episodes come from `source`."""
        return replace(self.env, map=None, scenario=None, source=self.source)

    def env_keywords(self) -> dict[str, Any]:
        """Return the keywords of the environment to train in."""
        return self.env_config().keywords()

    def observation_keywords(self) -> dict[str, Any]:
        """Return the keywords that any environment needs for a policy of this task to act in it."""
        return {name: getattr(self.env, name) for name in OBSERVATION_FIELDS}

    def env_wrappers(self) -> tuple[tuple[str, dict[str, int]], ...]:
        """Return the names and keywords of the wrappers that it needs besides, innermost first."""
        wrappers: list[tuple[str, dict[str, int]]] = []
        if self.neighbors:
            wrappers.append(("NeighborObservations", {"neighbors": self.neighbors, "radius": self.neighbor_radius}))
        if self.num_frames > 1:
            wrappers.append(("FrameStack", {"num_frames": self.num_frames}))
        return tuple(wrappers)


@dataclass(frozen=True)
class ModelConfig:
    """The networks: an encoder of one agent's observation, and heads on it."""

    encoder: str = "conv"
    """`conv`: 3 x 3 convolutions; `report`: the report's two; `residual`: stages of residual blocks; or
    `package.module:Class`, an `nn.Module` that is built and called as `Encoder`."""
    conv_channels: tuple[int, ...] = (16,)
    """Output channels of the convolutions, or of the stages of `residual`; `report` needs two, there (32, 64)."""
    num_blocks: int = 2
    """Residual blocks in each stage of `residual`."""
    hidden: int = 128
    """Numbers in an observation's code."""
    recurrent: int = 0
    """Numbers that an agent remembers from step to step (a GRU's state); 0: no memory. Critics have none."""
    head: tuple[int, ...] = (128,)
    """Widths of the hidden layers from the code to the actions, and to the value."""

    def __post_init__(self) -> None:
        """Check names and numbers."""
        check_part("encoder", self.encoder, get_args(EncoderName))
        check_counts(self, 1, "conv_channels", "hidden", "head")
        check_counts(self, 0, "num_blocks", "recurrent")


@dataclass(frozen=True)
class PPOConfig:
    """Proximal policy optimization (Schulman et al., 2017), for many agents (Yu et al., 2022)."""

    num_envs: int = 64
    """B, environments stepped together."""
    steps_per_batch: int = 32
    """Steps of each environment between two updates."""
    num_epochs: int = 4
    """Passes over each batch."""
    minibatch_size: int = 256
    """Environment steps (of all N agents) per gradient step."""
    learning_rate: float = 7e-4
    """Adam's step size, lowered linearly to a tenth."""
    gamma: float = 0.98
    """Discount."""
    lmbda: float = 0.95
    """Decay of generalized advantage estimation."""
    clip_epsilon: float = 0.2
    """Bound on the change of an action's probability ratio."""
    entropy_coeff: float = 0.01
    """Weight of the entropy bonus, lowered linearly to a tenth."""
    critic_coeff: float = 0.5
    """Weight of the value loss."""
    max_grad_norm: float = 0.5
    """Gradients are scaled down to this norm."""
    credit: Credit = "agent"
    """Of `central-ppo`: one advantage for the `team`, or one for each `agent`; the other algorithms have the latter."""

    def __post_init__(self) -> None:
        """Check names and numbers."""
        check_names(self)
        check_counts(self, 1, "num_envs", "steps_per_batch", "num_epochs", "minibatch_size")
        check_positive(self, math.inf, "learning_rate", "clip_epsilon", "max_grad_norm")
        check_from_zero(self, 1, "gamma", "lmbda")
        check_from_zero(self, math.inf, "entropy_coeff", "critic_coeff")


@dataclass(frozen=True)
class CuriosityConfig:
    """A reward for what an agent could not predict, beside the task's own; its encoders are as the policy's."""

    kind: Annotated[CuriosityName, arg(name="curiosity")] = "none"
    """`rnd`: of the next observation; `random-features`, `inverse-dynamics`: of what an action does to it."""
    weight: Annotated[float, arg(name="curiosity-weight")] = 0.1
    """Of that reward. Scaled, it is about 0.03 a step, the task's about 0.1: it should decide only where that is 0."""
    gamma: Annotated[float, arg(name="curiosity-gamma")] = 0.99
    """Discount of those sums."""
    size: Annotated[int, arg(name="curiosity-size")] = 64
    """Numbers that an observation becomes, to be predicted."""
    learning_rate: Annotated[float, arg(name="curiosity-learning-rate")] = 1e-4
    """Adam's step size, lowered as the policy's."""
    update_fraction: Annotated[float, arg(name="curiosity-update-fraction")] = 0.25
    """Share of each minibatch that the predictor learns from."""

    def __post_init__(self) -> None:
        """Check names and numbers."""
        check_names(self)
        check_counts(self, 1, "size")
        check_positive(self, math.inf, "learning_rate")
        check_positive(self, 1, "update_fraction")
        check_from_zero(self, 1, "gamma")
        check_from_zero(self, math.inf, "weight")


@dataclass(frozen=True)
class TrainConfig:
    """One training run."""

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="forbid")  # also of the configurations inside
    task: TaskConfig = field(default_factory=TaskConfig)
    """What is learnt."""
    algorithm: str = "mappo"
    """`mappo`: the critic observes the team; `ippo`: the critic observes what the agent observes; `central-ppo`: the
    report's; or `package.module:Class`, a subclass of `Algorithm`."""
    model: ModelConfig = field(default_factory=ModelConfig)
    """The networks."""
    ppo: PPOConfig = field(default_factory=PPOConfig)
    """The optimization."""
    curiosity: CuriosityConfig = field(default_factory=CuriosityConfig)
    """What agents earn for being surprised."""
    agent_steps: int = 2_000_000
    """Minimum length of the run, in steps of all agents together; the run takes whole updates."""
    seed: int = 0
    """Decides instances, initial weights and exploration."""
    checkpoint_interval: int = 200_000
    """Agent steps between two checkpoints; an interrupted or finished run writes one too."""
    validation_interval: int = 0
    """Agent steps between two looks at how the policy does on instances that it is not trained on; 0: none."""
    validation_episodes: int = 64
    """Episodes of each look, the same every time."""
    collector: CollectorName = "single"
    """Where environments are stepped: in this process, in `num_workers` processes, or in as many Ray actors."""
    num_workers: int = 2
    """How many processes or actors share the environments; not used by the collector `single`."""
    device: DeviceName = "auto"
    """Where the networks compute; `auto`: on a GPU if there is one. Environments are always stepped on the CPU."""
    num_threads: int = 1
    """Threads of torch and of the kernels, in each process. More help only where as many cores are idle."""

    def __post_init__(self) -> None:
        """Check names and numbers, and that the workers can share the environments evenly."""
        check_names(self)
        check_part("algorithm", self.algorithm, get_args(AlgorithmName))
        check_counts(self, 1, "agent_steps", "checkpoint_interval", "validation_episodes", "num_workers", "num_threads")
        check_counts(self, 0, "seed", "validation_interval")
        if self.collector != "single" and self.ppo.num_envs % self.num_workers:
            raise ValueError(f"num_envs={self.ppo.num_envs}: expected a multiple of num_workers={self.num_workers}")

    @property
    def steps_per_update(self) -> int:
        """Steps of all agents together between two updates."""
        return self.ppo.num_envs * self.ppo.steps_per_batch * self.task.num_agents

    @property
    def num_updates(self) -> int:
        """Updates of the run: as many as `agent_steps` needs, the last one in full."""
        return math.ceil(self.agent_steps / self.steps_per_update)
