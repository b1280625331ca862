"""`History`: agents that also observe what they observed before."""

from __future__ import annotations

from collections import deque
from typing import Any

from gymnasium import spaces
from pettingzoo import ParallelEnv
from pettingzoo.utils import BaseParallelWrapper

from mapf_pz.environment import AgentInfo, AgentObservation, StepResult
from mapf_pz.wrappers.stacking import stacked, stacked_space


class History(BaseParallelWrapper[str, AgentObservation, Any]):
    """Each agent observes its last `num_frames` observations as one, oldest first, the present one last.

    An image (K, h, w) becomes (num_frames * K, h, w), features (F,) become (num_frames * F,). What the episode began
    with stands for what was before it, as in TorchRL's `CatFrames`.
    """

    def __init__(self, env: ParallelEnv[str, AgentObservation, Any], num_frames: int) -> None:
        """Wrap `env`, a `MapfEnv` or a wrapper of one; raises `ValueError` for `num_frames` below 1."""
        if num_frames < 1:
            raise ValueError(f"num_frames={num_frames}: expected a whole number, 1 or more")
        super().__init__(env)
        space = stacked_space(env.observation_space(env.possible_agents[0]), num_frames)
        self.num_frames = num_frames
        self.observation_spaces = dict.fromkeys(env.possible_agents, space)
        self._frames: dict[str, deque[AgentObservation]] = {}

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """Return the space of the agent's observations: the same object for all agents and calls."""
        return self.observation_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, AgentObservation], dict[str, AgentInfo]]:
        """Begin an episode, as `MapfEnv.reset`."""
        observations, infos = self.env.reset(seed=seed, options=options)
        self._frames = {
            agent: deque([seen] * self.num_frames, maxlen=self.num_frames) for agent, seen in observations.items()
        }
        return self._join(observations), infos

    def step(self, actions: dict[str, Any]) -> StepResult:
        """Take one step, as `MapfEnv.step`."""
        observations, rewards, terminations, truncations, infos = self.env.step(actions)
        for agent, seen in observations.items():
            self._frames[agent].append(seen)
        return self._join(observations), rewards, terminations, truncations, infos

    def _join(self, observations: dict[str, AgentObservation]) -> dict[str, AgentObservation]:
        """Return the frames of each agent that observes, in new arrays."""
        return {agent: stacked(self._frames[agent]) for agent in observations}
