"""Types of NumPy arrays, read-only copies, and equality of dataclasses with arrays."""

from __future__ import annotations

from dataclasses import fields
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

Bools = NDArray[np.bool_]
Ints = NDArray[np.integer]
Floats = NDArray[np.floating]
Scalar = TypeVar("Scalar", bound=np.generic)


def coordinates(cells: Ints, width: int) -> Ints:
    """Return the coordinates [row, col], (..., 2) int64, of cell numbers (...) on a map with `width` columns."""
    pairs = np.empty((*cells.shape, 2), np.int64)
    np.divmod(cells, width, out=(pairs[..., 0], pairs[..., 1]))
    return pairs


def frozen(array: ArrayLike, dtype: type[Scalar], name: str = "array") -> NDArray[Scalar]:
    """Return a read-only copy of `array`, which is called `name` in messages.

    Raises `ValueError` if the data type cannot represent the numbers, such as 0.7 or 2**32 as int32, or 1e39 as
    float32; floating-point numbers may be rounded.
    """
    given = np.asarray(array)
    with np.errstate(invalid="ignore", over="ignore"):
        try:
            copy = given.astype(dtype)
        except (TypeError, OverflowError) as error:
            raise ValueError(f"{name}: expected numbers: {error}") from None
    if not np.can_cast(given.dtype, dtype):
        is_float = np.issubdtype(dtype, np.floating)
        if not (np.array_equal(np.isfinite(copy), np.isfinite(given)) if is_float else np.array_equal(copy, given)):
            kind = "finite numbers" if is_float else "whole numbers"
            raise ValueError(f"{name}: expected {kind} that {np.dtype(dtype)} can represent")
    copy.flags.writeable = False
    return copy


class EqualByValue:
    """Base class of frozen dataclasses with arrays: they are equal if all fields are, and hashable."""

    def __eq__(self, other: object) -> bool:
        """Return whether all fields are equal, except those declared with `compare=False`."""
        if type(other) is not type(self):
            return NotImplemented
        return self is other or all(map(_equal, _compared(self), _compared(other)))

    def __hash__(self) -> int:
        """Return a hash of the fields that are compared."""
        return hash(tuple(value.tobytes() if isinstance(value, np.ndarray) else value for value in _compared(self)))


def _compared(instance: Any) -> list[Any]:
    return [getattr(instance, field.name) for field in fields(instance) if field.compare]


def _equal(one: Any, other: Any) -> bool:
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        return np.array_equal(one, other)
    return one == other
