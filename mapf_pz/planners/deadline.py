"""The end of a time limit, by a clock."""

from __future__ import annotations

import time
from collections.abc import Callable

Clock = Callable[[], float]
"""A clock in seconds, such as `time.perf_counter`, or `time.thread_time` for CPU time."""


class Deadline:
    """The moment at which a time limit ends."""

    def __init__(self, seconds: float, clock: Clock = time.perf_counter) -> None:
        """Start a time limit in seconds, which may be infinite, now."""
        self._clock = clock
        self._end = clock() + seconds

    @property
    def seconds_left(self) -> float:
        """Seconds until the deadline; negative once it has passed."""
        return self._end - self._clock()

    @property
    def has_passed(self) -> bool:
        """Whether the deadline has passed."""
        return self._clock() >= self._end

    def earlier(self, seconds: float) -> Deadline:
        """Return the deadline in `seconds` by the same clock, or this one if it is earlier."""
        return Deadline(min(seconds, self.seconds_left), self._clock)
