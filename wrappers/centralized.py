"""`CentralizedEnv`: one policy observes and acts for all agents, as in the report."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias, cast

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray
from pettingzoo import ParallelEnv

from mapf_pz._internal.arrays import Bools, Ints
from mapf_pz._internal.config import checked
from mapf_pz._internal.signatures import with_fields_of
from mapf_pz._internal.suggest import entry_of
from mapf_pz.environment.mapf_env import AgentInfo, AgentObservation, MapfEnv, parallel_env
from mapf_pz.simulator.actions import ACTION_MODES, ActionMode, Decoder
from mapf_pz.simulator.config import EnvConfig
from mapf_pz.wrappers.continuous_actions import ContinuousActions
from mapf_pz.wrappers.stacking import stacked, stacked_space, zeros
from mapf_pz.wrappers.wrapped import unmasked_space

TeamReward = Literal["sum", "mean"]
TeamActionMode = Literal[ActionMode, "discrete"]
TeamObservation: TypeAlias = "NDArray[np.float32] | dict[str, NDArray[np.float32]]"
Info: TypeAlias = dict[str, Any]

TeamSum: TypeAlias = Callable[..., Any]

TEAM_REWARDS: dict[TeamReward, TeamSum] = {"sum": np.sum, "mean": np.mean}
"""Functions that combine the rewards of N agents."""
TEAM_ACTION_MODES: dict[TeamActionMode, Decoder | None] = {**ACTION_MODES, "discrete": None}
"""Decoders of the matrix; `discrete` actions need none."""


@checked
@dataclass(frozen=True)
class CentralizedConfig(EnvConfig):
    """All keywords of `centralized_env`; the first two may be given by position."""

    action_mode: TeamActionMode = "argmax"
    """How the matrix is decoded to actions: `argmax`, `affine`, `sigmoid` or `softmax`, as in `ContinuousActions`; or
    `discrete`: a number of an action for each agent instead of the matrix."""
    team_reward: TeamReward = "sum"
    """The team's reward: the `sum` of the agents' rewards, or their `mean`."""


class CentralizedEnv(gymnasium.Env[TeamObservation, ArrayLike]):
    """A team of N agents as a single-agent Gymnasium environment.

    | | |
    | --- | --- |
    | Observation | `Box (N * K, h, w)` float32: the agents' images in order, with the bounds of their channels |
    | ... with `features` | `Dict(image, features)`: the image as above, the features `(N * F,)` |
    | Action | `Box(-1, 1, (N, A), float32)`: a row per agent, which `action_mode` decodes |
    | ... with `action_mode="discrete"` | `MultiDiscrete([A] * N)`: the number of an action per agent |
    | Reward | the sum of the agents' rewards, or their mean over all N |
    | Terminated | all agents are at their goals; `on_target="finish"`: all have reached them; `"restart"`: never |
    | Truncated | at `max_steps`, unless that step terminated the episode |
    | Info | `is_success` (bool); the names of `MapfEnv.metrics()`, as floats, 0.0 before the last step of an episode |
    | ... with `"discrete"` | `action_mask` (N, A) int8: 1 for actions that the map allows; see `action_masks` |

    Agents that have disappeared (`"finish"`) observe zeros and get no reward, their masks are ones, and their actions
    are ignored.
    The instance of a seed is that of the parallel environment with the same seed.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (as declared by Gymnasium)
        "render_modes": MapfEnv.metadata["render_modes"],
        "render_fps": MapfEnv.metadata["render_fps"],
    }

    def __init__(
        self,
        env: ParallelEnv[str, AgentObservation, Any],
        action_mode: TeamActionMode = CentralizedConfig.action_mode,
        team_reward: TeamReward = CentralizedConfig.team_reward,
    ) -> None:
        """Wrap `env`.

        Args:
            env: a `MapfEnv`, or a wrapper of one, with discrete actions.
            action_mode: as in `ContinuousActions`, or `discrete`.
            team_reward: `sum` or `mean`.

        Raises:
            TypeError: `env` is not such an environment.
            ValueError: the mode or team reward is unknown.
        """
        self._team_reward = entry_of("team_reward", team_reward, TEAM_REWARDS)
        entry_of("action_mode", action_mode, TEAM_ACTION_MODES)
        num_actions = int(unmasked_space(env).n)
        self.env = cast("MapfEnv", env) if action_mode == "discrete" else ContinuousActions(env, action_mode)
        self.render_mode = self.env.render_mode
        self.metadata = self.metadata | {"render_modes": self.env.metadata["render_modes"]}
        self._names = self.env.possible_agents
        space = self.env.observation_space(self._names[0])
        self.observation_space = stacked_space(space, len(self._names))
        self.action_space = team_action_space(action_mode, len(self._names), num_actions)
        self._zeros = zeros(space)
        self._all_allowed = np.ones(num_actions, np.int8)
        self._masks: Ints | None = None  # (N, A) of discrete actions, after reset
        self._no_metrics: dict[str, float] = {}

    def __repr__(self) -> str:
        """Return the environment and what it wraps in one line."""
        return f"CentralizedEnv({self.env!r})"

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[TeamObservation, Info]:
        """Start an episode; `seed` and `options` are those of `MapfEnv.reset`."""
        super().reset(seed=seed)
        observations, infos = self.env.reset(seed=seed, options=options)
        self._no_metrics = self._no_metrics or dict.fromkeys(self.env.metrics(), 0.0)
        return self._join(observations), {"is_success": False, **self._no_metrics, **self._team_infos(infos)}

    def step(self, action: ArrayLike) -> tuple[TeamObservation, float, bool, bool, Info]:
        """Take one step with values (N, A), or with integers (N,) if `action_mode="discrete"`.

        Raises `ValueError` for another shape, NaN or a number of no action, and `RuntimeError` before `reset()` or
        after the end.
        """
        rows = np.asarray(action)
        if rows.shape != self.action_space.shape:
            raise ValueError(f"action: expected the shape {self.action_space.shape}, got {rows.shape}")
        observations, rewards, terminations, _, infos = self.env.step(dict(zip(self._names, rows, strict=True)))
        over = not self.env.agents
        terminated = over and all(terminations.values())
        metrics = self.env.metrics() if over else self._no_metrics
        info = {"is_success": terminated, **metrics, **self._team_infos(infos)}
        return self._join(observations), self._reward(rewards), terminated, over and not terminated, info

    def action_masks(self) -> Bools:
        """Return the masks of discrete actions, (N * A,) bool, as `sb3_contrib.MaskablePPO` reads them.

        Raises `RuntimeError` before `reset()`, and for other action modes, whose matrix has no masks.
        """
        if self._masks is None:
            raise RuntimeError("action_masks(): expected action_mode='discrete', and reset() before")
        return self._masks.reshape(-1) > 0

    def _team_infos(self, infos: dict[str, AgentInfo]) -> Info:
        """Return the masks of discrete actions (N, A) and, with delays, which agents were delayed (N,), by name."""
        found: Info = {}
        if not isinstance(self.action_space, spaces.Box):
            rows = [infos[name]["action_mask"] if name in infos else self._all_allowed for name in self._names]
            found["action_mask"] = self._masks = np.array(rows)
        if any("delayed" in info for info in infos.values()):
            found["delayed"] = np.array([name in infos and infos[name]["delayed"] > 0 for name in self._names])
        return found

    def render(self) -> Any:
        """Return an image or a text, as `MapfEnv.render` does."""
        return self.env.render()

    def close(self) -> None:
        """Close the parallel environment."""
        self.env.close()

    def _reward(self, rewards: dict[str, float]) -> float:
        return float(self._team_reward(np.array([rewards.get(name, 0.0) for name in self._names])))

    def _join(self, observations: dict[str, AgentObservation]) -> TeamObservation:
        """Concatenate the agents' observations in new arrays, with zeros for agents that have disappeared."""
        return stacked([observations.get(name, self._zeros) for name in self._names])


def team_action_space(
    action_mode: TeamActionMode, num_agents: int, num_actions: int
) -> spaces.Box | spaces.MultiDiscrete:
    """Return the action space of a team: a matrix of values, or an integer per agent."""
    if action_mode == "discrete":
        return spaces.MultiDiscrete([num_actions] * num_agents)
    return spaces.Box(-1, 1, (num_agents, num_actions), np.float32)


@with_fields_of(CentralizedConfig)
def centralized_env(*arguments: Any, **keywords: Any) -> CentralizedEnv:
    """Create a centralized environment; raises as `parallel_env` and `CentralizedEnv`."""
    config = CentralizedConfig(*arguments, **keywords)
    return CentralizedEnv(parallel_env(**config.keywords()), config.action_mode, config.team_reward)
