"""The base class of wrappers that change the observations only."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, cast

from gymnasium import spaces
from pettingzoo import ParallelEnv

from mapf_pz.environment.mapf_env import AgentInfo, StepResult
from mapf_pz.wrappers.wrapped import MapfWrapper


class ObservationWrapper(MapfWrapper):
    """Replaces each agent's observation by another one, which lies in the same space for all agents."""

    def __init__(self, env: ParallelEnv[str, Any, Any], space: spaces.Space[Any]) -> None:
        """Wrap `env`; the new observations lie in `space`."""
        super().__init__(env)
        self.observation_spaces = dict.fromkeys(env.possible_agents, space)

    @abstractmethod
    def observation(self, observed: Any, info: AgentInfo) -> Any:
        """Return the new observation of an agent, given its observation and its info."""

    def infos(self, given: dict[str, AgentInfo]) -> dict[str, AgentInfo]:
        """Return the new infos of all agents."""
        return given

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """Return the observation space of an agent, which is the same object for all agents and calls."""
        return self.observation_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, AgentInfo]]:
        """Start an episode, as `MapfEnv.reset` does."""
        observations, infos = self.env.reset(seed=seed, options=options)
        return self._converted(observations, infos), self.infos(infos)

    def step(self, actions: dict[str, Any]) -> StepResult:
        """Take one step, as `MapfEnv.step` does."""
        observations, *rest, infos = self.env.step(actions)
        return cast("StepResult", (self._converted(observations, infos), *rest, self.infos(infos)))

    def _converted(self, observations: dict[str, Any], infos: dict[str, AgentInfo]) -> dict[str, Any]:
        return {agent: self.observation(observed, infos[agent]) for agent, observed in observations.items()}
