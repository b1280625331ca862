"""Replay demonstrations: B of them at a time, each of which is followed by another one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mapf_pz._internal.arrays import Bools, Floats, Ints
from mapf_pz.instances.instance import Instance, InstanceSource
from mapf_pz.rl.demonstrations.config import RULES
from mapf_pz.simulator.config import EnvConfig
from mapf_pz.simulator.simulator import Simulator

if TYPE_CHECKING:
    from mapf_pz.rl.demonstrations.dataset import Dataset

_ALIKE = ("action_model", "collision_system", "on_target")
"""Rules that any other environment would break."""
_INSTANCE = ("map", "scenario", "source", "num_agents", "goals", "initial_heading", "max_steps", "render_mode")
"""Keywords that do not matter, since the demonstrations determine the instances."""


class Batch(NamedTuple):
    """One step of B demonstrations of N agents; the arrays are the caller's own."""

    image: Floats  # (B, N, *image_shape) float32: observations, as in `Simulator.observe`
    features: Floats  # (B, N, num_features) float32
    action_mask: Ints  # (B, N, A) int8
    actions: Ints  # (B, N) int64: the actions in this step
    active: Bools  # (B, N): False for agents that have disappeared
    at_goal: Bools  # (B, N): whether the last step ended on the agent's goal
    is_first: Bools  # (B,): whether this is the first step of a demonstration


def replay_config(rules: EnvConfig, env: Mapping[str, Any], source: InstanceSource) -> EnvConfig:
    """Return the environment with the observations of `env`, and the rules and instances of demonstrations.

    Raises `ValueError` if the keywords `env` require other rules.
    """
    fixed = {name: getattr(rules, name) for name in RULES if name != "edge_weights"}
    for name in _ALIKE:
        if env.get(name, fixed[name]) != fixed[name]:
            raise ValueError(f"{name}={env[name]!r}: the demonstrations have {name}={fixed[name]!r}")
    observed = {name: value for name, value in env.items() if name not in _INSTANCE}
    return EnvConfig.from_keywords(**({"edge_weights": rules.edge_weights} | observed | fixed | {"source": source}))


class ReplaySource:
    """Samples the instance of one of several demonstrations with the same map size and number of agents."""

    def __init__(self, demonstrations: Dataset) -> None:
        """Take at least one demonstration."""
        self.demonstrations = demonstrations
        """The demonstrations."""
        first, grids = demonstrations[0].instance, demonstrations.grids()
        self.shape = first.grid.shape
        """(H, W) of every map."""
        self.num_agents = first.num_agents
        """N, the number of agents."""
        self.grid = grids[0] if len(grids) == 1 else None
        """The map, if all demonstrations share it, otherwise None."""

    def sample(self, rng: np.random.Generator) -> Instance:
        """Sample one of the instances."""
        return self.demonstrations[int(rng.integers(len(self.demonstrations)))].instance


class Replay:
    """Replays demonstrations with the same map size and number of agents in B environments, without end."""

    def __init__(
        self, demonstrations: Dataset, env: Mapping[str, Any], num_envs: int, rng: np.random.Generator, num_threads: int
    ) -> None:
        """Start B demonstrations; raises `ValueError` as `Dataset.batches`."""
        self._demonstrations = demonstrations
        self._rng = rng
        self._left: list[int] = []
        config = replay_config(demonstrations.rules, env, ReplaySource(demonstrations))
        self._simulator = Simulator(config, num_envs, num_threads)
        self._lengths = np.zeros(num_envs, np.int64)
        longest = int(demonstrations.num_steps.max())
        self._actions = np.zeros((longest, num_envs, self._simulator.num_agents), np.int64)
        self._start(range(num_envs))

    def step(self) -> Batch:
        """Return the current step of all demonstrations, and take it; finished ones are followed by others."""
        simulator = self._simulator
        steps = simulator.steps
        actions = self._actions[steps, np.arange(simulator.num_envs)]
        active, at_goal = simulator.agents["active"].copy(), simulator.agents["at_goal"].copy()
        batch = Batch(*simulator.observe(), actions, active, at_goal, steps == 0)
        simulator.step(actions)
        finished = np.flatnonzero(simulator.steps == self._lengths)
        if len(finished):
            self._start(finished.tolist())
        return batch

    def _start(self, envs: Sequence[int]) -> None:
        """Start the next demonstrations in the environments `envs`."""
        chosen = {b: self._demonstrations[self._next()] for b in envs}
        instances = {b: demonstration.instance for b, demonstration in chosen.items()}
        self._simulator.reset(envs, {b: demonstration.seed for b, demonstration in chosen.items()}, instances)
        for b, demonstration in chosen.items():
            self._lengths[b] = demonstration.num_steps
            self._actions[: demonstration.num_steps, b] = demonstration.actions

    def _next(self) -> int:
        """Return the next demonstration in a random order, and start over after the last one."""
        if not self._left:
            self._left = self._rng.permutation(len(self._demonstrations)).tolist()
        return self._left.pop()
