"""Stacked observations: those of several agents along the planes and features."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import numpy as np
from gymnasium import spaces


def stacked(parts: Sequence[Any]) -> Any:
    """Concatenate arrays along their first axis; for dictionaries, the arrays of each key."""
    if isinstance(parts[0], dict):
        return {key: stacked([part[key] for part in parts]) for key in parts[0]}
    return np.concatenate(parts)


def stacked_space(space: spaces.Space[Any], number: int) -> spaces.Space[Any]:
    """Return the space of `number` stacked observations of `space`, a Box or a Dict of them."""
    if isinstance(space, spaces.Dict):
        return spaces.Dict({key: stacked_space(part, number) for key, part in space.items()})
    box = cast("spaces.Box", space)
    return spaces.Box(np.concatenate([box.low] * number), np.concatenate([box.high] * number), dtype=np.float32)


def zeros(space: spaces.Space[Any]) -> Any:
    """Return an observation of `space`, a Box or a Dict of them, with all zeros."""
    if isinstance(space, spaces.Dict):
        return {key: zeros(part) for key, part in space.items()}
    return np.zeros(space.shape or (), np.float32)
