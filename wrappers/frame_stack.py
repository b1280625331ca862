"""`FrameStack`: observations that include previous observations."""

from __future__ import annotations

from collections import deque
from typing import Any

from pettingzoo import ParallelEnv

from mapf_pz.environment import AgentObservation
from mapf_pz.wrappers.stacking import StackingWrapper, stacked


class FrameStack(StackingWrapper):
    """Stacks the last `num_frames` observations of each agent, from the oldest to the current one.

    An image (K, h, w) becomes (num_frames * K, h, w), features (F,) become (num_frames * F,). At the start of an
    episode, the first observation is repeated, as in TorchRL's `CatFrames`.
    """

    def __init__(self, env: ParallelEnv[str, AgentObservation, Any], num_frames: int) -> None:
        """Wrap `env`, a `MapfEnv` or a wrapper of one; raises `ValueError` for `num_frames` below 1."""
        if num_frames < 1:
            raise ValueError(f"num_frames={num_frames}: expected a whole number, 1 or more")
        super().__init__(env, num_frames)
        self.num_frames = num_frames
        self._frames: dict[str, deque[AgentObservation]] = {}

    def _start(self, observations: dict[str, AgentObservation]) -> None:
        """Fill the frames with the first observations of the episode."""
        self._frames = {
            agent: deque([seen] * self.num_frames, maxlen=self.num_frames) for agent, seen in observations.items()
        }

    def _stack(self, observations: dict[str, AgentObservation]) -> dict[str, AgentObservation]:
        """Append the observations to the frames, and return the stacked frames."""
        for agent, seen in observations.items():
            self._frames[agent].append(seen)
        return {agent: stacked(self._frames[agent]) for agent in observations}
