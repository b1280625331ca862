"""Data-parallel training: several processes, the ranks, divide each batch and average their gradients.

torch.distributed connects them; `mapf_pz.rl.training.launch` starts them.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TypeVar

import torch
import torch.distributed as dist
from torch import Tensor
from torch.nn.utils import parameters_to_vector, vector_to_parameters

Value = TypeVar("Value")


@dataclass(frozen=True)
class Ranks:
    """This process among those that train together; by default, it is the only one."""

    rank: int = 0
    """Number of this process, from 0."""
    size: int = 1
    """Number of processes."""

    def average(self, tensors: Sequence[Tensor]) -> None:
        """Replace float tensors by their means over the ranks, which are the same to the bit in all of them.

        Raises `ConnectionError` if another rank has ended, as do the other methods.
        """
        if self.size > 1 and tensors:
            flat = parameters_to_vector(tensors)
            with _connected():
                dist.all_reduce(flat)
            vector_to_parameters(flat / self.size, tensors)

    def from_first(self, value: Value) -> Value:
        """Return the value that rank 0 was given."""
        if self.size == 1:
            return value
        values = [value]
        with _connected():
            dist.broadcast_object_list(values, 0)
        return values[0]

    def gather(self, row: Mapping[str, float]) -> list[dict[str, float]]:
        """Return the rows of all ranks, which have the same keys."""
        if self.size == 1:
            return [dict(row)]
        own = torch.tensor(list(row.values()), dtype=torch.float64)
        rows = [torch.empty_like(own) for _ in range(self.size)]
        with _connected():
            dist.all_gather(rows, own)
        return [dict(zip(row, values.tolist(), strict=True)) for values in rows]

    def mean(self, row: Mapping[str, float], weight: str | None = None) -> dict[str, float]:
        """Return the means of a row's entries over the ranks.

        With the name of one entry as `weight`, that entry is the sum over the ranks, and the others are weighted by it;
        they are NaN if the sum is 0.
        """
        if self.size == 1 or not row:
            return dict(row)
        rows = self.gather(row)
        weights = [1.0 if weight is None else part[weight] for part in rows]
        total = sum(weights)
        if not total:
            return dict.fromkeys(row, math.nan) | {str(weight): total}
        sums = {name: sum(part[name] * w for part, w in zip(rows, weights, strict=True) if w) for name in row}
        means = {name: value / total for name, value in sums.items()}
        return means if weight is None else means | {weight: total}

    def any(self, condition: bool) -> bool:
        """Return whether the condition holds in any rank."""
        return any(row["condition"] for row in self.gather({"condition": float(condition)}))


@contextmanager
def _connected() -> Generator[None]:
    """Report what the backends raise as a `ConnectionError`."""
    try:
        yield
    except RuntimeError as error:
        reason = str(error).strip().splitlines()[0]
        raise ConnectionError(f"lost the connection to another learner: {reason}") from None
