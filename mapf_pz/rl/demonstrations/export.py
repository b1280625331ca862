"""Export demonstrations with observations as memory-mapped TensorDicts, for TorchRL."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs.utils import step_mdp

from mapf_pz.instances.instance import Instance
from mapf_pz.rl.demonstrations import Dataset
from mapf_pz.rl.demonstrations.dataset import ReplaySource, replay_config
from mapf_pz.rl.environments.batched_env import BatchedMapfEnv

_OF_AGENTS = ("observation", "action_mask", "at_goal", "arrivals", "active", "position", "action")
KEYS = (
    *(("agents", name) for name in _OF_AGENTS),
    *(("next", "agents", "reward"), ("next", "done"), ("next", "terminated"), ("next", "truncated")),
)
"""The entries of `BatchedMapfEnv` that are exported."""
EPISODE = "episode"
"""The entry that numbers the demonstrations, which `SliceSampler` needs to sample parts of episodes."""
NUM_ENVS = 32
"""Maximum number of environments that are stepped together."""


def export_demonstrations(
    demonstrations: Dataset, folder: str | Path, env: Mapping[str, Any] | None = None
) -> dict[int, TensorDictBase]:
    """Replay demonstrations, and write their steps to memory-mapped TensorDicts, one for each number of agents.

    A TensorDict of S steps has the entries of `BatchedMapfEnv` before each step and the actions, each (S, N, ...); in
    `next`, the rewards, `done`, `terminated` and `truncated`; and `episode` (S,) int64, which numbers the
    demonstrations. The steps of a demonstration are in order. Next observations are not stored: they are those of the
    next step.

    Args:
        demonstrations: a dataset.
        folder: a folder that does not exist; its subfolder `agents-N` is for `TensorDict.load_memmap`.
        env: keywords of an environment, for the observations and the reward.

    Raises:
        FileExistsError: the folder exists.
        ValueError: there are no demonstrations, a keyword is invalid, or the demonstrations were made with other rules.
    """
    if not len(demonstrations):
        raise ValueError("expected at least one demonstration, got none")
    folder = Path(folder)
    folder.mkdir(parents=True)
    by_agents: dict[int, list[Dataset]] = {}
    for group in demonstrations.groups():
        by_agents.setdefault(group[0].num_agents, []).append(group)
    return {n: _export(groups, folder / f"agents-{n}", env or {}) for n, groups in by_agents.items()}


def _export(groups: Sequence[Dataset], folder: Path, env: Mapping[str, Any]) -> TensorDictBase:
    """Write the demonstrations of groups with the same number of agents."""
    replayed = _replay_all(groups, env)
    first_rows, first = next(replayed)
    num_steps = sum(int(group.num_steps.sum()) for group in groups)
    exported = cast("TensorDictBase", first[:1].expand(num_steps)).memmap_like(str(folder))
    for rows, steps in chain([(first_rows, first)], replayed):
        exported[rows] = steps
    return exported


def _replay_all(groups: Sequence[Dataset], env: Mapping[str, Any]) -> Iterator[tuple[Tensor, TensorDictBase]]:
    """Yield steps of all groups, and their numbers if all steps are in order."""
    row = episode = 0
    for group in groups:
        for rows, steps in _replay(group, env):
            steps[EPISODE] += episode
            yield row + rows, steps
        row, episode = row + int(group.num_steps.sum()), episode + len(group)


def _replay(group: Dataset, env: Mapping[str, Any]) -> Iterator[tuple[Tensor, TensorDictBase]]:
    """Yield steps of demonstrations of the same size, and their numbers if all steps are in order."""
    num_envs = min(NUM_ENVS, len(group))
    envs = BatchedMapfEnv(num_envs=num_envs, **replay_config(group.rules, env, _InOrder(group)).keywords())
    actions = np.concatenate([demonstration.actions for demonstration in group]).astype(np.int64)
    ends = np.cumsum(group.num_steps)
    starts = ends - group.num_steps
    numbers, rows = np.arange(num_envs), starts[:num_envs].copy()
    state = envs.reset()
    while len(kept := np.flatnonzero(numbers < len(group))):
        state["agents", "action"] = torch.from_numpy(actions[np.minimum(rows, len(actions) - 1)])
        state = envs.step(state)
        steps = state.select(*KEYS)[kept]
        steps[EPISODE] = torch.from_numpy(numbers[kept])
        yield torch.from_numpy(rows[kept]), steps
        rows += 1
        finished = kept[rows[kept] == ends[numbers[kept]]]
        state = step_mdp(state)
        if len(finished):
            numbers[finished] = numbers.max() + 1 + np.arange(len(finished))
            rows[finished] = starts[np.minimum(numbers[finished], len(group) - 1)]
            chosen = torch.zeros(num_envs, 1, dtype=torch.bool)
            chosen[finished] = True
            state = envs.reset(state.set("_reset", chosen))


class _InOrder(ReplaySource):
    """The instances of demonstrations in order; after the last one, it is repeated."""

    def __init__(self, demonstrations: Dataset) -> None:
        super().__init__(demonstrations)
        self._next = 0

    def sample(self, rng: np.random.Generator) -> Instance:
        number = min(self._next, len(self.demonstrations) - 1)
        self._next += 1
        return self.demonstrations[number].instance
