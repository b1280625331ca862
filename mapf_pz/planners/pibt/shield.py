"""A safety layer that uses PIBT to turn the preferences of any policy into collision-free actions."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Protocol, cast

import numpy as np

from mapf_pz.arrays import Floats, Ints
from mapf_pz.environment import MapfEnv
from mapf_pz.planners.pibt.shield_kernels import choose_actions
from mapf_pz.planners.pibt.state import PibtState, allocate_pibt
from mapf_pz.simulator import Simulator


class Preferring(Protocol):
    """A policy that returns preferences over actions, not just one action."""

    def preferences(self, observations: dict[str, Any]) -> dict[str, Floats]:
        """Return the preferences (A,) of each agent in `observations`; higher is better."""
        ...

    def reset_states(self) -> None:
        """Reset all per-episode state. Called before each episode."""
        ...


class Shield:
    """Executes a policy's preferences such that no move is blocked: see `mapf_pz.planners.pibt.shield_kernels`.

    Priorities are those of PIBT, so it also reads the environment's state.
    """

    def __init__(self, policy: Preferring, env: MapfEnv) -> None:
        """Wrap a policy.

        Args:
            policy: the policy whose preferences are executed.
            env: the environment that it acts in, or a wrapper of it.
        """
        self._policy = policy
        self._env = cast("MapfEnv", env.unwrapped)
        self._state: PibtState | None = None

    def reset_states(self) -> None:
        """Reset all per-episode state. Call it before each episode."""
        self._policy.reset_states()
        self._state = None

    def act(self, observations: dict[str, Any]) -> dict[str, int]:
        """Return an action for each agent in `observations`."""
        simulator, names = self._env.simulator, self._env.possible_agents
        planning_view = simulator.planning_view()
        if self._state is None:
            self._state = allocate_pibt(planning_view, seed=1)
        by_agent = self._policy.preferences(observations)
        preferences = np.zeros((len(names), simulator.num_actions))
        for i, name in enumerate(names):
            if name in by_agent:
                preferences[i] = by_agent[name]
        actions = np.empty(len(names), np.int64)
        choose_actions(planning_view, preferences, simulator.config.on_target != "nothing", self._state, actions)
        chosen = dict(zip(names, actions.tolist(), strict=True))
        return {name: chosen[name] for name in observations}


class BatchShield:
    """The safety layer for a batch of environments."""

    def __init__(self, simulator: Simulator) -> None:
        """Create the layer for the environments of a simulator."""
        self._simulator = simulator
        self._states: list[PibtState | None] = [None] * simulator.num_envs

    def reset(self, envs: Iterable[int]) -> None:
        """Reset all per-episode state of these environments."""
        for b in envs:
            self._states[b] = None

    def actions(self, preferences: Floats) -> Ints:
        """Return the actions (B, N) int64 for preferences (B, N, A) float64."""
        simulator = self._simulator
        actions = np.empty(simulator.agents.shape, np.int64)
        for b in range(simulator.num_envs):
            view = simulator.planning_view(b)
            if self._states[b] is None:
                self._states[b] = allocate_pibt(view, seed=1)
            choose_actions(view, preferences[b], simulator.config.on_target != "nothing", self._states[b], actions[b])
        return actions
