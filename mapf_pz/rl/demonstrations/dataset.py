"""Load a dataset, and replay its demonstrations."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from mapf_pz._internal.arrays import Bools, Floats, Ints
from mapf_pz.instances.instance import Grid, Instance, InstanceSource
from mapf_pz.rl.demonstrations.config import RULES
from mapf_pz.rl.demonstrations.demonstration import Demonstration
from mapf_pz.rl.demonstrations.folder import read_rules, shard_files
from mapf_pz.rl.demonstrations.shard import Shard, read_shard
from mapf_pz.simulator.config import EnvConfig
from mapf_pz.simulator.simulator import Simulator

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
    keywords: dict[str, Any] = {"edge_weights": rules.edge_weights} | observed | fixed | {"source": source}
    return EnvConfig(**keywords)


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


def load_dataset(folder: str | Path) -> Dataset:
    """Load the demonstrations in the finished shards of a dataset.

    Raises:
        FileNotFoundError: the folder contains no dataset, or none of its shards is finished.
        FormatError: a file is malformed.
    """
    folder = Path(folder)
    rules, files = read_rules(folder), shard_files(folder)
    if not files:
        raise FileNotFoundError(f"{folder}: expected at least one finished shard of the dataset, got none")
    grids: dict[tuple[bytes, str], Grid] = {}
    shards: list[Shard] = []
    for file in files:
        shard = read_shard(file, rules.action_model)
        # Demonstrations on the same map share it, also with those in other files.
        shared = tuple(grids.setdefault((grid.free.tobytes(), grid.name), grid) for grid in shard.grids)
        shards.append(replace(shard, grids=shared))
    return Dataset(rules, shards)


NOTHING: Mapping[str, Any] = MappingProxyType({})
"""No keywords: the default observations."""


class Dataset:
    """Demonstrations with the same rules, numbered from 0, which can be replayed with any observations.

    Methods that replay them take keywords of an environment, which determine the observations and the reward.
    Instances, numbers of agents and `max_steps` are those of the demonstrations. They raise `ValueError` if the
    keywords require another `action_model`, `collision_system` or `on_target`.
    """

    def __init__(self, rules: EnvConfig, shards: Sequence[Shard], numbers: Ints | None = None) -> None:
        """Create a dataset.

        Args:
            rules: the environment, without the instances.
            shards: demonstrations that were made with these rules.
            numbers: (K,), the numbers of those demonstrations of all shards that it consists of. None: all.
        """
        self.rules = rules
        """The environment of the demonstrations, without the instances."""
        self._shards = shards
        self._firsts = np.cumsum([0, *map(len, shards)])  # the number of the first demonstration of each shard
        self._numbers = np.arange(self._firsts[-1]) if numbers is None else numbers

    def __len__(self) -> int:
        """Return K, the number of demonstrations."""
        return len(self._numbers)

    def __getitem__(self, index: int) -> Demonstration:
        """Return a demonstration; raises `IndexError` if there are fewer."""
        number = self._numbers[index]
        shard = np.searchsorted(self._firsts, number, side="right") - 1
        return self._shards[shard].demonstration(number - self._firsts[shard])

    def __iter__(self) -> Iterator[Demonstration]:
        """Yield all demonstrations."""
        return map(self.__getitem__, range(len(self)))

    @property
    def num_steps(self) -> Ints:
        """(K,) int64: the number of steps of each demonstration."""
        return self._sizes()[:, 3]

    @property
    def num_agent_steps(self) -> int:
        """Number of actions of all agents in all demonstrations."""
        return int(self._sizes()[:, 2:].prod(axis=1).sum())

    def grids(self) -> list[Grid]:
        """Return the different maps; demonstrations on the same map have the same object."""
        found: dict[int, Grid] = {}
        for first, shard in zip(self._firsts, self._shards, strict=False):
            numbers = self._numbers[(first <= self._numbers) & (self._numbers < first + len(shard))] - first
            found |= {id(shard.grids[k]): shard.grids[k] for k in np.unique(shard.grid[numbers]).tolist()}
        return list(found.values())

    def subset(self, indices: Ints) -> Dataset:
        """Return the dataset of the demonstrations with these numbers (M,), such as those for validation."""
        return Dataset(self.rules, self._shards, self._numbers[indices])

    def groups(self) -> list[Dataset]:
        """Return the datasets of the demonstrations with the same map size and number of agents."""
        sizes, group = np.unique(self._sizes()[:, :3], axis=0, return_inverse=True)
        return [self.subset(np.flatnonzero(group.reshape(-1) == k)) for k in range(len(sizes))]

    def replay(self, env: Mapping[str, Any] = NOTHING, num_threads: int = 1) -> Iterator[tuple[Simulator, Ints]]:
        """Yield each demonstration as a simulator at its start, and its actions (T, 1, N) int64 for `Simulator.step`.

        Args:
            env: keywords of an environment, for the observations and the reward.
            num_threads: number of threads of the kernels.
        """
        simulators: dict[object, Simulator] = {}
        for group in self.groups():
            simulator = Simulator(replay_config(self.rules, env, ReplaySource(group)), num_threads=num_threads)
            simulators[simulator.shape, simulator.num_agents] = simulator
        for demonstration in self:
            simulator = simulators[demonstration.instance.grid.shape, demonstration.num_agents]
            simulator.reset(seeds={0: demonstration.seed}, instances={0: demonstration.instance})
            yield simulator, demonstration.actions[:, None].astype(np.int64)

    def batches(
        self, env: Mapping[str, Any] = NOTHING, num_envs: int = 32, seed: int = 0, num_threads: int = 1
    ) -> Iterator[Batch]:
        """Return an iterator over single steps of B demonstrations, without end; the order of demonstrations is random.

        The demonstrations of a batch have the same map size and number of agents; these are sampled for each batch, in
        proportion to the number of steps.

        Args:
            env: keywords of an environment, for the observations and the reward.
            num_envs: B, the number of environments that are stepped together.
            seed: random seed.
            num_threads: number of threads of the kernels.

        Raises:
            ValueError: there are no demonstrations, or the keywords are invalid.
        """
        groups = self.groups()
        if not groups:
            raise ValueError("expected at least one demonstration, got none")
        rng = np.random.default_rng(seed)
        replays = [Replay(group, env, num_envs, rng.spawn(1)[0], num_threads) for group in groups]
        return _alternating(replays, np.cumsum([group.num_steps.sum() for group in groups]), rng)

    def _sizes(self) -> Ints:
        """Return the map size, number of agents and number of steps of each demonstration: (K, 4) int64, H, W, N, T."""
        return np.concatenate([np.zeros((0, 4), np.int64), *(shard.sizes() for shard in self._shards)])[self._numbers]


def _alternating(replays: Sequence[Replay], ends: Ints, rng: np.random.Generator) -> Iterator[Batch]:
    """Yield steps of sampled replays; `ends` are the sums of the first 1, 2, ... replays' numbers of steps."""
    while True:
        yield replays[int(np.searchsorted(ends, rng.integers(ends[-1]), side="right"))].step()
