"""A safety layer that uses PIBT to turn the preferences of any policy into collision-free actions."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Protocol, cast

import numpy as np

from mapf_pz.arrays import Floats, Ints
from mapf_pz.environment import MapfEnv
from mapf_pz.planners.pibt.shield_kernels import ShieldState, choose_actions
from mapf_pz.planners.pibt.state import PibtState, allocate_pibt
from mapf_pz.simulator import Simulator

PATIENCE = 4
"""Default number of steps without progress after which an agent follows PIBT."""
_SEED = 1  # breaks ties of PIBT


class BatchShield:
    """The safety layer for all environments of a simulator: see `mapf_pz.planners.pibt.shield_kernels`.

    Environment `b` of a batch is the same as a single one.
    """

    def __init__(self, simulator: Simulator, patience: int = PATIENCE) -> None:
        """Allocate the state.

        Args:
            simulator: the simulator of B environments with N agents.
            patience: the number of steps without coming closer to its goal after which a cardinal agent follows PIBT
                for as many steps; 0: it never does.

        Raises `ValueError` unless `patience` is a whole number, 0 or more.
        """
        if patience < 0 or patience % 1 != 0:  # the remainder of infinity is NaN
            raise ValueError(f"patience={patience}: expected a whole number, 0 or more")
        self._simulator = simulator
        self._patience = int(patience)
        num_envs, num_agents, (height, width) = simulator.num_envs, simulator.num_agents, simulator.shape
        first = allocate_pibt(num_agents, height * width, _SEED)
        self._state = ShieldState(
            PibtState(*(np.repeat(field[None], num_envs, axis=0) for field in first)),
            nearest=np.full((num_envs, num_agents), np.inf, np.float32),
            count=np.zeros((num_envs, num_agents), np.int32),
        )
        self._first = first

    def reset(self, envs: Iterable[int] | None = None) -> None:
        """Start new episodes in the environments `envs`; None: in all of them."""
        chosen = slice(None) if envs is None else list(envs)
        for field, first in zip(self._state.pibt, self._first, strict=True):
            field[chosen] = first
        self._state.nearest[chosen] = np.inf
        self._state.count[chosen] = 0

    def actions(self, preferences: Floats) -> Ints:
        """Return actions (B, N) int64 for the current state of the simulator, such that no move is blocked.

        Args:
            preferences: (B, N, A), higher for better actions; -inf is allowed.

        Raises `ValueError` for another shape, and for NaN.
        """
        simulator = self._simulator
        expected = (simulator.num_envs, simulator.num_agents, simulator.num_actions)
        if np.shape(preferences) != expected:
            raise ValueError(f"preferences: expected the shape {expected}, got {np.shape(preferences)}")
        numbers = np.ascontiguousarray(preferences, np.float64)
        if np.isnan(numbers).any():
            raise ValueError("preferences contain NaN")
        simulator.require_cost_to_go()
        actions = np.empty(expected[:2], np.int64)
        passing = simulator.config.on_target != "nothing"
        choose_actions(
            simulator.world, simulator.tables.arrays, simulator.state, passing, self._patience, numbers, self._state,
            actions,
        )  # fmt: skip
        return actions


class Preferring(Protocol):
    """A policy that returns preferences over actions, not just one action."""

    def preferences(self, observations: dict[str, Any]) -> dict[str, Floats]:
        """Return the preferences (A,) of each agent in `observations`; higher is better."""
        ...

    def reset_states(self) -> None:
        """Reset all per-episode state. Called before each episode."""
        ...


class Shield:
    """Executes a policy's preferences in a PettingZoo environment such that no move is blocked: see `BatchShield`.

    Priorities are those of PIBT, so it also reads the environment's state.
    """

    def __init__(self, policy: Preferring, env: MapfEnv, patience: int = PATIENCE) -> None:
        """Wrap a policy.

        Args:
            policy: the policy whose preferences are executed.
            env: the environment that it acts in, or a wrapper of it.
            patience: as in `BatchShield`, which also raises `ValueError`.
        """
        self._policy = policy
        self._env = cast("MapfEnv", env.unwrapped)
        self._shield = BatchShield(self._env.simulator, patience)

    def reset_states(self) -> None:
        """Reset all per-episode state. Call it before each episode."""
        self._policy.reset_states()
        self._shield.reset()

    def act(self, observations: dict[str, Any]) -> dict[str, int]:
        """Return an action for each agent in `observations`.

        Raises `ValueError` for preferences of another shape, and for NaN.
        """
        simulator, names = self._env.simulator, self._env.possible_agents
        by_agent = self._policy.preferences(observations)
        preferences = np.zeros((1, len(names), simulator.num_actions))
        for i, name in enumerate(names):
            if name in by_agent:
                preferences[0, i] = by_agent[name]
        chosen = dict(zip(names, self._shield.actions(preferences)[0].tolist(), strict=True))
        return {name: chosen[name] for name in observations}
