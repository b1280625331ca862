"""`CentralizedEnv`: one policy observes and acts for all agents, as in the report."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray
from pettingzoo import ParallelEnv

from mapf_pz._internal.config import checked
from mapf_pz._internal.signatures import with_fields_of
from mapf_pz.environment.mapf_env import AgentObservation, MapfEnv, parallel_env
from mapf_pz.simulator.actions import ActionMode
from mapf_pz.simulator.config import EnvConfig
from mapf_pz.wrappers.continuous_actions import ContinuousActions
from mapf_pz.wrappers.stacking import stacked, stacked_space, zeros

TeamReward = Literal["sum", "mean"]
TeamObservation: TypeAlias = "NDArray[np.float32] | dict[str, NDArray[np.float32]]"
Info: TypeAlias = dict[str, Any]

TeamSum: TypeAlias = Callable[..., Any]

TEAM_REWARDS: dict[TeamReward, TeamSum] = {"sum": np.sum, "mean": np.mean}
"""Functions that combine the rewards of N agents."""


@checked
@dataclass(frozen=True)
class CentralizedConfig(EnvConfig):
    """All keywords of `centralized_env`; the first two may be given by position."""

    action_mode: ActionMode = "argmax"
    """How values are decoded to actions: `argmax`, `affine`, `sigmoid` or `softmax`, as in `ContinuousActions`."""
    team_reward: TeamReward = "sum"
    """The team's reward: the `sum` of the agents' rewards, or their `mean`."""


class CentralizedEnv(gymnasium.Env[TeamObservation, ArrayLike]):
    """A team of N agents as a single-agent Gymnasium environment.

    | | |
    | --- | --- |
    | Observation | `Box (N * K, h, w)` float32: the agents' images in order, with the bounds of their channels |
    | ... with `features` | `Dict(image, features)`: the image as above, the features `(N * F,)` |
    | Action | `Box(-1, 1, (N, A), float32)`: a row per agent, which `action_mode` decodes |
    | Reward | the sum of the agents' rewards, or their mean over all N |
    | Terminated | all agents are at their goals; `on_target="finish"`: all have reached them; `"restart"`: never |
    | Truncated | at `max_steps`, unless that step terminated the episode |
    | Info | `is_success` (bool); the names of `MapfEnv.metrics()`, as floats, 0.0 before the last step of an episode |

    Agents that have disappeared (`"finish"`) observe zeros and get no reward, and their rows of the action are ignored.
    The instance of a seed is that of the parallel environment with the same seed.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (as declared by Gymnasium)
        "render_modes": MapfEnv.metadata["render_modes"],
        "render_fps": MapfEnv.metadata["render_fps"],
    }

    def __init__(
        self,
        env: ParallelEnv[str, AgentObservation, Any],
        action_mode: ActionMode = CentralizedConfig.action_mode,
        team_reward: TeamReward = CentralizedConfig.team_reward,
    ) -> None:
        """Wrap `env`.

        Args:
            env: a `MapfEnv`, or a wrapper of one, with discrete actions.
            action_mode: as in `ContinuousActions`.
            team_reward: `sum` or `mean`.

        Raises:
            TypeError: `env` is not such an environment.
            ValueError: the mode or team reward is unknown.
        """
        self._team_reward = team_reward_function(team_reward)
        self.env = ContinuousActions(env, action_mode)
        self.render_mode = self.env.render_mode
        self.metadata = self.metadata | {"render_modes": self.env.metadata["render_modes"]}
        self._names = self.env.possible_agents
        space = self.env.observation_space(self._names[0])
        self.observation_space, self.action_space = team_spaces(space, len(self._names), self.env.num_actions)
        self._zeros = zeros(space)
        self._no_metrics: dict[str, float] = {}

    def __repr__(self) -> str:
        """Return the environment and what it wraps in one line."""
        return f"CentralizedEnv({self.env!r})"

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[TeamObservation, Info]:
        """Start an episode; `seed` and `options` are those of `MapfEnv.reset`."""
        super().reset(seed=seed)
        observations, _ = self.env.reset(seed=seed, options=options)
        self._no_metrics = self._no_metrics or dict.fromkeys(self.env.metrics(), 0.0)
        return self._join(observations), {"is_success": False, **self._no_metrics}

    def step(self, action: ArrayLike) -> tuple[TeamObservation, float, bool, bool, Info]:
        """Take one step with values (N, A).

        Raises `ValueError` for another shape or NaN, and `RuntimeError` before `reset()` or after the end.
        """
        rows = np.asarray(action, np.float64)
        if rows.shape != self.action_space.shape:
            raise ValueError(f"action: expected the shape {self.action_space.shape}, got {rows.shape}")
        observations, rewards, terminations, _, _ = self.env.step(dict(zip(self._names, rows, strict=True)))
        over = not self.env.agents
        terminated = over and all(terminations.values())
        info = {"is_success": terminated, **(self.env.metrics() if over else self._no_metrics)}
        return self._join(observations), self._reward(rewards), terminated, over and not terminated, info

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


def team_reward_function(name: TeamReward) -> TeamSum:
    """Return the function that combines N rewards; raises `ValueError` for an unknown name."""
    if name not in TEAM_REWARDS:
        raise ValueError(f"team_reward={name!r}: expected one of {', '.join(map(repr, TEAM_REWARDS))}")
    return TEAM_REWARDS[name]


def team_spaces(space: spaces.Space[Any], num_agents: int, num_actions: int) -> tuple[spaces.Space[Any], spaces.Box]:
    """Return the observation and action spaces of a team, from the observation space of an agent."""
    return stacked_space(space, num_agents), spaces.Box(-1, 1, (num_agents, num_actions), np.float32)


@with_fields_of(CentralizedConfig)
def centralized_env(*arguments: Any, **keywords: Any) -> CentralizedEnv:
    """Create a centralized environment; raises as `parallel_env` and `CentralizedEnv`."""
    config = CentralizedConfig(*arguments, **keywords)
    return CentralizedEnv(parallel_env(**config.keywords()), config.action_mode, config.team_reward)
