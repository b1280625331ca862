"""`InspectedPolicy`: record what a policy decides in an episode, and why."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from mapf_pz._internal.arrays import Floats
from mapf_pz.environment.policy import AnyEnv, Policy, actions_of, simulator_of
from mapf_pz.planners import Shield
from mapf_pz.render.inspection import Inspection

if TYPE_CHECKING:  # which imports torch
    from mapf_pz.rl.policies.decision import Decision

STRONGEST = 8
"""Maximum number of agents whose weights in an agent's attention are recorded."""
MAX_NUMBERS = 2**22
"""Default maximum of the numbers in a recording: those of the first agents. A page stores most of them in 2 bytes."""


@runtime_checkable
class Watchable(Protocol):
    """A policy that reports its decisions, as `mapf_pz.rl.LearnedPolicy` does."""

    def watch(self, observer: Callable[[Decision], object]) -> None:
        """Call `observer` with each decision from now on."""
        ...


class InspectedPolicy:
    """A policy in an environment, which acts as without this wrapper: `inspection` has its decisions in an episode.

    Of a policy that does not report its decisions, such as a planner, only the environment's side is recorded.
    """

    def __init__(self, policy: Policy, env: AnyEnv, inspected: int | None = None) -> None:
        """Wrap a policy.

        Args:
            policy: the policy.
            env: the environment that it acts in.
            inspected: number of agents, the first ones, that are recorded. None: as many as fit into `MAX_NUMBERS`.

        Raises `ValueError` if `inspected` is negative.
        """
        if inspected is not None and inspected < 0:
            raise ValueError(f"inspected={inspected}: expected 0 or more")
        self.needs_infos = getattr(policy, "needs_infos", False)
        self._policy = policy
        self._simulator = simulator_of(env)
        self._index = {name: i for i, name in enumerate(env.possible_agents)}
        layout = self._simulator.layout
        size = len(layout.feature_names) + layout.num_actions + 2 * STRONGEST
        fitting = MAX_NUMBERS // (self._simulator.config.max_steps * size)
        self._num_inspected = fitting if inspected is None else inspected
        self._decisions: list[Decision] = []
        self._steps: list[dict[str, NDArray[Any]]] = []
        watched = policy.policy if isinstance(policy, Shield) else policy
        if isinstance(watched, Watchable):
            watched.watch(self._decisions.append)

    def reset_states(self) -> None:
        """Reset all per-episode state, and start a new recording."""
        self._policy.reset_states()
        self._steps = []

    def act(self, observations: dict[str, Any], infos: dict[str, Any] | None = None) -> dict[str, int]:
        """Return the policy's actions, and record the decision."""
        self._decisions.clear()
        actions = actions_of(self._policy, observations, infos or {})
        step = self._environment_side()
        for decision in self._decisions:
            step |= self._policy_side(decision)
        if isinstance(self._policy, Shield):
            step["ignored"] = self._policy.ignores_preferences
        self._steps.append({name: values[: self._num_inspected].copy() for name, values in step.items()})
        return actions

    @property
    def inspection(self) -> Inspection:
        """The decisions of the episode so far; raises `RuntimeError` before the first one."""
        if not self._steps:
            raise RuntimeError("call act() first")
        arrays: dict[str, Any] = {name: np.stack([step[name] for step in self._steps]) for name in self._steps[0]}
        return Inspection(feature_names=self._simulator.layout.feature_names, **arrays)

    def _environment_side(self) -> dict[str, NDArray[Any]]:
        """Return the action masks, and the agents' own features of this step."""
        seen, layout = self._simulator.observe(), self._simulator.layout
        step: dict[str, NDArray[Any]] = {"allowed": seen.action_mask[0] > 0}
        if layout.num_features:
            step["features"] = seen.features[0, :, layout.own_features]
        return step

    def _policy_side(self, decision: Decision) -> dict[str, NDArray[Any]]:
        """Return what the policy computed, with the agents of the environment in order."""
        agents = np.array([self._index[str(name)] for name in decision.agents])
        step = {"preferred": self._of_all(agents, decision.preferences.argmax(-1), -1)}
        for name in ("probabilities", "means"):
            values = getattr(decision, name)
            if values is not None:
                step[name] = self._of_all(agents, values, 0)
        if decision.attention is not None:
            order, weights = strongest(decision.attention)
            attended = np.where(order < 0, -1, agents[order])
            step |= {"attended": self._of_all(agents, attended, -1), "attention": self._of_all(agents, weights, 0)}
        return step

    def _of_all(self, agents: NDArray[Any], values: NDArray[Any], missing: int) -> NDArray[Any]:
        """Return the values (R, ...) of some agents as those of all (N, ...), `missing` for those that do not act."""
        whole = np.full((len(self._index), *values.shape[1:]), missing, values.dtype)
        whole[agents] = values
        # Agents that have just disappeared are observed once more.
        whole[self._simulator.agents[0]["active"] == 0] = missing
        return whole


def strongest(attention: Floats) -> tuple[NDArray[np.int64], Floats]:
    """Return the columns (R, L) of the largest weights of each row, and these weights, both in descending order.

    Args:
        attention: (R, R), 0 or more. L is `STRONGEST`; columns of weight 0 and missing ones are -1.
    """
    order = np.argsort(-attention, axis=-1, kind="stable")[:, :STRONGEST]
    weights = np.take_along_axis(attention, order, -1)
    missing = ((0, 0), (0, STRONGEST - order.shape[1]))
    order = np.pad(np.where(weights > 0, order, -1), missing, constant_values=-1)
    return order, np.pad(weights, missing)
