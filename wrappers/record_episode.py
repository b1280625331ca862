"""`RecordEpisode`: record episodes for rendering."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.spaces import Discrete
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from mapf_pz.environment.mapf_env import AgentInfo, AgentObservation, StepResult
from mapf_pz.render.recording import Recording
from mapf_pz.render.save import check_output, save_recording
from mapf_pz.wrappers.wrapped import MapfWrapper, wrapped_env

MAX_OBSERVED_BYTES = 2**23
"""Default maximum size of the recorded observations, which are those of the first agents."""


class RecordEpisode(MapfWrapper):
    """Records the current episode as `recording`, or saves episodes in a folder."""

    def __init__(
        self,
        env: ParallelEnv[str, AgentObservation, Any],
        observed: int | None = None,
        folder: str | Path | None = None,
        trigger: Callable[[int], bool] | None = None,
        extensions: Sequence[str] = (".html",),
        fps: float = 4,
    ) -> None:
        """Wrap `env`, a `MapfEnv` or a wrapper of one.

        Args:
            env: the environment.
            observed: number of agents, the first ones, with recorded observations. None: as many as fit into 8 MiB.
            folder: folder of the files `episode-NUMBER.html`; a recording is saved at the end of its episode, or by the
                next `reset` or `close`. None: recordings are not saved.
            trigger: function of the episode's number, 0 at first, that returns whether it is recorded, such as
                `lambda episode: episode % 100 == 0`. None: all are.
            extensions: kinds of the files, as for `mapf_pz.render.save_recording`.
            fps: steps per second of animations.

        Raises `TypeError` for another environment, such as the AEC form, and `ValueError` if `observed` is negative,
        for an unknown extension, and if `fps` is out of range.
        """
        if observed is not None and observed < 0:
            raise ValueError(f"observed={observed}: expected 0 or more")
        for extension in extensions:
            check_output(f"episode{extension}", fps)
        self._folder = None if folder is None else Path(folder)
        self._trigger, self._extensions, self._fps = trigger, tuple(extensions), fps
        self._episode = -1
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
        """Start an episode, and its recording if it is recorded."""
        self._save()
        result = super().reset(seed, options)
        self._episode, self._steps = self._episode + 1, []
        if self._trigger is None or self._trigger(self._episode):
            self._record_state({})
        return result

    def step(self, actions: dict[str, Any]) -> StepResult:
        """Take a step, and record it; the recording of an episode that it ends is saved, if there is a folder."""
        result = super().step(actions)
        if self._steps:
            self._record_state(actions)
            if not self.agents:
                self._save()
        return result

    def close(self) -> None:
        """Save the recording of an unfinished episode, if there is a folder, and close the environment."""
        self._save()
        super().close()

    def _save(self) -> None:
        """Save and end the recording, if there is a folder and it has a step."""
        if self._folder is not None and len(self._steps) > 1:
            self._folder.mkdir(parents=True, exist_ok=True)
            for extension in self._extensions:
                save_recording(self.recording, self._folder / f"episode-{self._episode}{extension}", self._fps)
            self._steps = []

    @property
    def recording(self) -> Recording:
        """Recording of the episode so far; raises `RuntimeError` if none is recorded, as before the first reset.

        With a folder, the recording of an episode is saved at its end, and is no longer here.
        """
        if not self._steps:
            raise RuntimeError("no episode is recorded: call reset() first")
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
        if simulator.delays is not None:
            state["delayed"] = agents["delayed"] & agents["active"]  # delays go on after agents have disappeared
        if env.config.action_model == "rotate":
            state["headings"] = env.headings
        if self._has_discrete_actions:
            state["actions"] = np.array([actions.get(agent, -1) for agent in self.possible_agents], np.int8)
        self._steps.append(state)
