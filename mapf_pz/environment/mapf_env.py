"""The PettingZoo environment: agent names, spaces and dictionaries on top of the simulator, which has the dynamics."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, SupportsIndex, TypeAlias, cast

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from pettingzoo import AECEnv, ParallelEnv
from pettingzoo.utils import OrderEnforcingWrapper
from pettingzoo.utils.conversions import parallel_to_aec_wrapper

from mapf_pz._internal.arrays import Bools, Ints
from mapf_pz._internal.signatures import with_fields_of
from mapf_pz.instances.instance import Instance, Scenario
from mapf_pz.render.modes import render_modes
from mapf_pz.render.state import RenderState
from mapf_pz.simulator.actions import check_agents, check_dictionary, whole_numbers
from mapf_pz.simulator.config import EnvConfig
from mapf_pz.simulator.global_state import STATE_PLANES, global_state
from mapf_pz.simulator.simulator import Simulator

AgentInfo = dict[str, Any]

_FLAGS = ("at_goal", "arrived", "blocked", "moved")
_TEMPLATES: list[AgentInfo] = [
    {"action_mask": None, **{flag: bits >> k & 1 for k, flag in enumerate(_FLAGS)}, "arrivals": 0}
    for bits in range(2 ** len(_FLAGS))
]
"""An info for each combination of flags: copying one is faster than building a dictionary of six values."""


AgentObservation: TypeAlias = "NDArray[np.float32] | dict[str, NDArray[np.float32]]"
StepResult: TypeAlias = (
    "tuple[dict[str, AgentObservation], dict[str, float], dict[str, bool], dict[str, bool], dict[str, AgentInfo]]"
)


class MapfEnv(ParallelEnv[str, AgentObservation, SupportsIndex]):
    """Multi-agent path finding: N agents on a grid map, each with its own goal.

    | | |
    | --- | --- |
    | Import | `env = mapf_pz.parallel_env(...)`; the keywords are the fields of `EnvConfig` |
    | Agents | `agent_0 ... agent_{N-1}` |
    | Actions | `Discrete(4)`: forward, rotate left, rotate right, wait; or the 5 of `CardinalAction` |
    | Observations | `Box(-1, 1, (K, h, w), float32)`; with `features`, `Dict(image=Box, features=Box(-1, 1, (F,)))` |
    | Infos | `action_mask` (A,) int8, `at_goal`, `arrived`, `blocked`, `moved` (0 or 1), `arrivals` (a count) |
    | | with `delays`, also `delayed` (0 or 1): the agent was delayed in the last step |
    | State | `(7, H, W)` float32: obstacle, agent, heading (sine, cosine), goal, distance to go, time |

    Version history: v0, the first.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (PettingZoo declares it so)
        "name": "mapf_v0",
        "render_modes": render_modes(),
        "render_fps": 4,
        "is_parallelizable": True,
    }

    def __init__(self, config: EnvConfig) -> None:
        """Create the environment; raises `ValueError` if configuration, map and scenario do not fit together."""
        self.config = config
        self.simulator = Simulator(config)
        self.render_mode = config.render_mode
        self.metadata = self.metadata | {"render_modes": render_modes()}  # a display may have been chosen meanwhile
        self.possible_agents = [f"agent_{i}" for i in range(self.simulator.num_agents)]
        self._index = {agent: i for i, agent in enumerate(self.possible_agents)}
        self._set_agents([])
        self._observation_space = self.simulator.layout.space()
        self._action_space = spaces.Discrete(self.simulator.num_actions)
        self.observation_spaces = dict.fromkeys(self.possible_agents, self._observation_space)
        self.action_spaces: dict[str, spaces.Space[SupportsIndex]] = dict.fromkeys(
            self.possible_agents, self._action_space
        )
        self.state_space = spaces.Box(-1, 1, (len(STATE_PLANES), *self.simulator.shape), np.float32)
        self._was_reset = False
        self._canvas: Any = None
        self._window: Any = None

    def __repr__(self) -> str:
        """Return the number of agents, the map and the rules in one line."""
        grid, (height, width) = self.simulator.source.grid, self.simulator.shape
        maps = "maps" if grid is None else f"map {grid.name!r}"
        rules = f"action_model={self.config.action_model!r}, on_target={self.config.on_target!r}"
        return f"MapfEnv(num_agents={self.simulator.num_agents}, {maps} of {height} x {width}, {rules})"

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """Return the observation space of the agent; the same object for all agents and calls.

        Raises `ValueError` for an unknown agent.
        """
        self._check_agent(agent)
        return self._observation_space

    def action_space(self, agent: str) -> spaces.Discrete:
        """Return the action space of the agent; the same object for all agents and calls.

        Raises `ValueError` for an unknown agent.
        """
        self._check_agent(agent)
        return self._action_space

    def _check_agent(self, agent: str) -> None:
        if agent not in self._index:
            raise ValueError(f"unknown agent {agent!r}: expected agent_0 to {self.possible_agents[-1]}")

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, AgentObservation], dict[str, AgentInfo]]:
        """Start an episode, and return observations and infos.

        Args:
            seed: random seed that determines the episode, 0 or more; without a seed, every episode differs from the
                last.
            options: `{"instance": Instance or Scenario}` sets the episode instead of sampling it. Options of other
                names are ignored, as by the environments of PettingZoo and Gymnasium.

        Raises:
            TypeError: `options` is not a dictionary, or the instance has another type.
            ValueError: the seed is not such a number, the instance does not fit the environment, or an option of
                another name is an instance.
        """
        instance = self._instance(options)
        self._set_agents([])  # if the reset fails, there is no episode
        self.simulator.reset(
            seeds=None if seed is None else {0: seed}, instances=None if instance is None else {0: instance}
        )
        self._set_agents(self.possible_agents.copy())
        self._was_reset = True
        if self.render_mode == "human":
            self.render()
        return self._observe()

    def _instance(self, options: Any) -> Instance | None:
        """Return the instance in the options of a reset, if there is one; raises `TypeError` and `ValueError`."""
        if not isinstance(options, (Mapping, type(None))):
            raise TypeError(f"options: expected a dictionary, got {type(options).__name__}")
        given = options or {}
        for name, value in given.items():
            if name != "instance" and isinstance(value, (Instance, Scenario)):
                raise ValueError(f"options: expected the {type(value).__name__} as 'instance', got {name!r}")
        instance = given.get("instance")
        if isinstance(instance, Scenario):
            return Instance(self.simulator.source.grid or self.simulator.grid(0), instance)
        if not isinstance(instance, (Instance, type(None))):
            raise TypeError(f"options['instance']: expected an Instance or a Scenario, got {type(instance).__name__}")
        return instance

    def _set_agents(self, agents: list[str]) -> None:
        """Set which agents act from now on."""
        self.agents = agents
        self._rows = slice(None) if len(agents) == len(self.possible_agents) else [self._index[name] for name in agents]
        self._no_flags = dict.fromkeys(agents, False)

    def step(self, actions: Mapping[str, SupportsIndex]) -> StepResult:
        """Take one step with an action for each of `self.agents`.

        Returns observations, rewards, terminations, truncations and infos of the agents that acted. Raises
        `ValueError` for missing actions, unknown agents or invalid actions, `TypeError` for anything but a dictionary,
        and `RuntimeError` before `reset()` and after the end of the episode.
        """
        check_dictionary(actions)
        self._require_episode("step")
        if not self.agents:
            raise RuntimeError("the episode is over, call reset()")
        self.simulator.step(self._numbers(actions))
        observations, infos = self._observe()
        rewards = self._by_agent("reward")
        if self._any_ended():
            terminations, truncations = self._by_agent("terminated"), self._by_agent("truncated")
            self._set_agents([agent for agent in self.agents if not (terminations[agent] or truncations[agent])])
        else:  # copies of one dictionary, which is faster
            terminations, truncations = self._no_flags.copy(), self._no_flags.copy()
        if self.render_mode == "human":
            self.render()
        return observations, rewards, terminations, truncations, infos

    def _numbers(self, actions: Mapping[str, SupportsIndex]) -> Ints:
        """Return the actions as (1, N) integers, with 0 for agents that have disappeared; raises `ValueError`."""
        given = list(actions.values())
        if list(actions) != self.agents:
            if set(actions) != set(self.agents):
                check_agents(actions, self.agents, self.possible_agents)
            given = [actions[agent] for agent in self.agents]
        numbers = whole_numbers(self.agents, given, self.simulator.num_actions)
        if len(numbers) == len(self.possible_agents):
            return numbers[None]
        padded = np.zeros(len(self.possible_agents), np.int64)
        padded[self._rows] = numbers
        return padded[None]

    @property
    def _agents(self) -> NDArray[np.void]:
        """The agents' records, (N,) AGENT."""
        return self.simulator.agents[0]

    def _any_ended(self) -> bool:
        """Return whether the last step ended the episode of any agent."""
        simulator = self.simulator
        if simulator.terminated[0] or simulator.truncated[0]:
            return True
        return self.config.on_target == "finish" and bool(self._agents["terminated"].any())

    def _by_agent(self, field: str) -> dict[str, Any]:
        """Return a field of the records of the agents that acted."""
        return dict(zip(self.agents, self._agents[field][self._rows].tolist(), strict=True))

    def _observe(self) -> tuple[dict[str, AgentObservation], dict[str, AgentInfo]]:
        batch, rows = self.simulator.observe(), self._rows
        observations: Any = batch.image[0][rows]
        if self.simulator.layout.num_features:
            pairs = zip(observations, batch.features[0][rows], strict=True)
            observations = ({"image": image, "features": features} for image, features in pairs)
        infos = agent_infos(self.agents, self._agents[rows], batch.action_mask[0][rows])
        if self.simulator.delays is not None:
            for name, delayed in zip(self.agents, self._agents["delayed"][rows].tolist(), strict=True):
                infos[name]["delayed"] = int(delayed)
        return dict(zip(self.agents, observations, strict=True)), infos

    def state(self) -> NDArray[np.float32]:
        """Return the global state, (7, H, W) float32 in [-1, 1]; `STATE_PLANES` names its planes.

        The distance to go is at the agent's cell, in units of `(H + W) * mean weight`, at most 1. Raises
        `RuntimeError` before `reset()`.
        """
        self._require_episode("state")
        return global_state(self.simulator)[0]

    def metrics(self) -> dict[str, float]:
        """Return the metrics of the episode up to now; see `mapf_pz.simulator.metrics.episode_metrics`.

        Raises `RuntimeError` before `reset()`.
        """
        self._require_episode("metrics")
        return self.simulator.metrics(0)

    def _require_episode(self, method: str) -> None:
        if not self._was_reset:
            raise RuntimeError(f"call reset() before {method}()")

    def render(self) -> NDArray[np.uint8] | str | None:
        """Return an image, (rows, cols, 3) uint8, or text, depending on `render_mode`; None without a mode.

        With `human`, the image is shown in a window instead, also after each reset and step, at most at `render_fps`.
        """
        if self.render_mode is None:
            return None
        free = self.simulator.grid(0).free
        if self.render_mode == "ansi":
            from mapf_pz.render import ansi

            return ansi.draw(free, *self.render_state())
        from mapf_pz.render.rgb import Canvas

        if self._canvas is None or self._canvas.free is not free:
            self._canvas = Canvas(free, self.simulator.num_agents)
        image = self._canvas.draw(*self.render_state())
        if self.render_mode == "rgb_array":
            return image
        if self._window is None:
            from mapf_pz.render.window import Window

            self._window = Window(self.simulator.grid(0).name or "mapf-pz", self.metadata["render_fps"])
        self._window.show(image, f"step {self.step_count}")
        return None

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._window is not None:
            self._window.close()
            self._window = None

    def render_state(self) -> RenderState:
        """Return what is rendered, in copies."""
        headings = self.headings if self.config.action_model == "rotate" else None
        active, delayed = self._agents["active"].copy(), self._agents["delayed"].copy()
        return RenderState(self.positions, headings, self.goals, active, delayed)

    @property
    def positions(self) -> Ints:
        """The agents' positions, (N, 2) int, [row, col]; a copy."""
        return self.simulator.positions(0)

    @property
    def goals(self) -> Ints:
        """The agents' current goals, (N, 2) int, [row, col]; a copy."""
        return self.simulator.goals(0)

    @property
    def headings(self) -> Ints:
        """The agents' headings, (N,) int, numbers of `Heading`; a copy."""
        return self._agents["heading"].astype(np.int64)

    @property
    def grid(self) -> Bools:
        """The map, (H, W) bool, True where a cell is free; read-only."""
        return self.simulator.grid(0).free

    @property
    def step_count(self) -> int:
        """Number of steps taken in this episode."""
        return int(self.simulator.steps[0])


@with_fields_of(EnvConfig)
def parallel_env(**keywords: Any) -> MapfEnv:
    """Create the environment; the keywords are the fields of `EnvConfig`, which documents them.

    Raises:
        TypeError: A keyword is unknown.
        ValueError: A value is not allowed, or the values do not fit together.
        FileNotFoundError: A file does not exist.
        FormatError: A file is malformed.
    """
    return MapfEnv(EnvConfig(**keywords))


class MapfAecEnv(parallel_to_aec_wrapper[str, AgentObservation, SupportsIndex]):
    """The environment in PettingZoo's AEC form, in which agents act sequentially."""

    def __init__(self, parallel: ParallelEnv[str, Any, Any]) -> None:
        """Take turns in `parallel`, a `MapfEnv` or a wrapper of one, which steps when all agents have acted."""
        super().__init__(parallel)
        self.metrics: Callable[[], dict[str, float]] = cast("MapfEnv", parallel.unwrapped).metrics
        """Method that returns the metrics of the episode up to the last complete step; see `MapfEnv.metrics`."""

    def __repr__(self) -> str:
        """Return the environment in one line."""
        return f"{type(self).__name__}({self.env!r})"


class OrderEnforced(OrderEnforcingWrapper[str, Any, Any]):
    """Refuses calls in the wrong order."""

    def __repr__(self) -> str:
        """Return the environment in one line."""
        return repr(self.env)


@with_fields_of(EnvConfig)
def env(**keywords: Any) -> AECEnv[str, AgentObservation, SupportsIndex | None]:
    """Create the environment in its AEC form, in which agents act sequentially; keywords as in `parallel_env`.

    `metrics()` and the members of `unwrapped`, the `MapfEnv`, describe the last complete step.
    """
    return OrderEnforced(MapfAecEnv(parallel_env(**keywords)))


def agent_infos(names: list[str], agents: NDArray[np.void], action_mask: Ints) -> dict[str, AgentInfo]:
    """Return the infos of N agents by name.

    Args:
        names: Names of the agents (N).
        agents: Their records, (N,) AGENT.
        action_mask: Their action masks, (N, A) int8, of which the infos contain views.
    """
    flags = (agents["at_goal"], agents["arrived"], agents["blocked"], agents["cell"] != agents["was_cell"])
    bits = np.packbits(flags, axis=0, bitorder="little")[0]  # (N,), flag k of _FLAGS is bit k
    infos: dict[str, AgentInfo] = {}
    for name, mask, k, arrivals in zip(names, action_mask, bits.tolist(), agents["arrivals"].tolist(), strict=True):
        infos[name] = info = _TEMPLATES[k].copy()
        info["action_mask"] = mask
        info["arrivals"] = arrivals
    return infos
