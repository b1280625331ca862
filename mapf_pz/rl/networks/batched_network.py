"""A policy's network for several episodes at the same time, what it reads of them, and what is kept of each."""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

MIN_ROWS = 16
"""Minimum number of rows of matrix products: inputs are padded with zeros.

Products of few rows are computed by other routines, whose rounding errors differ: of less than 4 rows on some
processors, of less than 16 on others (MKL with AVX-512). With more rows, a row of the result does not depend on the
others, to the bit, unless the last hidden layer has an odd width.
"""


class Seen(NamedTuple):
    """What the agents of several episodes observe in a step: R rows, those of the first episode first."""

    counts: Sequence[int]
    """Number of agents of each episode; R is their sum."""
    agents: Sequence[Hashable]
    """(R,): the agents' names or numbers."""
    image: Tensor
    """(R, K, h, w) float32."""
    features: Tensor | None = None
    """(R, F) float32, if features are observed."""
    mask: Tensor | None = None
    """(R, A) int8: 1 for actions that are allowed. None: all are allowed."""
    noise: Tensor | None = None
    """(R, A) float32, from the exponential distribution: what a network that samples samples by."""


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

    def __call__(self, seen: Seen, memories: Sequence[Memory]) -> tuple[Tensor, ...]:
        """Return the network's outputs (R, A), and update the hidden states.

        Args:
            seen: what the agents of E episodes observe.
            memories: (E,): what is kept during each of these episodes.
        """
        if not self._in_teams:
            return self._run(seen, memories, 1)
        sizes = set(seen.counts)
        if len(sizes) == 1:
            return self._run(seen, memories, sizes.pop())
        # Teams of different sizes cannot be one tensor.
        counts = torch.tensor(seen.counts)
        row_sizes = counts.repeat_interleave(counts)
        outputs: tuple[Tensor, ...] = ()
        for size in sizes:
            rows = (row_sizes == size).nonzero().flatten()
            kept = [memory for memory, count in zip(memories, seen.counts, strict=True) if count == size]
            found = self._run(_with_size(seen, rows, size), kept, size)
            outputs = outputs or tuple(part.new_empty(len(row_sizes), part.shape[-1]) for part in found)
            for output, part in zip(outputs, found, strict=True):
                output[rows] = part
        return outputs

    def _run(self, seen: Seen, memories: Sequence[Memory], size: int) -> tuple[Tensor, ...]:
        """Return the outputs for agents that act in teams of `size`."""
        rows = 1 if self._stacks else size  # of a team in the network's input
        num_teams = math.ceil(MIN_ROWS / rows)
        inputs = [_teams(part, size, num_teams) for part in (seen.image, seen.features, seen.noise) if part is not None]
        if self._stacks:
            inputs = [part.flatten(1, 2) for part in inputs]
        outputs = self._run_recurrent(inputs, seen, memories, rows) if self._recurrent else self._network(*inputs)
        return tuple(output.flatten(0, 1)[: len(seen.image)] for output in outputs)

    def _run_recurrent(
        self, inputs: list[Tensor], seen: Seen, memories: Sequence[Memory], rows: int
    ) -> tuple[Tensor, ...]:
        """Return the outputs for `inputs`, teams that are so many rows each, and update the hidden states."""
        if self._stacks:
            owners = [(memory, "team") for memory in memories]
        else:
            agents = iter(seen.agents)
            owners = [
                (memory, next(agents))
                for memory, count in zip(memories, seen.counts, strict=True)
                for _ in range(count)
            ]
        first = torch.zeros(self._recurrent)
        before = torch.stack([memory.hidden_states.get(key, first) for memory, key in owners])
        hidden_states = _teams(before, rows, len(inputs[0]))
        # Initial hidden states are zero already, so no step needs to be marked as the first.
        is_init = torch.zeros(len(hidden_states), 1, dtype=torch.bool)
        *outputs, after = self._network(hidden_states, is_init, *inputs)
        for (memory, key), state in zip(owners, after.flatten(0, 1), strict=False):  # others are of padding
            memory.hidden_states[key] = state
        return tuple(outputs)


def _with_size(seen: Seen, rows: Tensor, size: int) -> Seen:
    """Return the observations of some rows, which are episodes with `size` agents."""
    agents = [seen.agents[row] for row in rows.tolist()]
    features, noise = (None if part is None else part[rows] for part in (seen.features, seen.noise))
    return Seen([size] * (len(rows) // size), agents, seen.image[rows], features, noise=noise)


def _teams(rows: Tensor, size: int, least: int) -> Tensor:
    """Return rows (R, ...) as B teams (B, size, ...), with teams of zeros up to B = `least`."""
    missing = least * size - len(rows)
    if missing > 0:
        rows = torch.cat([rows, rows.new_zeros(missing, *rows.shape[1:])])
    return rows.unflatten(0, (-1, size))
