"""`CentralizedEnv`: one policy sees what all agents see and acts for all of them, as in the report."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, TypeAlias

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray
from pettingzoo import ParallelEnv

from mapf_pz.action_modes import ActionMode
from mapf_pz.environment import AgentObservation, MapfEnv, parallel_env
from mapf_pz.wrappers.continuous_actions import ContinuousActions
from mapf_pz.wrappers.stacking import stacked, stacked_space, zeros

TeamReward = Literal["sum", "mean"]
TeamObservation: TypeAlias = "NDArray[np.float32] | dict[str, NDArray[np.float32]]"
Info: TypeAlias = dict[str, Any]

TeamSum: TypeAlias = Callable[..., Any]

TEAM_REWARDS: dict[TeamReward, TeamSum] = {"sum": np.sum, "mean": np.mean}
"""How N rewards become one."""


class CentralizedEnv(gymnasium.Env[TeamObservation, ArrayLike]):
    """The team of N agents as one agent of Gymnasium.

    | | |
    | --- | --- |
    | Observation | `Box (N * K, h, w)` float32: the agents' images in their order, with the bounds of their channels |
    | ... with `features` | `Dict(image, features)`: the image as above, the features `(N * F,)` |
    | Action | `Box(-1, 1, (N, A), float32)`: a row per agent, made an action as `action_mode` says |
    | Reward | the sum, or the mean over all N, of the agents' rewards |
    | Terminated | all are on their goals at once; `on_target="finish"`: all have reached them; `"restart"`: never |
    | Truncated | at `max_steps`, unless that step terminated the episode |
    | Info | `is_success` (bool); the names of `MapfEnv.metrics()`, as floats: 0.0 until the episode's last step |

    Agents that have left (`"finish"`) observe zeros and earn nothing, and their rows of the action do not count. The
    instance of a seed is that of the parallel environment with the same seed.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (Gymnasium declares it so)
        "render_modes": MapfEnv.metadata["render_modes"],
        "render_fps": MapfEnv.metadata["render_fps"],
    }

    def __init__(
        self,
        env: ParallelEnv[str, AgentObservation, Any],
        action_mode: ActionMode = "argmax",
        team_reward: TeamReward = "sum",
    ) -> None:
        """Make one agent of a team.

        Args:
            env: A `MapfEnv`, or a wrapper of one, with discrete actions.
            action_mode: As in `ContinuousActions`.
            team_reward: `sum` or `mean`.

        Raises:
            TypeError: `env` is something else.
            ValueError: There is no such mode or team reward.
        """
        self._team_reward = team_reward_function(team_reward)
        self.env = ContinuousActions(env, action_mode)
        self.render_mode = self.env.render_mode
        self._names = self.env.possible_agents
        seen = self.env.observation_space(self._names[0])
        self.observation_space, self.action_space = team_spaces(seen, len(self._names), self.env.num_actions)
        self._nothing = zeros(seen)
        self._no_metrics: dict[str, float] = {}

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[TeamObservation, Info]:
        """Begin an episode; `seed` and `options` as in `MapfEnv.reset`."""
        super().reset(seed=seed)
        observations, _ = self.env.reset(seed=seed, options=options)
        self._no_metrics = self._no_metrics or dict.fromkeys(self.env.metrics(), 0.0)
        return self._join(observations), {"is_success": False, **self._no_metrics}

    def step(self, action: ArrayLike) -> tuple[TeamObservation, float, bool, bool, Info]:
        """Take one step with values (N, A).

        Raises `ValueError` for another shape or values that are not numbers, `RuntimeError` before `reset()` and after
        the end.
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
        """Return a picture or a text, as `MapfEnv.render`."""
        return self.env.render()

    def close(self) -> None:
        """Close the parallel environment."""
        self.env.close()

    def _reward(self, rewards: dict[str, float]) -> float:
        return float(self._team_reward(np.array([rewards.get(name, 0.0) for name in self._names])))

    def _join(self, observations: dict[str, AgentObservation]) -> TeamObservation:
        """Put the agents' observations one after the other, in new arrays; zeros for those who have left."""
        return stacked([observations.get(name, self._nothing) for name in self._names])


def team_reward_function(name: TeamReward) -> TeamSum:
    """Return what makes N rewards one; raises `ValueError` where there is none of that name."""
    if name not in TEAM_REWARDS:
        raise ValueError(f"team_reward={name!r}: expected one of {', '.join(map(repr, TEAM_REWARDS))}")
    return TEAM_REWARDS[name]


def team_spaces(seen: spaces.Space[Any], num_agents: int, num_actions: int) -> tuple[spaces.Space[Any], spaces.Box]:
    """Return the spaces of a team's observations and actions, by what each agent sees."""
    return stacked_space(seen, num_agents), spaces.Box(-1, 1, (num_agents, num_actions), np.float32)


def centralized_env(
    action_mode: ActionMode = "argmax", team_reward: TeamReward = "sum", **keywords: Any
) -> CentralizedEnv:
    """Make the environment and centralize it; the other keywords, and what they raise, are those of `parallel_env`."""
    return CentralizedEnv(parallel_env(**keywords), action_mode, team_reward)
