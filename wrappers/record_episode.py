"""`RecordEpisode`: record episodes for rendering."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.spaces import Discrete
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from mapf_pz.environment.mapf_env import AgentInfo, AgentObservation, StepResult
from mapf_pz.render.recording import Recording
from mapf_pz.wrappers.wrapped import MapfWrapper, wrapped_env

MAX_OBSERVED_BYTES = 2**23
"""Default maximum size of the recorded observations, which are those of the first agents."""


class RecordEpisode(MapfWrapper):
    """Records the current episode: `recording` can be saved with `mapf_pz.render.save_recording`."""

    def __init__(self, env: ParallelEnv[str, AgentObservation, Any], observed: int | None = None) -> None:
        """Wrap `env`, a `MapfEnv` or a wrapper of one.

        Args:
            env: the environment.
            observed: number of agents, the first ones, with recorded observations. None: as many as fit into 8 MiB.

        Raises `TypeError` for another environment, such as the AEC form, and `ValueError` if `observed` is negative.
        """
        if observed is not None and observed < 0:
            raise ValueError(f"observed={observed}: expected 0 or more")
        self._inner = wrapped_env(env)
        super().__init__(env)
        self._planes = self._inner.simulator.layout.plane_names
        self._has_discrete_actions = isinstance(env.action_space(env.possible_agents[0]), Discrete)
        size = len(self._planes) * int(np.prod(self._inner.config.view_size))
        fitting = MAX_OBSERVED_BYTES // ((self._inner.config.max_steps + 1) * size)
        self._num_observed = fitting if observed is None else observed
        self._steps: list[dict[str, NDArray[Any]]] = []

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, AgentObservation], dict[str, AgentInfo]]:
        """Start an episode and its recording."""
        result = super().reset(seed, options)
        self._steps = []
        self._record_state({})
        return result

    def step(self, actions: dict[str, Any]) -> StepResult:
        """Take a step, and record it."""
        result = super().step(actions)
        self._record_state(actions)
        return result

    @property
    def recording(self) -> Recording:
        """Recording of the episode so far; raises `RuntimeError` before the first reset."""
        if not self._steps:
            raise RuntimeError("call reset() first")
        arrays: dict[str, Any] = {name: np.stack([step[name] for step in self._steps]) for name in self._steps[0]}
        simulator, config = self._inner.simulator, self._inner.config
        return Recording(
            free=self._inner.grid,
            weights=None if config.edge_weights == "uniform" else simulator.guidance(0).move,
            collision_system=config.collision_system,
            lifelong=config.on_target == "restart",
            planes=self._planes,
            view=config.resolved_view,
            frame=config.resolved_frame,
            metrics=self._inner.metrics(),
            title=f"{simulator.grid(0).name}, {len(self.possible_agents)} agents",
            **arrays,
        )

    def _record_state(self, actions: dict[str, Any]) -> None:
        """Record the state, and the actions that led to it."""
        env, agents = self._inner, self._inner.simulator.agents[0]
        # The agents' own observations of this step, without the effects of wrappers.
        simulator = env.simulator
        seen = simulator.observe().image[0, : self._num_observed, simulator.layout.own_planes]
        state: dict[str, NDArray[Any]] = {
            "positions": env.positions,
            "goals": env.goals,
            "active": agents["active"].astype(np.bool_),
            "blocked": agents["blocked"].astype(np.bool_),
            "rewards": agents["reward"].copy() if actions else np.zeros(agents.size),
            "observed": np.rint(127 * seen).astype(np.int8),
        }
        if env.config.action_model == "rotate":
            state["headings"] = env.headings
        if self._has_discrete_actions:
            state["actions"] = np.array([actions.get(agent, -1) for agent in self.possible_agents], np.int8)
        self._steps.append(state)
