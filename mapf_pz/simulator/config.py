"""The configuration of an environment: a frozen dataclass that holds every default."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, TypeVar, get_args

import numpy as np
from numpy.typing import ArrayLike
from pydantic import AfterValidator, BeforeValidator, Field, PlainValidator

from mapf_pz._internal.arrays import Bools
from mapf_pz._internal.config import UNCHECKED, Count, Natural, as_tuple, checked, expecting, shown
from mapf_pz._internal.plugins import import_object
from mapf_pz.guidance.library import EdgeWeights, check_edge_weights
from mapf_pz.instances.delays import Delays
from mapf_pz.instances.instance import ActionModel, Grid, HeadingName, InstanceSource, Scenario
from mapf_pz.simulator.kernels.observation.channels import CHANNELS, Channel, channel_of
from mapf_pz.simulator.kernels.observation.features import Feature, feature_of
from mapf_pz.simulator.kernels.reward import REWARDS, RewardConfig
from mapf_pz.simulator.transition import Transition

CollisionSystem = Literal["soft", "priority", "block_both"]
OnTarget = Literal["nothing", "finish", "restart"]
Goals = Literal["uniform", "alternating"]
View = Literal["front", "centered"]
Frame = Literal["egocentric", "map"]
RewardFunction = Callable[[Transition], ArrayLike]
RenderMode = Literal["human", "rgb_array", "ansi"]
DEFAULT_NUM_AGENTS = 4
"""The number of agents if nothing else determines it."""
MAX_VIEW_SIDE = 511
"""Maximum height and width of a view: a centered view of this size shows all of a map of 256 x 256 cells."""
MAX_WHOLE = 2**30
"""Maximum of the fields that are whole numbers, except bytes."""
OBSERVATION_FIELDS = (
    "view_size",
    "view",
    "frame",
    "see_through_walls",
    "channels",
    "features",
    "num_last_actions",
    "num_frames",
    "num_neighbors",
    "neighbor_radius",
    "around_agents_at_goals",
)
"""The fields that determine observations."""


def _map(value: Any) -> str | Path | Grid:
    return value if isinstance(value, (str, Path, Grid)) else Grid.from_array(value)


def _scenario(value: Any) -> str | Path | Scenario | tuple[str | Path, ...]:
    if isinstance(value, (str, Path, Scenario)):
        return value
    several: tuple[Any, ...] = tuple(value) if isinstance(value, Sequence) else ()
    if not several or not all(isinstance(item, (str, Path)) for item in several):
        raise TypeError(f"scenario={shown(value)}: expected the path of a file, several paths, or a Scenario")
    return several


def _delays(value: Any) -> Delays:
    if isinstance(value, str):
        return Delays.from_text(value)
    if not isinstance(value, Delays):
        raise ValueError("expected a Delays, or its text such as '0.01:1-4'")
    return value


def _headings(value: Any) -> str | tuple[int, ...]:
    if isinstance(value, str) and value in get_args(HeadingName):
        return value
    headings = np.asarray(value)
    if headings.ndim != 1 or not np.isin(headings, range(4)).all():
        raise ValueError("expected 'random', 'east', or N numbers 0 to 3")
    return tuple(map(int, headings))


def _different(parts: Sequence[Item]) -> Sequence[Item]:
    if any(part in parts[:k] for k, part in enumerate(parts)):
        raise ValueError
    return parts


Item = TypeVar("Item")
MapLike = Annotated[str | Path | Bools | Grid, PlainValidator(_map)]
"""A map; an array becomes a `Grid`."""
ScenarioLike = Annotated[str | Path | Scenario | Sequence[str | Path], PlainValidator(_scenario)]
"""A scenario or several ones, which become a tuple."""
EdgeWeightsLike = Annotated[EdgeWeights, UNCHECKED]
"""A guidance graph."""
RewardLike = Annotated[str | RewardConfig | RewardFunction, UNCHECKED]
"""A reward."""
HeadingsLike = Annotated[HeadingName | ArrayLike, PlainValidator(_headings)]
"""How headings are chosen, or N headings, which become a tuple."""
DelaysLike = Annotated[str | Delays, PlainValidator(_delays)]
"""Delays of agents; their text becomes a `Delays`."""
SourceLike = Annotated[InstanceSource | str, UNCHECKED]
"""A source of episodes."""
Parts = Annotated[
    Sequence[Item],
    AfterValidator(_different),
    BeforeValidator(as_tuple),
    expecting("a tuple or list of different names"),
]
"""Channels or features, which become a tuple."""
ViewSize = Annotated[
    Sequence[Annotated[Count, Field(le=MAX_VIEW_SIDE)]],
    Field(min_length=2, max_length=2),
    BeforeValidator(as_tuple),
    expecting(f"(height, width), each a whole number from 1 to {MAX_VIEW_SIDE}"),
]
"""Height and width in cells, which become a tuple."""
SmallCount = Annotated[Count, Field(le=MAX_WHOLE)]
"""A whole number from 1 to `MAX_WHOLE`."""
SmallNatural = Annotated[Natural, Field(le=MAX_WHOLE)]
"""A whole number from 0 to `MAX_WHOLE`."""
Bytes = Annotated[Count, Field(le=2**62)]
"""A number of bytes."""


@checked
@dataclass(frozen=True, kw_only=True)
class EnvConfig:
    """All keywords of `parallel_env`. Raises `ValueError`, naming the field and its allowed values.

    Configurations are equal if all fields are. A map given as an array becomes a `Grid`; headings, and lists and other
    sequences, become tuples.
    """

    HINTS: ClassVar[dict[str, str]] = {
        "obs_radius": "expected view_size=(2 * obs_radius + 1, 2 * obs_radius + 1) and view='centered'",
        "density": "expected source=RandomObstacles(height, width, density, num_agents)",
        "size": "expected source=RandomObstacles(height, width, density, num_agents), or map",
        "seed": "expected reset(seed=...)",
        "map_name": "expected map",
        "max_episode_steps": "expected max_steps",
        "observation_type": "expected channels and features",
    }
    """What to use for keywords of POGEMA's `GridConfig` with other names; `pogema_keywords` converts a whole one."""

    map: MapLike | None = None
    """A map's name, the path of a `.map` file or of a `.json` map of GGO, a map drawn as text, or a bool array (True =
    free). Default: the map that the scenario's file names, in the same folder or by name, otherwise `empty-8-8`."""
    scenario: ScenarioLike | None = None
    """Starts and goals: a scenario's name, such as `den312d-random-1` or, with a map, `random-1`; a `.scen` file; a
    `Scenario`; or a problem, which names its own map: the name of a bundled one, such as `warehouse_small_10` or
    `pogema-mazes`, or a file, `.json` (League of Robot Runners) or `.mapf.json` and `.lmapf.json` (POGEMA). With
    several, each episode samples one of them. Default: starts and goals are sampled."""
    num_agents: SmallCount | None = None
    """Number of agents; a scenario's first N agents are used. Default: all agents of the scenario (of several, as many
    as the smallest has) or of the source if one is given, otherwise 4."""
    max_steps: SmallCount = 256
    """Maximum number of steps per episode, after which it is truncated."""
    action_model: ActionModel = "rotate"
    """Actions of the agents: `rotate` (move forward, turn left, turn right, wait) or `cardinal` (move up, down, left or
    right, wait)."""
    collision_system: CollisionSystem = "soft"
    """How conflicting moves are resolved; the names are POGEMA's."""
    on_target: OnTarget = "nothing"
    """What happens to an agent at its goal: it stays (`nothing`), disappears (`finish`) or gets a new goal (`restart`).
    The names are POGEMA's."""
    goals: Goals = "uniform"
    """Sampled goals: `uniform` on the free cells, or `alternating` between the workstations and the endpoints of a
    warehouse, whose map is a `.json` file of GGO or a `.map` file with `E` and `S`; with `on_target='restart'` only."""
    delays: DelaysLike | None = None
    """Delays of agents: a `Delays`, or its text `PROBABILITY:SMALLEST-LARGEST`, optionally with `:poisson` and
    `:normal`, such as `0.01:1-4`: the probability that a delay begins, and its numbers of steps. Default: those of the
    problem that `scenario` names, otherwise none."""
    view_size: ViewSize = (5, 5)
    """Height and width of each agent's view in cells, each at most 511; it may be larger than the map."""
    view: View | None = None
    """The agent's position in its view: `front` (at the bottom center, facing up) or `centered`. Default: `front`, or
    `centered` with cardinal actions."""
    frame: Frame | None = None
    """Orientation of the view: `egocentric` (up is the agent's heading) or `map` (up is north). Default: `egocentric`,
    or `map` with cardinal actions."""
    see_through_walls: bool = True
    """Whether agents see through obstacles; if not, cells with an obstacle on the straight line to them are hidden."""
    channels: Parts[str | Channel] = ("view", "goal", "orientation", "edge_weights")
    """Channels of the observation's image, in order: names, `package.module:name`, or `Channel` objects. The default
    channels are the report's."""
    features: Parts[str | Feature] = ()
    """Features observed in addition to the image, in order: names, `package.module:name`, or `Feature` objects. If
    there are any, the observation is a Dict(image, features)."""
    num_last_actions: SmallCount = 4
    """Number of past actions in the feature `last_actions`."""
    num_frames: SmallCount = 1
    """Number of steps observed: the observations of the last `num_frames` steps, oldest first. At the start of an
    episode, its first observation is repeated."""
    num_neighbors: SmallNatural = 0
    """Number of nearest other agents whose observations are appended to each agent's own, nearest first."""
    neighbor_radius: SmallNatural = 8
    """Maximum distance of these neighbors, in rows and in columns."""
    edge_weights: EdgeWeightsLike = "uniform"
    """Guidance graph: `uniform`, `crisscross`, `crisscross:ALONG` (the weight along its directions), `random` (sampled
    in every episode), `random:SHARE` (in this fraction of the episodes, otherwise uniform), the name of a bundled
    graph, the path of a file for the map (`.json`, `.csv`, `.w`, `.npz`), or a `GuidanceGraph`."""
    around_agents_at_goals: bool = False
    """Whether the cost to go, in observations and rewards, leads around the other agents that are at their goals, as if
    they were obstacles. An agent that cannot reach its goal around them has the cost to go through them. No effect
    unless `on_target="nothing"`, since other agents do not stay at their goals."""
    reward: RewardLike = "report"
    """Reward: `report`, which pays nothing for a blocked forward move (see `RewardConfig.pay_blocked_forward`),
    `progress`, a `RewardConfig`, a function from a `Transition` to rewards (B, N), or the `package.module:name` of such
    an object."""
    initial_heading: HeadingsLike = "random"
    """Initial headings: `random`, `east`, or N headings. Headings of an instance take precedence. With cardinal
    actions, all agents face north."""
    source: SourceLike | None = None
    """Source of episodes, in place of `map` and `scenario`: an object or `package.module:name`. `num_agents`, if given,
    must equal the source's."""
    distance_bytes: Bytes | None = None
    """Maximum memory of the cost-to-go tables, in bytes. Default: 1 GiB, or as much as the goals of all agents need, up
    to half of the machine's memory."""
    render_mode: RenderMode | None = None
    """What `render()` does: `rgb_array` returns an image, (rows, cols, 3) uint8; `ansi` returns text; `human` shows a
    window."""

    def __post_init__(self) -> None:
        """Check what depends on names or on other fields, as far as possible without the map."""
        check_edge_weights(self.edge_weights)
        _ = self._resolved_reward  # raises ValueError
        for channel in self.channels:
            channel_of(channel)
        for feature in self.features:
            feature_of(feature)
        if not self.channels:
            raise ValueError(f"channels: expected at least one of {', '.join(CHANNELS)}")
        if self.resolved_source is not None:
            self._check_source(self.resolved_source)
        if self.goals == "alternating" and self.on_target != "restart":
            raise ValueError("goals='alternating': allowed only with on_target='restart'")
        if self.goals == "alternating" and (self.scenario is not None or self.source is not None):
            raise ValueError("goals='alternating': not allowed together with scenario or source, which determine goals")
        view, frame = self.resolved_view, self.resolved_frame
        if self.action_model == "cardinal" and (view, frame) != ("centered", "map"):
            raise ValueError("action_model='cardinal': agents have no front, so view='centered' and frame='map' only")
        if frame == "map" and view == "front":
            raise ValueError("frame='map': allowed only with view='centered'")

    def _check_source(self, source: object) -> None:
        """Raise for an object that is not a source, and for keywords that contradict the source."""
        if not isinstance(source, InstanceSource):
            raise TypeError(f"source={shown(source)}: expected an InstanceSource, such as RandomObstacles or FixedMap")
        for name in ("map", "scenario"):
            if getattr(self, name) is not None:
                raise ValueError(f"{name}: not allowed together with source, which determines maps, starts and goals")
        if self.num_agents not in (None, source.num_agents):
            raise ValueError(f"num_agents={self.num_agents}: the source has {source.num_agents} agents")

    def keywords(self) -> dict[str, Any]:
        """Return all fields of `EnvConfig` by name, as keywords of `parallel_env`."""
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(EnvConfig)}

    def __getstate__(self) -> dict[str, Any]:
        """Return what is pickled: the fields, without what was imported by name."""
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}

    @property
    def scenarios(self) -> tuple[str | Path | Scenario, ...]:
        """The scenarios as a tuple, also if there is only one; empty if there is none."""
        if self.scenario is None:
            return ()
        return (self.scenario,) if isinstance(self.scenario, (str, Path, Scenario)) else tuple(self.scenario)

    @cached_property
    def resolved_source(self) -> InstanceSource | None:
        """The source, imported if it is given as `package.module:name`; None if there is none."""
        return import_object("source", self.source) if isinstance(self.source, str) else self.source

    def delays_of(self, source: InstanceSource) -> Delays | None:
        """Return `delays`, or those that all instances of a source have; None if there are none."""
        given = getattr(source, "delays", None) if self.delays is None else self.delays
        return Delays.from_text(given) if isinstance(given, str) else given

    @property
    def resolved_view(self) -> View:
        """`view`, or its default for the action model."""
        return self.view or ("centered" if self.action_model == "cardinal" else "front")

    @property
    def resolved_frame(self) -> Frame:
        """`frame`, or its default for the action model."""
        return self.frame or ("map" if self.action_model == "cardinal" else "egocentric")

    @cached_property
    def _resolved_reward(self) -> RewardConfig | RewardFunction:
        return _resolve_reward(self.reward)

    @property
    def reward_config(self) -> RewardConfig:
        """The terms of the reward; all are 0 if `reward` is a function."""
        reward = self._resolved_reward
        return reward if isinstance(reward, RewardConfig) else RewardConfig(forward=0, rotate=0, goal=0)

    @property
    def reward_function(self) -> RewardFunction | None:
        """The function that computes the reward instead, or None."""
        reward = self._resolved_reward
        return None if isinstance(reward, RewardConfig) else reward


def check_whole(name: str, value: object, least: int, most: int = MAX_WHOLE) -> None:
    """Raise `ValueError` unless the value called `name` is a whole number from `least` to `most`."""
    if not isinstance(value, (int, np.integer)) or isinstance(value, bool) or value < least:
        raise ValueError(f"{name}={shown(value)}: expected a whole number, {least} or more")
    if value > most:
        raise ValueError(f"{name}={shown(value)}: expected at most {most}")


def _resolve_reward(given: Any) -> Any:
    """Return the terms or the function that the field `reward` names; raise `ValueError` for anything else."""
    reward = given
    if isinstance(given, str):
        if given not in REWARDS and ":" not in given:
            names = ", ".join(map(repr, REWARDS))
            raise ValueError(f"reward={shown(given)}: expected one of {names}, or package.module:name")
        reward = REWARDS[given] if given in REWARDS else import_object("reward", given)
    if not isinstance(reward, RewardConfig) and not callable(reward):
        raise ValueError(f"reward={shown(given)}: expected a name, a RewardConfig or a function")
    return reward


@checked
@dataclass(frozen=True)
class BatchConfig(EnvConfig):
    """Keywords of all environments that step a batch: the fields of `EnvConfig`, and the size of the batch."""

    num_envs: Count = 1
    """Number of environments B."""
    num_threads: Count = 1
    """Number of threads of the kernels."""
