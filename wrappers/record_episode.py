"""`RecordEpisode`: an environment whose episodes can be looked at afterwards."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from pettingzoo import ParallelEnv
from pettingzoo.utils import BaseParallelWrapper

from mapf_pz.environment import AgentInfo, AgentObservation, MapfEnv, StepResult
from mapf_pz.render.recording import Recording

MAX_OBSERVED_BYTES = 2**23
"""Of the observations that are kept by default: those of the first agents, as many as fit."""


class RecordEpisode(BaseParallelWrapper[str, AgentObservation, Any]):
    """Keeps what happens in an episode: `recording` can be saved by `mapf_pz.render.save_recording`."""

    def __init__(self, env: ParallelEnv[str, AgentObservation, Any], observed: int | None = None) -> None:
        """Wrap `env`, a `MapfEnv` or a wrapper of one.

        Args:
            env: the environment.
            observed: of how many agents, the first ones, observations are kept; None: as many as fit into 8 MiB.

        Raises `ValueError` where `observed` is negative.
        """
        if observed is not None and observed < 0:
            raise ValueError(f"observed={observed}: expected 0 or more")
        super().__init__(env)
        self._inner = cast("MapfEnv", env.unwrapped)
        self._planes = _plane_names(self._inner)
        size = int(np.prod(self._inner.simulator.layout.image_shape))
        fitting = MAX_OBSERVED_BYTES // ((self._inner.config.max_steps + 1) * size)
        self._num_observed = fitting if observed is None else observed
        self._steps: list[dict[str, NDArray[Any]]] = []

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, AgentObservation], dict[str, AgentInfo]]:
        """Begin an episode, and its recording."""
        result = super().reset(seed, options)
        self._steps = []
        self._note()
        return result

    def step(self, actions: dict[str, Any]) -> StepResult:
        """Take a step, and note what came of it."""
        result = super().step(actions)
        self._note()
        return result

    @property
    def recording(self) -> Recording:
        """The episode until now; raises `RuntimeError` before the first reset."""
        if not self._steps:
            raise RuntimeError("call reset() first")
        told: dict[str, Any] = {name: np.stack([step[name] for step in self._steps]) for name in self._steps[0]}
        simulator = self._inner.simulator
        return Recording(
            free=self._inner.grid,
            weights=None if self._inner.config.edge_weights == "uniform" else simulator.edge_weights(0),
            planes=self._planes,
            title=f"{simulator.grid(0).name}, {len(self.possible_agents)} agents",
            **told,
        )

    def _note(self) -> None:
        env, agents = self._inner, self._inner.simulator.agents[0]
        # Not what agents are given, which wrappers may have changed, but what they see at this moment.
        seen = env.simulator.observe().image[0, : self._num_observed]
        told: dict[str, NDArray[Any]] = {
            "positions": env.positions,
            "goals": env.goals,
            "active": agents["active"].astype(np.bool_),
            "blocked": agents["blocked"].astype(np.bool_),
            "observed": np.rint(127 * seen).astype(np.int8),
        }
        if env.config.action_model == "rotate":
            told["headings"] = env.headings
        self._steps.append(told)


def _plane_names(env: MapfEnv) -> tuple[str, ...]:
    """Return a name for each plane of the image."""
    names: list[str] = []
    for given, channel in zip(env.config.channels, env.simulator.layout.channels, strict=True):
        name, planes = given if isinstance(given, str) else "channel", channel.planes
        names += [name] if planes == 1 else [f"{name} {k + 1}" for k in range(planes)]
    return tuple(names)
