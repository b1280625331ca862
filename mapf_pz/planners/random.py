"""Random numbers inside kernels: Marsaglia, *Xorshift RNGs*, 2003.

The caller owns the generator's state, an array of one number.
"""

from __future__ import annotations

import numpy as np

from mapf_pz._internal.jit import Array, jit


def seeded(seed: int) -> Array:
    """Return a generator's state (1,) uint64. The seed must not be 0."""
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
    """Return a random number from 0 to `bound` - 1; `bound` is at most 2^31."""
    return int(np.int64((draw(random) >> np.uint64(33)) % np.uint64(bound)))
