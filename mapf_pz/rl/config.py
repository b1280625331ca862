"""The configuration of a training run: frozen dataclasses, the one home of every default. Needs no torch."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, cast, get_args

from pydantic import PlainSerializer, PlainValidator, ValidationInfo
from tyro.conf import arg

from mapf_pz.action_modes import ActionMode
from mapf_pz.config import REWARDS, ActionModel, Frame, RewardConfig, View, WeightsName
from mapf_pz.guidance import GuidanceGraph
from mapf_pz.instances.sources import RandomObstacles
from mapf_pz.rl.checks import check_counts, check_from_zero, check_names, check_positive

AlgorithmName = Literal["mappo", "ippo", "central-ppo"]
CollectorName = Literal["single", "processes", "ray"]
Credit = Literal["team", "agent"]
CuriosityName = Literal["none", "rnd", "random-features", "inverse-dynamics"]
DeviceName = Literal["auto", "cpu", "cuda"]
EncoderName = Literal["conv", "report", "residual"]

GRAPH = "edge_weights.safetensors"
"""The file of a task's own guidance graph, in the run's folder: its arrays `move` and `wait`."""


def _stored_weights(weights: WeightsName | GuidanceGraph) -> str:
    """Return what the configuration's file says of the weights: their name, or that of the graph's file."""
    return GRAPH if isinstance(weights, GuidanceGraph) else weights


def _loaded_weights(stored: Any, info: ValidationInfo) -> Any:
    """Return the weights; `info.context` reads the graph's file."""
    if stored == GRAPH and info.context is not None:
        return info.context()
    if stored not in get_args(WeightsName):
        raise ValueError(f"expected one of {', '.join(map(repr, (*get_args(WeightsName), GRAPH)))}")
    return stored


EdgeWeights = Annotated[
    WeightsName | GuidanceGraph,
    PlainValidator(_loaded_weights),
    PlainSerializer(_stored_weights),
    arg(constructor=cast("Any", WeightsName), help_behavior_hint="(default: uniform)"),  # names alone can be typed
]

OBSERVATION_FIELDS = (
    "action_model",
    "view_size",
    "view",
    "frame",
    "channels",
    "features",
    "num_last_actions",
    "edge_weights",
)
"""The keywords of the environment that decide what a policy observes and does."""


@dataclass(frozen=True)
class TaskConfig:
    """What the agents train on, and what they observe and earn."""

    map: str | None = None
    """A map's name or the path of a `.map` file; None draws a new random map for every episode."""
    height: int = 12
    """Rows of a random map."""
    width: int = 12
    """Columns of a random map."""
    density: float = 0.15
    """Share of obstacles on a random map."""
    num_agents: int = 8
    """N, the number of agents."""
    max_steps: int = 96
    """An episode is truncated after this many steps."""
    action_model: ActionModel = "rotate"
    """`rotate` or `cardinal`."""
    view_size: tuple[int, int] = (7, 7)
    """(h, w) of each agent's view."""
    view: View | None = "centered"
    """`front` or `centered`."""
    frame: Frame | None = None
    """`egocentric` or `map`; None: as the action model has it."""
    channels: tuple[str, ...] = ("view", "cost_to_go", "orientation", "others_next", "others_at_goal")
    """The channels of the image."""
    features: tuple[str, ...] = ("action_advantage", "last_actions")
    """The features beside the image."""
    num_last_actions: int = 2
    """How many actions `last_actions` remembers."""
    edge_weights: EdgeWeights = "uniform"
    """The guidance graph: it shapes the cost to go, and with it the channels, the features and the reward."""
    num_frames: int = 1
    """How many of its latest observations each agent observes, stacked: 1 is the present one alone."""
    neighbors: int = 0
    """How many of the nearest other agents' observations each agent gets after its own."""
    neighbor_radius: int = 8
    """How many rows, and how many columns, away those may be."""
    action_mode: ActionMode = "argmax"
    """How the action matrix of `central-ppo` becomes actions."""
    reward: RewardConfig = REWARDS["progress"]
    """The terms of the reward; the defaults are those of `reward="progress"`."""

    def __post_init__(self) -> None:
        """Check names and numbers; what depends on the map is checked when the environment is created."""
        check_names(self)
        check_counts(self, 1, "height", "width", "num_agents", "max_steps", "num_last_actions", "num_frames")
        check_counts(self, 0, "neighbors", "neighbor_radius")

    def env_keywords(self) -> dict[str, Any]:
        """Return the keywords of the environment to train in."""
        keywords = self.observation_keywords() | {"max_steps": self.max_steps, "reward": self.reward}
        if self.map is not None:
            return keywords | {"map": self.map, "num_agents": self.num_agents}
        return keywords | {"source": RandomObstacles(self.height, self.width, self.density, self.num_agents)}

    def observation_keywords(self) -> dict[str, Any]:
        """Return the keywords that any environment needs for a policy of this task to act in it."""
        return {name: getattr(self, name) for name in OBSERVATION_FIELDS}

    def env_wrappers(self) -> tuple[tuple[str, dict[str, int]], ...]:
        """Return the names and keywords of the wrappers that it needs besides, innermost first."""
        wrappers: list[tuple[str, dict[str, int]]] = []
        if self.neighbors:
            wrappers.append(("Sharing", {"neighbors": self.neighbors, "radius": self.neighbor_radius}))
        if self.num_frames > 1:
            wrappers.append(("History", {"num_frames": self.num_frames}))
        return tuple(wrappers)


@dataclass(frozen=True)
class ModelConfig:
    """The networks: an encoder of one agent's observation, and heads on it."""

    encoder: EncoderName = "conv"
    """`conv`: 3 x 3 convolutions; `report`: the report's two; `residual`: stages of residual blocks."""
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
        check_names(self)
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

    task: TaskConfig = field(default_factory=TaskConfig)
    """What is learnt."""
    algorithm: AlgorithmName = "mappo"
    """`mappo`: a critic that sees the team; `ippo`: one that sees what the agent sees; `central-ppo`: the report's."""
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
