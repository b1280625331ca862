"""Random numbers drawn inside kernels, from a state that belongs to whoever draws: Marsaglia, *Xorshift RNGs*, 2003."""

from __future__ import annotations

import numpy as np

from mapf_pz.core.jit import jit
from mapf_pz.core.state import Array


def seeded(seed: int) -> Array:
    """Return a state (1,) uint64; the seed is not 0."""
    return np.array([seed], np.uint64)


@jit
def draw(random: Array) -> int:
    """Return 64 random bits, unsigned."""
    x = random[0]
    x ^= x << np.uint64(13)
    x ^= x >> np.uint64(7)
    x ^= x << np.uint64(17)
    random[0] = x
    return x


@jit
def draw_below(random: Array, bound: int) -> int:
    """Return a number from 0 to `bound` - 1, which is below 2^31."""
    return int(np.int64((draw(random) >> np.uint64(33)) % np.uint64(bound)))
