"""`NeighborObservations`: agents that also observe what their neighbors observe."""

from __future__ import annotations

from typing import Any

from pettingzoo import ParallelEnv

from mapf_pz.environment import AgentObservation, MapfEnv
from mapf_pz.neighbors import check_sharing, nearest
from mapf_pz.wrappers.stacking import StackingWrapper, stacked, zeros


class NeighborObservations(StackingWrapper):
    """Each agent observes, after its own observation, those of its `neighbors` nearest others, nearest first.

    An image (K, h, w) becomes ((1 + neighbors) * K, h, w), features (F,) become ((1 + neighbors) * F,). Zeros stand for
    missing neighbors. Neighbors are at most `radius` rows and `radius` columns away; the nearest is the one that the
    fewest steps up, down, left and right lead to, of two as near the one of the lower number. Agents that have
    disappeared (`on_target="finish"`) are nobody's neighbors, and have none in their last observation.

    `neighbors=0` changes nothing: decentralized. With `neighbors=N - 1` and a radius as large as the map everybody
    observes everything: centralized.
    """

    def __init__(self, env: ParallelEnv[str, AgentObservation, Any], neighbors: int, radius: int) -> None:
        """Wrap `env`.

        Args:
            env: A `MapfEnv`, or a wrapper of one.
            neighbors: How many others' observations each agent gets; may be more than there are.
            radius: How many rows, and how many columns, away a neighbor may be.

        Raises:
            TypeError: `env` is something else.
            ValueError: A number is negative.
        """
        mapf_env = _mapf_env(env)
        check_sharing(neighbors, radius)
        super().__init__(env, 1 + neighbors)
        self.neighbors, self.radius = neighbors, radius
        self._simulator = mapf_env.simulator
        self._names = env.possible_agents
        self._nothing = zeros(env.observation_space(env.possible_agents[0]))

    def _stack(self, observations: dict[str, AgentObservation]) -> dict[str, AgentObservation]:
        """Return each agent's observation with its neighbors'."""
        positions, active = self._simulator.positions(0), self._simulator.agents["active"]
        numbers = nearest(positions[None], active, self.neighbors, self.radius)[0].tolist()
        near = dict(zip(self._names, numbers, strict=True))
        return {
            agent: stacked([seen, *(self._nothing if j < 0 else observations[self._names[j]] for j in near[agent])])
            for agent, seen in observations.items()
        }


def _mapf_env(env: object) -> MapfEnv:
    """Return what `env` wraps; raises `TypeError` where it is no `MapfEnv`."""
    if not isinstance(env, ParallelEnv) or not isinstance(env.unwrapped, MapfEnv):
        raise TypeError(f"env: expected a MapfEnv or a wrapper of one, got {type(env).__name__}")
    return env.unwrapped
