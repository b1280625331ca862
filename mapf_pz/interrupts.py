"""Ctrl-C and SIGTERM: long work ends early and cleanly, also where Python would lose the interrupt."""

from __future__ import annotations

import signal
from collections.abc import Callable, Generator
from contextlib import contextmanager
from threading import current_thread, main_thread


@contextmanager
def interruptible() -> Generator[Callable[[], None]]:
    """Let SIGTERM, which queues and `kill` send, do what Ctrl-C does; yield a check to call now and then.

    Python drops a `KeyboardInterrupt` that comes while an object is deleted or C calls back; the check raises it again.
    """
    heard = False

    def interrupt(number: int, frame: object) -> None:
        nonlocal heard
        heard = True
        raise KeyboardInterrupt

    def check() -> None:
        if heard:
            raise KeyboardInterrupt

    with _handling(interrupt, signal.SIGTERM, signal.SIGINT):
        yield check


@contextmanager
def interrupts_held() -> Generator[None]:
    """Hold Ctrl-C back until the end."""
    heard: list[int] = []
    with _handling(lambda number, frame: heard.append(number), signal.SIGINT):
        yield
    if heard:
        raise KeyboardInterrupt


@contextmanager
def _handling(handler: Callable[[int, object], None], *numbers: signal.Signals) -> Generator[None]:
    """Handle signals in the main thread, which alone hears them, but for those that the process ignores."""
    mine = current_thread() is main_thread()
    handled = [number for number in numbers if mine and signal.getsignal(number) != signal.SIG_IGN]
    before = {number: signal.signal(number, handler) for number in handled}
    try:
        yield
    finally:
        for number in handled:
            signal.signal(number, before[number])
