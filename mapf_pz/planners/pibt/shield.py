"""A safety layer: any policy, carried out by PIBT so that no two agents get into each other's way."""

from __future__ import annotations

from typing import Any, Protocol, cast

import numpy as np

from mapf_pz.arrays import Floats
from mapf_pz.environment import MapfEnv
from mapf_pz.planners.pibt.kernels import PibtState, allocate_pibt
from mapf_pz.planners.pibt.shield_kernels import carry_out


class Preferring(Protocol):
    """A policy that tells how much it likes each action, not just which it takes."""

    def preferences(self, observations: dict[str, Any]) -> dict[str, Floats]:
        """Return (A,) for each agent that observes, higher for better actions."""
        ...

    def reset_states(self) -> None:
        """Forget the episode; called before each."""
        ...


class Shield:
    """Acts by a policy's preferences, such that no move is prevented: see `mapf_pz.planners.pibt.shield_kernels`.

    Priorities are those of PIBT, so it looks at the environment's state besides.
    """

    def __init__(self, policy: Preferring, env: MapfEnv) -> None:
        """Put the layer around a policy.

        Args:
            policy: whose preferences are carried out.
            env: the environment that it acts in, or a wrapper of it.
        """
        self._policy = policy
        self._env = cast("MapfEnv", env.unwrapped)
        self._state: PibtState | None = None

    def reset_states(self) -> None:
        """Forget the episode: called before each."""
        self._policy.reset_states()
        self._state = None

    def act(self, observations: dict[str, Any]) -> dict[str, int]:
        """Return an action for each agent that observes."""
        simulator, names = self._env.simulator, self._env.possible_agents
        planning_view = simulator.planning_view()
        if self._state is None:
            self._state = allocate_pibt(planning_view, seed=1)
        told = self._policy.preferences(observations)
        preferences = np.zeros((len(names), simulator.num_actions))
        for i, name in enumerate(names):
            if name in told:
                preferences[i] = told[name]
        actions = np.empty(len(names), np.int64)
        carry_out(planning_view, preferences, simulator.config.on_target != "nothing", self._state, actions)
        chosen = dict(zip(names, actions.tolist(), strict=True))
        return {name: chosen[name] for name in observations}
