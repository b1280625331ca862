"""`NeighborObservations`: observations that include those of neighbors."""

from __future__ import annotations

from typing import Any

from pettingzoo import ParallelEnv

from mapf_pz.environment import AgentObservation, MapfEnv
from mapf_pz.neighbors import check_sharing, nearest
from mapf_pz.wrappers.stacking import StackingWrapper, stacked, zeros


class NeighborObservations(StackingWrapper):
    """Appends the observations of the `neighbors` nearest other agents to each agent's observation, nearest first.

    An image (K, h, w) becomes ((1 + neighbors) * K, h, w), features (F,) become ((1 + neighbors) * F,). Missing
    neighbors are replaced by zeros. Neighbors are at most `radius` rows and `radius` columns away, sorted by Manhattan
    distance and then by index. Agents that have disappeared (`on_target="finish"`) are not neighbors, and have no
    neighbors in their last observation.

    With `neighbors=0`, nothing changes (decentralized). With `neighbors=N - 1` and a radius as large as the map, every
    agent observes everything (centralized).
    """

    def __init__(self, env: ParallelEnv[str, AgentObservation, Any], neighbors: int, radius: int) -> None:
        """Wrap `env`.

        Args:
            env: a `MapfEnv`, or a wrapper of one.
            neighbors: number of neighbors; it may exceed the number of other agents.
            radius: maximum distance of a neighbor in rows and in columns.

        Raises:
            TypeError: `env` is not such an environment.
            ValueError: a number is negative.
        """
        mapf_env = _mapf_env(env)
        check_sharing(neighbors, radius)
        super().__init__(env, 1 + neighbors)
        self.neighbors, self.radius = neighbors, radius
        self._simulator = mapf_env.simulator
        self._names = env.possible_agents
        self._zeros = zeros(env.observation_space(env.possible_agents[0]))

    def _stack(self, observations: dict[str, AgentObservation]) -> dict[str, AgentObservation]:
        """Return each agent's observation, followed by those of its neighbors."""
        positions, active = self._simulator.positions(0), self._simulator.agents["active"]
        numbers = nearest(positions[None], active, self.neighbors, self.radius)[0].tolist()
        near = dict(zip(self._names, numbers, strict=True))
        return {
            agent: stacked([seen, *(self._zeros if j < 0 else observations[self._names[j]] for j in near[agent])])
            for agent, seen in observations.items()
        }


def _mapf_env(env: object) -> MapfEnv:
    """Return the wrapped environment; raises `TypeError` if it is not a `MapfEnv`."""
    if not isinstance(env, ParallelEnv) or not isinstance(env.unwrapped, MapfEnv):
        raise TypeError(f"env: expected a MapfEnv or a wrapper of one, got {type(env).__name__}")
    return env.unwrapped
