"""A policy's network for several episodes at the same time, what it reads of each, and what is kept of each."""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

MIN_ROWS = 8
"""Minimum number of rows of matrix products: inputs are padded with zeros.

Products of less than 4 rows are computed by other routines, whose rounding errors differ. From 4 rows on, a row of the
result does not depend on the others, to the bit, unless the last hidden layer has an odd width.
"""


class Seen(NamedTuple):
    """What the n agents of an episode observe in a step."""

    agents: Sequence[Hashable]
    """Their names or numbers."""
    image: Tensor
    """(n, K, h, w) float32."""
    features: Tensor | None = None
    """(n, F) float32, if features are observed."""
    mask: Tensor | None = None
    """(n, A) int8: 1 for actions that are allowed. None: all are allowed."""


class Memory:
    """What a policy keeps during an episode: random generators, and the hidden states of a recurrent network."""

    def __init__(self, seed: int) -> None:
        """Begin an episode: the generators have the random seed `seed`, and there are no hidden states."""
        self.generator = torch.Generator().manual_seed(seed)
        self.rng = np.random.default_rng(seed)
        self.hidden_states: dict[Hashable, Tensor] = {}


class BatchedNetwork:
    """An actor's network, which acts for the agents of several episodes in one call.

    An episode's outputs are the same to the bit in any batch: see `MIN_ROWS`.
    """

    def __init__(self, network: nn.Module, communicates: bool, num_agents: int | None, recurrent: int) -> None:
        """Wrap a network.

        Args:
            network: the network.
            communicates: whether its agents communicate, so that it expects observations (B, N, ...).
            num_agents: the number of agents N that it stacks, so that it expects observations (B, N * K, h, w) and
                (B, N * F). None: it does not stack agents.
            recurrent: size of its hidden states; 0: it has none.
        """
        self._network = network
        self._in_teams = communicates or num_agents is not None
        self._stacks = num_agents is not None
        self._recurrent = recurrent

    def __call__(self, episodes: Sequence[Seen], memories: Sequence[Memory]) -> list[tuple[Tensor, ...]]:
        """Return the network's outputs (n, A) for the agents of each episode, and update the hidden states.

        Args:
            episodes: what the agents of each episode observe.
            memories: what is kept during each of these episodes.
        """
        if not self._in_teams:
            return self._run(episodes, memories, 1)
        outputs: dict[int, tuple[Tensor, ...]] = {}
        for size in {len(seen.agents) for seen in episodes}:  # teams of different sizes cannot be one tensor
            chosen = [k for k, seen in enumerate(episodes) if len(seen.agents) == size]
            found = self._run([episodes[k] for k in chosen], [memories[k] for k in chosen], size)
            outputs.update(zip(chosen, found, strict=True))
        return [outputs[k] for k in range(len(episodes))]

    def _run(self, episodes: Sequence[Seen], memories: Sequence[Memory], size: int) -> list[tuple[Tensor, ...]]:
        """Return the outputs for episodes whose agents act in teams of `size`."""
        rows = 1 if self._stacks else size  # of a team in the network's input
        num_teams = math.ceil(MIN_ROWS / rows)
        observed = [seen.image for seen in episodes], [seen.features for seen in episodes if seen.features is not None]
        inputs = [_teams(parts, size, num_teams) for parts in observed if parts]
        if self._stacks:
            inputs = [part.flatten(1, 2) for part in inputs]
        if self._recurrent:
            names = [("team",) if self._stacks else seen.agents for seen in episodes]
            before = [_hidden_states(*pair, self._recurrent) for pair in zip(memories, names, strict=True)]
            hidden_states = _teams(before, rows, num_teams)
            # Initial hidden states are zero already, so no step needs to be marked as the first.
            is_init = torch.zeros(len(hidden_states), 1, dtype=torch.bool)
            *outputs, hidden_states = self._network(hidden_states, is_init, *inputs)
            for memory, keys, after in zip(memories, names, _split(hidden_states, list(map(len, names))), strict=True):
                memory.hidden_states.update(zip(keys, after, strict=True))
        else:
            outputs = self._network(*inputs)
        counts = [len(seen.agents) for seen in episodes]
        return list(zip(*(_split(output, counts) for output in outputs), strict=True))


def _teams(parts: Sequence[Tensor], size: int, least: int) -> Tensor:
    """Return the rows (n, ...) of all parts as B teams (B, size, ...), with teams of zeros up to B = `least`."""
    rows = torch.cat(list(parts))
    missing = least * size - len(rows)
    if missing > 0:
        rows = torch.cat([rows, rows.new_zeros(missing, *rows.shape[1:])])
    return rows.unflatten(0, (-1, size))


def _split(teams: Tensor, counts: list[int]) -> tuple[Tensor, ...]:
    """Return the first rows of teams (B, size, ...) as parts of the lengths `counts`."""
    return teams.flatten(0, 1)[: sum(counts)].split(counts)


def _hidden_states(memory: Memory, keys: Sequence[Hashable], size: int) -> Tensor:
    """Return the hidden states (len(keys), size) in the memory; at first they are zero."""
    return torch.stack([memory.hidden_states.get(key, torch.zeros(size)) for key in keys])
