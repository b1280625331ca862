"""PIBT as a policy, and as a planner: the fast baseline that scales to thousands of agents."""

from __future__ import annotations

import time
from typing import Any, cast

import numpy as np

from mapf_pz.core.pibt import UNDECIDED, allocate_desk, cardinal_actions, plan_cells, rotating_actions
from mapf_pz.environment import MapfEnv, parallel_env
from mapf_pz.instances.sources import InstanceList
from mapf_pz.planners.plan import Plan
from mapf_pz.types import Instance, Ints


class PIBT:
    """Plans one step at a time, for both action models: see `mapf_pz.core.pibt`.

    Bound to an environment it is a policy, `act(observations) -> actions`; it looks at the environment's state, not at
    observations. An agent's priority rises while it is away from its goal, so that each reaches it at some time, if the
    map is such that every two neighbouring cells lie on a cycle; all being there at once is not promised.
    """

    def __init__(self, env: MapfEnv | None = None, seed: int = 0) -> None:
        """Bind the planner.

        Args:
            env: the environment to act in, or a wrapper of it; None: only `solve` can be used.
            seed: of the draws between equally good choices.
        """
        self._env = None if env is None else cast("MapfEnv", env.unwrapped)
        self._seed = seed
        self.reset_states()

    def reset_states(self) -> None:
        """Forget the episode: called before each."""
        self._rng = np.random.default_rng(self._seed)
        self._fraction = self._priority = np.zeros(0)

    def act(self, observations: dict[str, Any]) -> dict[str, int]:
        """Return an action for each agent that observes; raises `RuntimeError` without an environment."""
        if self._env is None:
            raise RuntimeError("PIBT: expected an environment to act in, PIBT(env)")
        actions = dict(zip(self._env.possible_agents, self._decide(self._env).tolist(), strict=True))
        return {name: actions[name] for name in observations}

    def solve(self, instance: Instance, time_limit: float = 10.0, max_steps: int = 1000) -> Plan | None:
        """Return a plan that brings all agents to their goals, or None where none was found.

        Args:
            instance: with headings for agents that turn, without for cardinal ones.
            time_limit: seconds.
            max_steps: the longest plan that is tried.
        """
        env = parallel_env(
            source=InstanceList([instance]),
            max_steps=max_steps,
            action_model="cardinal" if instance.headings is None else "rotate",
            view_size=(1, 1),
        )
        planner, began = PIBT(env, self._seed), time.perf_counter()
        env.reset(seed=self._seed)
        cells, headings = [env.positions], [env.headings]
        while env.agents and time.perf_counter() - began < time_limit:
            env.step(planner.act(dict.fromkeys(env.agents)))
            cells.append(env.positions)
            headings.append(env.headings)
        if not (env.positions == env.goals).all():
            return None
        return Plan(np.stack(cells), None if instance.headings is None else np.stack(headings))

    def _decide(self, env: MapfEnv) -> Ints:
        """Return the actions (N,) int64 for the present state."""
        simulator = env.simulator
        simulator.require_distances()
        crew, occupant, m = simulator.state.agents[0], simulator.state.occupant[0], int(simulator.state.map[0])
        world, tables = simulator.world, simulator.tables.arrays
        if not self._priority.size:
            # Fractions decide between agents that have been away equally long: those farther away come first.
            cost = simulator.distance_to_go(0).astype(np.float64)
            self._fraction = cost / (cost.max(initial=0) + 1)
            self._priority = self._fraction.copy()
            self._desk = allocate_desk(len(crew), world.obstacle.shape[1] - 1)
        desk, rotates = self._desk, simulator.num_actions == 4
        if rotates:
            desk.want[desk.want == crew["cell"]] = UNDECIDED
        else:
            desk.want[:] = UNDECIDED
        self._priority = np.where(crew["cell"] == crew["goal"], self._fraction, self._priority + 1)
        order = np.argsort(-self._priority, kind="stable")
        ties = self._rng.random((len(crew), 5), np.float32)
        leads_to = world.leads_to[m]
        plan_cells(leads_to, world.weight[m], tables.slot[m], tables.to_go, crew, occupant, order, ties, desk)
        actions = np.empty(len(crew), np.int64)
        if rotates:
            rotating_actions(leads_to, crew, occupant, desk.want, desk.asking, actions)
        else:
            cardinal_actions(leads_to, crew, desk.want, actions)
        return actions
