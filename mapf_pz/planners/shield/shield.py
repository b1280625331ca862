"""A safety layer that uses PIBT or EPIBT to turn the preferences of any policy into collision-free actions."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, cast

import numpy as np

from mapf_pz._internal.arrays import Bools, Floats, Ints
from mapf_pz.environment.mapf_env import MapfEnv
from mapf_pz.environment.policy import Preferring, PreferringInBatch
from mapf_pz.planners.epibt.operations import operations
from mapf_pz.planners.epibt.state import NONE, allocate_epibt
from mapf_pz.planners.pibt.state import LATE, Options, PibtState, allocate_pibt
from mapf_pz.planners.shield.by_epibt import Intentions, choose_by_epibt
from mapf_pz.planners.shield.by_pibt import Progress, choose_by_pibt
from mapf_pz.simulator.simulator import Observation, Simulator

PATIENCE = 4
"""Default number of steps without progress after which an agent ignores its preferences."""
DEPTH = 3
"""Default number of actions of an operation of agents that turn."""
_SEED = 1  # breaks ties of PIBT


class BatchShield:
    """The safety layer for all environments of a simulator.

    Agents follow PIBT, see `mapf_pz.planners.shield.by_pibt`; those that turn and only have to pass their goals
    follow EPIBT, see `mapf_pz.planners.shield.by_epibt`.
    Environment `b` of a batch is the same as a single one.
    """

    def __init__(self, simulator: Simulator, patience: int = PATIENCE, depth: int = DEPTH) -> None:
        """Allocate the state.

        Args:
            simulator: the simulator of B environments with N agents.
            patience: the number of steps without coming closer to its goal after which an agent ignores its preferences
                for as many steps; 0: it never does.
            depth: number of actions of an operation, 3 to 8, as in `EPIBT`, where agents follow EPIBT.

        Raises `ValueError` unless `patience` is a whole number, 0 or more, and `depth` is one from 3 to 8.
        """
        if patience < 0 or patience % 1 != 0:  # the remainder of infinity is NaN
            raise ValueError(f"patience={patience}: expected a whole number, 0 or more")
        if depth not in range(3, 9):
            raise ValueError(f"depth={depth}: expected a number of actions from 3 to 8")
        self._simulator = simulator
        self._patience = int(patience)
        shape = simulator.num_envs, simulator.num_agents
        self._progress = Progress(np.zeros(shape, np.float32), np.zeros(shape, np.int32))
        by_pibt = simulator.config.action_model == "cardinal" or not _passing(simulator)
        self._rules = _PibtRules(simulator) if by_pibt else _EpibtRules(simulator, int(depth))
        self.reset()

    def reset(self, envs: Iterable[int] | None = None) -> None:
        """Start new episodes in the environments `envs`; None: in all of them."""
        chosen = slice(None) if envs is None else list(envs)
        self._progress.nearest[chosen] = np.inf
        self._progress.count[chosen] = 0
        self._rules.reset(chosen)

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
        self._rules.choose(numbers, self._patience, self._progress, actions)
        return actions

    @property
    def ignores_preferences(self) -> Bools:
        """(B, N): which agents ignored their preferences in the last `actions`, as they had made no progress before."""
        return (self._progress.count >= self._patience) & (self._patience > 0)


class _PibtRules:
    """PIBT in B environments."""

    def __init__(self, simulator: Simulator) -> None:
        self._simulator = simulator
        self._options = Options(LATE, swap=True, hindrance=True)
        height, width = simulator.shape
        self._first = allocate_pibt(simulator.num_agents, height * width, _SEED)
        self._pibt = PibtState(*(np.repeat(field[None], simulator.num_envs, axis=0) for field in self._first))

    def reset(self, chosen: slice | list[int]) -> None:
        for field, first in zip(self._pibt, self._first, strict=True):
            field[chosen] = first

    def choose(self, preferences: Floats, patience: int, progress: Progress, actions: Ints) -> None:
        simulator = self._simulator
        choose_by_pibt(
            simulator.world, simulator.tables.arrays, simulator.state, _passing(simulator),
            self._options, patience, preferences, progress, self._pibt, actions,
        )  # fmt: skip


class _EpibtRules:
    """EPIBT in B environments."""

    def __init__(self, simulator: Simulator, depth: int) -> None:
        self._simulator = simulator
        self._tree = operations(depth, cardinal=False, only_turning=True)
        self._scratch = allocate_epibt(simulator.planning_view(), self._tree, num_regions=1)
        shape = simulator.num_envs, simulator.num_agents
        self._intentions = Intentions(*(np.zeros(shape, np.int32) for _ in Intentions._fields))

    def reset(self, chosen: slice | list[int]) -> None:
        self._intentions.choice[chosen] = self._tree.wait
        self._intentions.cell[chosen] = NONE
        self._intentions.heading[chosen] = 0

    def choose(self, preferences: Floats, patience: int, progress: Progress, actions: Ints) -> None:
        simulator = self._simulator
        choose_by_epibt(
            simulator.world, simulator.tables.arrays, simulator.state,
            patience, preferences, progress, self._tree, self._intentions, self._scratch, actions,
        )  # fmt: skip


def _passing(simulator: Simulator) -> bool:
    """Return whether agents only have to pass their goals; otherwise they must stay there."""
    return simulator.config.on_target != "nothing"


class ShieldedBatch:
    """Executes a policy's preferences in all environments of a simulator such that no move is blocked."""

    def __init__(self, policy: PreferringInBatch, shield: BatchShield) -> None:
        """Put the safety layer of a simulator between a policy and this simulator."""
        self._policy = policy
        self._shield = shield

    def reset(self, b: int) -> None:
        """Reset all per-episode state of environment `b`. Call it before each episode."""
        self._policy.reset(b)
        self._shield.reset([b])

    def actions(self, observation: Observation, envs: Sequence[int]) -> Ints:
        """Return actions (B, N) int64, in the environments `envs` those of `BatchShield` for the policy's preferences.

        `observation` is what the agents observe in the current state of the simulator.
        """
        return self._shield.actions(self._policy.preferences(observation, envs))


class Shield:
    """Executes a policy's preferences in a PettingZoo environment such that no move is blocked: see `BatchShield`.

    It also reads the environment's state. `policy` is the policy.
    """

    def __init__(self, policy: Preferring, env: MapfEnv, patience: int = PATIENCE, depth: int = DEPTH) -> None:
        """Wrap a policy.

        Args:
            policy: the policy whose preferences are executed.
            env: the environment that it acts in, or a wrapper of it.
            patience: as in `BatchShield`, which also raises `ValueError`.
            depth: as in `BatchShield`.
        """
        self.policy = policy
        self._env = cast("MapfEnv", env.unwrapped)
        self._options = patience, depth
        self._shield = BatchShield(self._env.simulator, *self._options)

    def in_batch(self, simulator: Simulator) -> ShieldedBatch | None:
        """Return the same for all environments of a simulator; None if the policy acts in single environments only."""
        in_batch = getattr(self.policy, "in_batch", None)
        return None if in_batch is None else ShieldedBatch(in_batch(simulator), BatchShield(simulator, *self._options))

    def reset_states(self) -> None:
        """Reset all per-episode state. Call it before each episode."""
        self.policy.reset_states()
        self._shield.reset()

    @property
    def ignores_preferences(self) -> Bools:
        """(N,): as in `BatchShield`."""
        return self._shield.ignores_preferences[0]

    def act(self, observations: dict[str, Any]) -> dict[str, int]:
        """Return an action for each agent in `observations`.

        Raises `ValueError` for preferences of another shape, and for NaN.
        """
        simulator, names = self._env.simulator, self._env.possible_agents
        by_agent = self.policy.preferences(observations)
        preferences = np.zeros((1, len(names), simulator.num_actions))
        for i, name in enumerate(names):
            if name in by_agent:
                preferences[0, i] = by_agent[name]
        chosen = dict(zip(names, self._shield.actions(preferences)[0].tolist(), strict=True))
        return {name: chosen[name] for name in observations}
