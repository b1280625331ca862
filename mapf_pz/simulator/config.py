"""The configuration of an environment: a frozen dataclass that holds every default."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from reprlib import repr as shortened
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from mapf_pz._internal.arrays import Bools
from mapf_pz._internal.plugins import import_object
from mapf_pz._internal.suggest import expected_names
from mapf_pz.guidance.library import EdgeWeights, check_edge_weights
from mapf_pz.instances.instance import ActionModel, Grid, HeadingName, InstanceSource, Scenario
from mapf_pz.simulator.kernels.observation.channels import CHANNELS, Channel, channel_of
from mapf_pz.simulator.kernels.observation.features import Feature, feature_of
from mapf_pz.simulator.kernels.reward import REWARDS, RewardConfig
from mapf_pz.simulator.transition import Transition

if TYPE_CHECKING:
    from typing_extensions import Self

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
_OBJECT_ALLOWED = ("initial_heading",)  # fields that need not be a name


@dataclass(frozen=True, kw_only=True)
class EnvConfig:
    """All keywords of `parallel_env`. Raises `ValueError`, naming the field and its allowed values.

    Configurations are equal if all fields are. A map given as an array becomes a `Grid`; headings, and lists and other
    sequences, become tuples.
    """

    map: str | Path | Bools | Grid | None = None
    """A map's name, the path of a `.map` file or of a `.json` map of GGO, a map drawn as text, or a bool array (True =
    free). Default: the map that the scenario's file names, in the same folder or by name, otherwise `empty-8-8`."""
    scenario: str | Path | Scenario | Sequence[str | Path] | None = None
    """Starts and goals: a scenario's name, such as `den312d-random-1` or, with a map, `random-1`; a `.scen` file; a
    `Scenario`; or a problem, which names its own map: the name of a bundled one, such as `warehouse_small_10` or
    `pogema-mazes`, or a file, `.json` (League of Robot Runners) or `.mapf.json` and `.lmapf.json` (POGEMA). With
    several, each episode samples one of them. Default: starts and goals are sampled."""
    num_agents: int | None = None
    """Number of agents; a scenario's first N agents are used. Default: all agents of the scenario (of several, as many
    as the smallest has) or of the source if one is given, otherwise 4."""
    max_steps: int = 256
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
    view_size: Sequence[int] = (5, 5)
    """Height and width of each agent's view in cells, each at most 511; it may be larger than the map."""
    view: View | None = None
    """The agent's position in its view: `front` (at the bottom center, facing up) or `centered`. Default: `front`, or
    `centered` with cardinal actions."""
    frame: Frame | None = None
    """Orientation of the view: `egocentric` (up is the agent's heading) or `map` (up is north). Default: `egocentric`,
    or `map` with cardinal actions."""
    see_through_walls: bool = True
    """Whether agents see through obstacles; if not, cells with an obstacle on the straight line to them are hidden."""
    channels: Sequence[str | Channel] = ("view", "goal", "orientation", "edge_weights")
    """Channels of the observation's image, in order: names, `package.module:name`, or `Channel` objects. The default
    channels are the report's."""
    features: Sequence[str | Feature] = ()
    """Features observed in addition to the image, in order: names, `package.module:name`, or `Feature` objects. If
    there are any, the observation is a Dict(image, features)."""
    num_last_actions: int = 4
    """Number of past actions in the feature `last_actions`."""
    num_frames: int = 1
    """Number of steps observed: the observations of the last `num_frames` steps, oldest first. At the start of an
    episode, its first observation is repeated."""
    num_neighbors: int = 0
    """Number of nearest other agents whose observations are appended to each agent's own, nearest first."""
    neighbor_radius: int = 8
    """Maximum distance of these neighbors, in rows and in columns."""
    edge_weights: EdgeWeights = "uniform"
    """Guidance graph: `uniform`, `crisscross`, `crisscross:ALONG` (the weight along its directions), `random` (sampled
    in every episode), the name of a bundled graph, the path of a file for the map (`.json`, `.csv`, `.w`, `.npz`), or a
    `GuidanceGraph`."""
    around_agents_at_goals: bool = False
    """Whether the cost to go, in observations and rewards, leads around the other agents that are at their goals, as if
    they were obstacles. An agent that cannot reach its goal around them has the cost to go through them. No effect
    unless `on_target="nothing"`, since other agents do not stay at their goals."""
    reward: str | RewardConfig | RewardFunction = "report"
    """Reward: `report`, which pays nothing for a blocked forward move (see `RewardConfig.pay_blocked_forward`),
    `progress`, a `RewardConfig`, a function from a `Transition` to rewards (B, N), or the `package.module:name` of such
    an object."""
    initial_heading: HeadingName | ArrayLike = "random"
    """Initial headings: `random`, `east`, or N headings. Headings of an instance take precedence. With cardinal
    actions, all agents face north."""
    source: InstanceSource | str | None = None
    """Source of episodes, in place of `map` and `scenario`: an object or `package.module:name`. `num_agents`, if given,
    must equal the source's."""
    distance_bytes: int | None = None
    """Maximum memory of the cost-to-go tables, in bytes. Default: 1 GiB, or as much as the goals of all agents need, up
    to half of the machine's memory."""
    render_mode: RenderMode | None = None
    """What `render()` does: `rgb_array` returns an image, (rows, cols, 3) uint8; `ansi` returns text; `human` shows a
    window."""

    def __post_init__(self) -> None:
        """Check every field that can be checked without the map, and convert sequences to tuples."""
        self._check_choices()
        if not isinstance(self.map, (str, Path, Grid, type(None))):
            object.__setattr__(self, "map", Grid.from_array(self.map))
        object.__setattr__(self, "scenario", _scenario(self.scenario))
        object.__setattr__(self, "initial_heading", _headings(self.initial_heading))
        object.__setattr__(self, "view_size", _pair("view_size", self.view_size))
        object.__setattr__(self, "channels", _parts("channels", self.channels, channel_of))
        object.__setattr__(self, "features", _parts("features", self.features, feature_of))
        if not self.channels:
            raise ValueError(f"channels: expected at least one of {', '.join(CHANNELS)}")
        for name in ("max_steps", "num_last_actions", "num_frames"):
            check_whole(name, getattr(self, name), least=1)
        for name in ("num_neighbors", "neighbor_radius"):
            check_whole(name, getattr(self, name), least=0)
        for name, most in (("num_agents", MAX_WHOLE), ("distance_bytes", 2**62)):
            if getattr(self, name) is not None:
                check_whole(name, getattr(self, name), 1, most)
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

    def _check_choices(self) -> None:
        choices: dict[str, tuple[object, ...]] = {
            "action_model": get_args(ActionModel),
            "collision_system": get_args(CollisionSystem),
            "on_target": get_args(OnTarget),
            "goals": get_args(Goals),
            "view": (*get_args(View), None),
            "frame": (*get_args(Frame), None),
            "render_mode": (*get_args(RenderMode), None),
            "initial_heading": get_args(HeadingName),
        }
        for name, allowed in choices.items():
            value = getattr(self, name)
            if name not in _OBJECT_ALLOWED and not isinstance(value, (str, type(None))):
                raise ValueError(f"{name}={_shown(value)}: expected one of {', '.join(map(repr, allowed))}")
            if (value is None or isinstance(value, str)) and value not in allowed:
                raise ValueError(f"{name}={_shown(value)}: expected one of {', '.join(map(repr, allowed))}")
        check_edge_weights(self.edge_weights)
        _ = self._resolved_reward  # raises ValueError

    def _check_source(self, source: object) -> None:
        """Raise for an object that is not a source, and for keywords that contradict the source."""
        if not isinstance(source, InstanceSource):
            raise TypeError(f"source={_shown(source)}: expected an InstanceSource, such as RandomObstacles or FixedMap")
        for name in ("map", "scenario"):
            if getattr(self, name) is not None:
                raise ValueError(f"{name}: not allowed together with source, which determines maps, starts and goals")
        if self.num_agents not in (None, source.num_agents):
            raise ValueError(f"num_agents={self.num_agents}: the source has {source.num_agents} agents")

    @classmethod
    def from_keywords(cls, *arguments: Any, **keywords: Any) -> Self:
        """Create a configuration; raises `TypeError` for an unknown keyword, and suggests the closest known one."""
        known = [field.name for field in dataclasses.fields(cls)]
        for name in keywords:
            if name not in known:
                raise TypeError(f"unknown keyword {name!r}: {expected_names(name, known)}")
        return cls(*arguments, **keywords)

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


def _scenario(value: Any) -> str | Path | Scenario | tuple[str | Path, ...] | None:
    """Return the scenario, with several ones as a tuple."""
    if isinstance(value, (str, Path, Scenario, type(None))):
        return value
    several: tuple[Any, ...] = tuple(value) if isinstance(value, Sequence) else ()
    if not several or not all(isinstance(item, (str, Path)) for item in several):
        raise TypeError(f"scenario={_shown(value)}: expected the path of a file, several paths, or a Scenario")
    return several


def check_whole(name: str, value: object, least: int, most: int = MAX_WHOLE) -> None:
    """Raise `ValueError` unless the value called `name` is a whole number from `least` to `most`."""
    if not isinstance(value, (int, np.integer)) or isinstance(value, bool) or value < least:
        raise ValueError(f"{name}={_shown(value)}: expected a whole number, {least} or more")
    if value > most:
        raise ValueError(f"{name}={_shown(value)}: expected at most {most}")


def _pair(name: str, value: Any) -> tuple[int, int]:
    try:
        height, width = value
    except (TypeError, ValueError):
        raise ValueError(f"{name}={_shown(value)}: expected (height, width)") from None
    check_whole(name, height, 1, MAX_VIEW_SIDE)
    check_whole(name, width, 1, MAX_VIEW_SIDE)
    return int(height), int(width)


def _headings(value: HeadingName | ArrayLike) -> str | tuple[int, ...]:
    if isinstance(value, str):
        return value
    headings = np.asarray(value)
    if headings.ndim != 1 or not np.isin(headings, range(4)).all():
        raise ValueError(f"initial_heading={_shown(value)}: expected 'random', 'east', or N numbers 0 to 3")
    return tuple(map(int, headings))


def _parts(name: str, value: Any, check: Callable[[Any], object]) -> tuple[Any, ...]:
    """Return channels or features as a tuple; raise `ValueError` unless all are known and different."""
    if isinstance(value, str) or not isinstance(value, Sequence):
        example = f", such as ({value!r},)" if isinstance(value, str) else ""
        raise ValueError(f"{name}={_shown(value)}: expected a tuple or list of names{example}")
    parts: tuple[Any, ...] = tuple(value)
    if any(part in parts[:k] for k, part in enumerate(parts)):
        raise ValueError(f"{name}={_shown(value)}: expected different names")
    for part in parts:
        check(part)
    return parts


def _resolve_reward(given: Any) -> Any:
    """Return the terms or the function that the field `reward` names; raise `ValueError` for anything else."""
    reward = given
    if isinstance(given, str):
        if given not in REWARDS and ":" not in given:
            names = ", ".join(map(repr, REWARDS))
            raise ValueError(f"reward={_shown(given)}: expected one of {names}, or package.module:name")
        reward = REWARDS[given] if given in REWARDS else import_object("reward", given)
    if not isinstance(reward, RewardConfig) and not callable(reward):
        raise ValueError(f"reward={_shown(given)}: expected a name, a RewardConfig or a function")
    return reward


def _shown(value: object) -> str:
    """Return a value for error messages: in one line, shortened."""
    return " ".join(shortened(value).split())


@dataclass(frozen=True)
class BatchConfig(EnvConfig):
    """Keywords of all environments that step a batch: the fields of `EnvConfig`, and the size of the batch."""

    num_envs: int = 1
    """Number of environments B."""
    num_threads: int = 1
    """Number of threads of the kernels."""
