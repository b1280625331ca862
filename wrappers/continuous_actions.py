"""`ContinuousActions`: a continuous action space, for continuous-control algorithms."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike
from pettingzoo import ParallelEnv

from mapf_pz._internal.arrays import Floats
from mapf_pz._internal.suggest import entry_of
from mapf_pz.environment.mapf_env import AgentInfo, AgentObservation, StepResult
from mapf_pz.simulator.actions import ACTION_MODES, ActionMode, check_dictionary
from mapf_pz.wrappers.wrapped import MapfWrapper, unmasked_space, without_masks


class ContinuousActions(MapfWrapper):
    """The action space of each agent is `Box(-1, 1, (A,), float32)`, a value per action, instead of `Discrete(A)`.

    `action_mode`, a name in `ACTION_MODES`, determines how values are decoded into an action. Values are clipped to
    [-1, 1]. Actions are sampled with a separate generator, which `reset(seed)` seeds, so that the seed and the values
    determine the episode; without a seed, the generator keeps its state. The infos have no `action_mask`, which is one
    of discrete actions.
    """

    def __init__(self, env: ParallelEnv[str, AgentObservation, Any], action_mode: ActionMode = "argmax") -> None:
        """Wrap `env`.

        Args:
            env: a `MapfEnv`, or a wrapper of one, with discrete actions, and without masks in its observations.
            action_mode: `argmax`, `affine`, `sigmoid` or `softmax`.

        Raises:
            TypeError: `env` is not such an environment.
            ValueError: the mode is unknown.
        """
        discrete = unmasked_space(env)
        self._decode = entry_of("action_mode", action_mode, ACTION_MODES)
        super().__init__(env)
        self._rng = np.random.default_rng()
        self.num_actions = int(discrete.n)  # A
        self.action_spaces = dict.fromkeys(env.possible_agents, spaces.Box(-1, 1, (self.num_actions,), np.float32))

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """Return the action space of an agent, which is the same object for all agents and calls."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, AgentObservation], dict[str, AgentInfo]]:
        """Start an episode, as `MapfEnv.reset` does."""
        observations, infos = self.env.reset(seed=seed, options=options)
        if seed is not None:
            self._rng = generator(seed)
        return observations, without_masks(infos)

    def step(self, actions: dict[str, ArrayLike]) -> StepResult:
        """Take one step with A values for each of `self.agents`, as `MapfEnv.step` does.

        It also raises `ValueError` for another shape or NaN.
        """
        check_dictionary(actions)
        acting = [agent for agent in self.env.agents if agent in actions]
        values = [self._values(agent, actions[agent]) for agent in acting]
        numbers = self._decode(np.array(values).reshape(-1, self.num_actions), self._rng)
        *results, infos = self.env.step({**actions, **dict(zip(acting, numbers.tolist(), strict=True))})
        return cast("StepResult", (*results, without_masks(infos)))

    def _values(self, agent: str, action: ArrayLike) -> Floats:
        """Return the values (A,) float64, clipped to the bounds; raises `ValueError`."""
        values = np.asarray(action, np.float64)
        if values.shape != (self.num_actions,):
            raise ValueError(f"action of {agent!r}: expected the shape ({self.num_actions},), got {values.shape}")
        if np.isnan(values).any():
            raise ValueError(f"action of {agent!r}: expected numbers, got {values.tolist()}")
        return values.clip(-1, 1)


def generator(seed: int) -> np.random.Generator:
    """Return a generator for sampling actions, which is independent of the simulator's with the same seed."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1,)))
