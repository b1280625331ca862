"""Adapters for POGEMA: policies of this package in POGEMA's environment, and POGEMA's policies in this package's.

Neither adapter requires POGEMA itself. Source: POGEMA 1.4.0, github.com/Cognitive-AI-Systems/pogema, and the protocol
of its toolbox: `act(observations) -> actions`, which are lists with an item for each agent, and `reset_states()` before
each episode.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol, cast, get_args

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from pettingzoo.utils import BaseParallelWrapper

from mapf_pz._internal.arrays import Bools, Floats, Ints
from mapf_pz.environment.mapf_env import MapfEnv
from mapf_pz.environment.policy import AnyEnv, Policy, PolicyFactory, actions_of, simulator_of
from mapf_pz.evaluation.policies import policy_factory
from mapf_pz.instances import InstanceList
from mapf_pz.instances.instance import Grid, Instance, Scenario
from mapf_pz.planners import Planner
from mapf_pz.simulator.actions import CardinalAction
from mapf_pz.simulator.config import CollisionSystem, EnvConfig, OnTarget

ObservationType = Literal["default", "POMAPF", "MAPF"]


class InPogema:
    """A policy of this package, for POGEMA's environment with `observation_type="MAPF"`.

    An environment of this package runs the same episode in parallel, with the same actions, and the policy observes
    this environment. Every call of `act` checks that the agents' positions are the same in both environments, and takes
    over new goals.
    """

    def __init__(
        self, policy: PolicyFactory | str, *, collision_system: CollisionSystem, on_target: OnTarget, max_steps: int
    ) -> None:
        """Create the adapter. The keyword arguments must equal those of POGEMA's `GridConfig`.

        Args:
            policy: a name for `policy_factory`, or a policy factory; the policy must have cardinal actions.
            collision_system: how conflicting moves are resolved.
            on_target: what an agent does at its goal.
            max_steps: the episode's time limit, which POGEMA calls `max_episode_steps`.
        """
        self._factory = policy_factory(policy) if isinstance(policy, str) else policy
        self._keywords: dict[str, Any] = {
            "action_model": "cardinal",
            "collision_system": collision_system,
            "on_target": on_target,
            "max_steps": max_steps,
        }
        self._episode: tuple[AnyEnv, Policy] | None = None
        self._actions: dict[str, int] = {}

    def reset_states(self) -> None:
        """Forget the episode: called before each."""
        self._episode = None

    def act(self, observations: Sequence[Any]) -> list[int]:
        """Return an action for each of the N agents; agents that have disappeared wait.

        Raises:
            ValueError: the observations are not those of `observation_type="MAPF"`.
            RuntimeError: POGEMA's episode differs from the parallel one.
        """
        return self.act_at(*_parse(observations))

    def act_at(self, free: Bools, positions: Ints, goals: Ints) -> list[int]:
        """Return an action for each of the N agents, as `act`.

        Args:
            free: (H, W), the free cells of the map.
            positions: (N, 2), the agents' positions, [row, col].
            goals: (N, 2), their current goals.
        """
        if self._episode is None:
            # The next goal is unknown until the current one is reached; until then, the current goal is repeated.
            instance = Instance(Grid(free), Scenario(positions, np.repeat(goals[:, None], 2, axis=1)))
            env, policy = self._episode = self._factory(self._keywords | {"source": InstanceList([instance])})
            seen, infos = env.reset(seed=0)
            policy.reset_states()
        else:
            env, policy = self._episode
            if len(positions) != len(env.possible_agents) or not np.array_equal(free, env.grid):
                raise RuntimeError("another map or number of agents: expected reset_states() before each episode")
            cells = goals @ np.array([free.shape[1], 1])
            simulator_of(env).state.goals[0, :, 1:] = cells[:, None]  # agents that arrive in this step get these
            seen, _, _, _, infos = env.step(self._actions)
        self._check(env, positions, goals)
        self._actions = actions_of(policy, seen, infos)
        return [self._actions.get(agent, int(CardinalAction.WAIT)) for agent in env.possible_agents]

    def _check(self, env: AnyEnv, positions: Ints, goals: Ints) -> None:
        """Raise `RuntimeError` if the agents' positions or goals differ, or if the episode is over."""
        expected = ", ".join(f"{name}={value!r}" for name, value in self._keywords.items() if name != "action_model")
        for what, here, there in (("position", env.positions, positions), ("goal", env.goals, goals)):
            differ = (here != there).any(axis=1)
            if differ.any():
                agent = int(differ.argmax())
                raise RuntimeError(
                    f"step {env.step_count}: the {what} of agent {agent} is {there[agent].tolist()} in POGEMA, but "
                    f"{here[agent].tolist()} by these rules: expected POGEMA to have {expected}, to execute the "
                    "returned actions, and reset_states() before each episode"
                )
        if not env.agents:
            raise RuntimeError(f"step {env.step_count}: POGEMA's episode continues after its end: expected {expected}")


def _parse(observations: Sequence[Any]) -> tuple[Bools, Ints, Ints]:
    """Return the map (H, W), True for free cells, positions (N, 2) and goals (N, 2), without POGEMA's padding."""
    needed = ("obstacles", "global_obstacles", "global_xy", "global_target_xy")
    for seen in observations:
        if not isinstance(seen, Mapping) or not all(name in seen for name in needed):
            raise ValueError("expected observations of POGEMA's observation_type='MAPF'")
    radius = len(observations[0]["obstacles"]) // 2
    obstacles = np.asarray(observations[0]["global_obstacles"])[radius:-radius, radius:-radius]
    positions, goals = (np.array([seen[name] for seen in observations]) - radius for name in needed[2:])
    return obstacles == 0, positions, goals


class PogemaPolicy(Protocol):
    """A policy for POGEMA's environment: the protocol of its toolbox."""

    def act(self, observations: list[Any]) -> Sequence[int]:
        """Return an action for each agent."""
        ...

    def reset_states(self) -> None:
        """Forget the episode: called before each."""
        ...


class FromPogema:
    """A policy for POGEMA's environment, in an environment of this package with cardinal actions."""

    def __init__(
        self,
        policy: PogemaPolicy,
        env: MapfEnv | BaseParallelWrapper[str, Any, Any],
        obs_radius: int = 5,
        observation_type: ObservationType = "default",
        show_followers: bool = False,
    ) -> None:
        """Create the adapter.

        Args:
            policy: the policy, which acts for all agents at once.
            env: the environment in which it acts, or a wrapper of it.
            obs_radius: number of rows and columns that an agent observes in each direction.
            observation_type: POGEMA's name of the type of observations.
            show_followers: with `collision_system="soft"`, observations of POGEMA 1.4.0 omit an agent that has just
                entered the cell that an agent of a higher index left. True shows this agent, as POGEMA does since its
                pull request 51.

        Raises `ValueError` if the environment has another action model, or if a value is invalid.
        """
        self._policy = policy
        self._env = cast("MapfEnv", env.unwrapped)
        self._radius = obs_radius
        self._type = observation_type
        config = self._env.config
        self._show_followers = show_followers or config.collision_system != "soft"
        if config.action_model != "cardinal":
            raise ValueError(f"action_model={config.action_model!r}: POGEMA's actions are 'cardinal'")
        if obs_radius < 1:
            raise ValueError(f"obs_radius={obs_radius}: expected a number of cells of 1 or more")
        if observation_type not in get_args(ObservationType):
            allowed = ", ".join(map(repr, get_args(ObservationType)))
            raise ValueError(f"observation_type={observation_type!r}: expected one of {allowed}")
        self._starts = self._env.positions

    def reset_states(self) -> None:
        """Forget the episode: called before each."""
        self._policy.reset_states()

    def act(self, observations: dict[str, Any]) -> dict[str, int]:
        """Return an action for each agent in `observations`, the values of which are ignored."""
        actions = dict(zip(self._env.possible_agents, map(int, self._policy.act(self.observe())), strict=True))
        return {agent: actions[agent] for agent in observations}

    def observe(self) -> list[Any]:
        """Return the observations of POGEMA 1.4.0 for each of the N agents, with `r = obs_radius`.

        `default`: (3, 2r + 1, 2r + 1) float32: obstacles, agents, and the goal, projected to the border if it is
        outside. `POMAPF`: a dictionary with the first two, and with the position and goal, [row, col] relative to the
        agent's start. `MAPF`: in addition the map (H + 2r, W + 2r) float64, the position and the goal, all padded by
        `r`; the map is surrounded by a ring of obstacles.
        """
        radius, positions, goals = self._radius, self._env.positions, self._env.goals
        if self._env.step_count == 0:
            self._starts = positions
        ring = np.pad(~self._env.grid, 1, constant_values=True)
        obstacles = np.pad(ring, radius - 1).astype(np.float64)
        agents = np.zeros_like(obstacles)
        agents[tuple((positions + radius)[self._shown()].T)] = 1
        size = 2 * radius + 1
        windows = sliding_window_view(np.stack([obstacles, agents]), (size, size), axis=(1, 2))
        views = windows[:, positions[:, 0], positions[:, 1]].astype(np.float32)
        if self._type == "default":
            return [np.stack([*views[:, i], self._goal_plane(goals[i] - positions[i])]) for i in range(len(goals))]
        seen: list[Any] = []
        for i, (start, position, goal) in enumerate(zip(self._starts, positions, goals, strict=True)):
            own = {"xy": position - start, "target_xy": goal - start}
            if self._type == "MAPF":
                own |= {"global_xy": position + radius, "global_target_xy": goal + radius}
            planes = {"obstacles": views[0, i], "agents": views[1, i]}
            seen.append(planes | {name: tuple(cell.tolist()) for name, cell in own.items()})
            if self._type == "MAPF":
                seen[-1]["global_obstacles"] = obstacles
        return seen

    def _goal_plane(self, offset: Ints) -> Floats:
        plane = np.zeros((2 * self._radius + 1,) * 2, np.float32)
        plane[tuple(np.clip(offset, -self._radius, self._radius) + self._radius)] = 1
        return plane

    def _shown(self) -> Bools:
        """Return (N,) bool: which agents are visible to others."""
        agents = self._env.simulator.agents[0]
        if self._show_followers:
            return agents["active"]
        # POGEMA moves agents sequentially: a cell is cleared after an agent with a lower index has entered it.
        entered = (agents["cell"][:, None] == agents["was_cell"]) & agents["was_active"]
        return agents["active"] & ~np.triu(entered, 1).any(axis=1)


def pogema_policy(policy: PogemaPolicy, **options: Any) -> PolicyFactory:
    """Return a factory for a policy of POGEMA, for `evaluate`. The options are those of `FromPogema`."""
    return PogemaFactory(policy, options)


@dataclass(frozen=True)
class PogemaFactory:
    """Makes the environment for a policy of POGEMA."""

    policy: PogemaPolicy
    """The policy."""
    options: dict[str, Any]
    """Options of `FromPogema`."""

    @property
    def identity(self) -> dict[str, Any] | None:
        """What the policy states as its identity, and the options; None if it states nothing."""
        stated = getattr(self.policy, "identity", None)
        return None if stated is None else {"policy": "of POGEMA", "identity": stated, "options": self.options}

    def __call__(self, keywords: dict[str, Any]) -> tuple[AnyEnv, Policy]:
        """Return the environment and the policy."""
        given: dict[str, Any] = {"action_model": "cardinal"} | Planner.env_kwargs | keywords
        env = MapfEnv(EnvConfig(**given))
        return env, FromPogema(self.policy, env, **self.options)
