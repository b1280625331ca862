"""Timing of the parts of a training run."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Generator
from contextlib import contextmanager

from torch import nn


class Stopwatch:
    """Accumulates seconds by name."""

    def __init__(self) -> None:
        """Start at zero."""
        self._seconds: defaultdict[str, float] = defaultdict(float)

    @contextmanager
    def time(self, name: str) -> Generator[None]:
        """Add the duration of a `with` block to `name`."""
        began = time.perf_counter()
        try:
            yield
        finally:
            self._count(name, began)

    @contextmanager
    def calls(self, module: nn.Module, name: str) -> Generator[None]:
        """Add the duration of all calls of a module within a `with` block to `name`."""
        began: list[float] = []
        hooks = (
            module.register_forward_pre_hook(lambda *_: began.append(time.perf_counter())),
            module.register_forward_hook(lambda *_: self._count(name, began.pop())),
        )
        try:
            yield
        finally:
            for hook in hooks:
                hook.remove()

    def lap(self) -> dict[str, float]:
        """Return the seconds by name since the previous lap."""
        seconds = dict(self._seconds)
        self._seconds.clear()
        return seconds

    def _count(self, name: str, began: float) -> None:
        self._seconds[name] += time.perf_counter() - began
