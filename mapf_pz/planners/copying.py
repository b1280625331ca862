"""Copying rows in kernels."""

from __future__ import annotations

from mapf_pz._internal.jit import Array, inlined


@inlined
def copy_row(source: Array, target: Array) -> None:
    """Copy numbers (N,) in their order; `target[:] = source` takes seconds to compile."""
    for i in range(source.size):
        target[i] = source[i]
