"""POGEMA and back: policies of this package act in POGEMA's environment, and POGEMA's policies in this package's.

Neither way needs POGEMA itself. Source: POGEMA 1.4.0, github.com/Cognitive-AI-Systems/pogema, and the protocol of its
toolbox: `act(observations) -> actions`, lists with an item for each agent, and `reset_states()` before each episode.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, Literal, Protocol, cast, get_args

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from pettingzoo.utils import BaseParallelWrapper

from mapf_pz.actions import CardinalAction
from mapf_pz.arrays import Bools, Floats, Ints
from mapf_pz.config import CollisionSystem, OnTarget
from mapf_pz.environment import MapfEnv, parallel_env
from mapf_pz.evaluation.policies import policy_factory
from mapf_pz.evaluation.rollout import AnyEnv, Policy, PolicyFactory, simulator_of
from mapf_pz.instance import Grid, Instance, Scenario
from mapf_pz.instances import InstanceList
from mapf_pz.planners import Planner

ObservationType = Literal["default", "POMAPF", "MAPF"]


class InPogema:
    """A policy of this package, for POGEMA's environment with `observation_type="MAPF"`.

    An environment of ours plays the same episode beside POGEMA's, with the same actions; the policy sees that one, and
    so all that it must see. Every `act` checks that the agents are where POGEMA says, and takes over new goals.
    """

    def __init__(
        self, policy: PolicyFactory | str, *, collision_system: CollisionSystem, on_target: OnTarget, max_steps: int
    ) -> None:
        """Prepare for episodes; the keywords are those of POGEMA's `GridConfig`, or its `max_episode_steps`.

        Args:
            policy: a name that `policy_factory` knows, what it returns, or `factory_for(...)`; it has cardinal actions.
            collision_system: how conflicting moves are settled.
            on_target: what an agent does at its goal.
            max_steps: the episodes' time limit.
        """
        self._factory = policy_factory(policy) if isinstance(policy, str) else policy
        self._keywords: dict[str, Any] = {
            "action_model": "cardinal",
            "collision_system": collision_system,
            "on_target": on_target,
            "max_steps": max_steps,
        }
        self._playing: tuple[AnyEnv, Policy] | None = None
        self._actions: dict[str, int] = {}

    def reset_states(self) -> None:
        """Forget the episode: called before each."""
        self._playing = None

    def act(self, observations: Sequence[Any]) -> list[int]:
        """Return an action for each of the N agents; those that have disappeared wait.

        Raises:
            ValueError: The observations are not those of `observation_type="MAPF"`.
            RuntimeError: POGEMA's episode is another than the one played beside it.
        """
        free, positions, goals = _parse(observations)
        if self._playing is None:
            # The next goal is not known before the present one is reached; until then it stands for all later ones.
            instance = Instance(Grid(free), Scenario(positions, np.repeat(goals[:, None], 2, axis=1)))
            env, policy = self._playing = self._factory(self._keywords | {"source": InstanceList([instance])})
            seen, _ = env.reset(seed=0)
            policy.reset_states()
        else:
            env, policy = self._playing
            if len(positions) != len(env.possible_agents) or not np.array_equal(free, env.grid):
                raise RuntimeError("another map or number of agents: expected reset_states() before each episode")
            cells = goals @ np.array([free.shape[1], 1])
            simulator_of(env).state.goals[0, :, 1:] = cells[:, None]  # agents that arrive in this step get these
            seen = env.step(self._actions)[0]
        self._check(env, positions, goals)
        self._actions = policy.act(seen)
        return [self._actions.get(agent, int(CardinalAction.WAIT)) for agent in env.possible_agents]

    def _check(self, env: AnyEnv, positions: Ints, goals: Ints) -> None:
        """Raise `RuntimeError` unless the agents' positions and goals are these, and the episode goes on."""
        expected = ", ".join(f"{name}={value!r}" for name, value in self._keywords.items() if name != "action_model")
        for what, here, there in (("position", env.positions, positions), ("goal", env.goals, goals)):
            differ = (here != there).any(axis=1)
            if differ.any():
                agent = int(differ.argmax())
                raise RuntimeError(
                    f"step {env.step_count}: the {what} of agent {agent} is {there[agent].tolist()} in POGEMA, and "
                    f"{here[agent].tolist()} by these rules: expected POGEMA to have {expected}, to take the actions "
                    "that it is given, and reset_states() before each episode"
                )
        if not env.agents:
            raise RuntimeError(f"step {env.step_count}: POGEMA's episode goes on after its end: expected {expected}")


def _parse(observations: Sequence[Any]) -> tuple[Bools, Ints, Ints]:
    """Return the map (H, W), True where a cell is free, positions (N, 2) and goals (N, 2), without POGEMA's padding."""
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
    """A policy for POGEMA's environment, in an environment of ours with cardinal actions."""

    def __init__(
        self,
        policy: PogemaPolicy,
        env: MapfEnv | BaseParallelWrapper[str, Any, Any],
        obs_radius: int = 5,
        observation_type: ObservationType = "default",
        show_followers: bool = False,
    ) -> None:
        """Bind the policy to the environment in which it acts.

        Args:
            policy: acts for all agents at once.
            env: the environment, or a wrapper of it.
            obs_radius: how many rows and columns away from an agent it sees.
            observation_type: POGEMA's name of what is observed.
            show_followers: with `collision_system="soft"`, POGEMA 1.4.0 shows nobody an agent that has just entered the
                cell which one of a higher index left; True shows it, as POGEMA does since its pull request 51.

        Raises `ValueError` where the environment's actions are others, or a value is not allowed.
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
            raise ValueError(f"obs_radius={obs_radius}: expected a number of cells, 1 or more")
        if observation_type not in get_args(ObservationType):
            allowed = ", ".join(map(repr, get_args(ObservationType)))
            raise ValueError(f"observation_type={observation_type!r}: expected one of {allowed}")
        self._starts = self._env.positions

    def reset_states(self) -> None:
        """Forget the episode: called before each."""
        self._policy.reset_states()

    def act(self, observations: dict[str, Any]) -> dict[str, int]:
        """Return an action for each agent that observes; what they observe here is not looked at."""
        actions = dict(zip(self._env.possible_agents, map(int, self._policy.act(self.observe())), strict=True))
        return {agent: actions[agent] for agent in observations}

    def observe(self) -> list[Any]:
        """Return what POGEMA 1.4.0 shows each of the N agents, with `r = obs_radius`.

        `default`: (3, 2r + 1, 2r + 1) float32: obstacles, agents, and the goal, moved to the edge if it is outside.
        `POMAPF`: a dictionary of the first two, and position and goal, [row, col] from the agent's start. `MAPF`: also
        the map (H + 2r, W + 2r) float64, position and goal, all padded by `r`: around the map is a ring of obstacles.
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
            seen.append(planes | {name: tuple(place.tolist()) for name, place in own.items()})
            if self._type == "MAPF":
                seen[-1]["global_obstacles"] = obstacles
        return seen

    def _goal_plane(self, offset: Ints) -> Floats:
        plane = np.zeros((2 * self._radius + 1,) * 2, np.float32)
        plane[tuple(np.clip(offset, -self._radius, self._radius) + self._radius)] = 1
        return plane

    def _shown(self) -> Bools:
        """Return (N,) bool: which agents others see."""
        agents = self._env.simulator.state.agents[0]
        if self._show_followers:
            return agents["active"]
        # POGEMA moves one after the other: it frees the cell an agent leaves after a lower index has entered it.
        entered = (agents["cell"][:, None] == agents["was_cell"]) & agents["was_active"]
        return agents["active"] & ~np.triu(entered, 1).any(axis=1)


def pogema_policy(policy: PogemaPolicy, **options: Any) -> PolicyFactory:
    """Return what makes the environment for a policy of POGEMA's, for `evaluate`; options as in `FromPogema`."""
    return partial(_make, policy, options)


def _make(policy: PogemaPolicy, options: dict[str, Any], keywords: dict[str, Any]) -> tuple[AnyEnv, Policy]:
    env = parallel_env(**({"action_model": "cardinal"} | Planner.env_kwargs | keywords))
    return env, FromPogema(policy, env, **options)
