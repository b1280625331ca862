"""The end of a time limit, by a clock: the machine's, or one that counts the work of a planner."""

from __future__ import annotations

import time
from collections.abc import Callable

Clock = Callable[[], float]
"""A clock in seconds, such as `time.perf_counter`, or `time.thread_time` for CPU time."""


class WorkClock:
    """A clock that advances by the work that is done, so that what is done until a deadline is the same everywhere.

    Work is counted in units of about one second on one core, with the rates of a processor of 2023.
    """

    def __init__(self) -> None:
        """Start the clock at 0."""
        self._seconds = 0.0

    def __call__(self) -> float:
        """Return the work so far, in seconds."""
        return self._seconds

    def advance(self, seconds: float) -> None:
        """Count work."""
        self._seconds += seconds


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

    def count(self, seconds: float) -> None:
        """Count work that takes about this many seconds, if the clock is a `WorkClock`."""
        if isinstance(self._clock, WorkClock):
            self._clock.advance(seconds)

    def earlier(self, seconds: float) -> Deadline:
        """Return the deadline in `seconds` by the same clock, or this one if it is earlier."""
        return Deadline(min(seconds, self.seconds_left), self._clock)
