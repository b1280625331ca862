"""Ctrl-C and SIGTERM: long work ends early and cleanly, also where Python would lose the interrupt."""

from __future__ import annotations

import signal
from collections.abc import Callable, Generator
from contextlib import AbstractContextManager, contextmanager
from threading import current_thread, main_thread


def interruptible() -> AbstractContextManager[Callable[[], None]]:
    """Let SIGTERM, which queues and `kill` send, do what Ctrl-C does; give a check to call now and then.

    Python drops a `KeyboardInterrupt` that comes while an object is deleted or C calls back; the check raises it again.
    """
    return _interrupts(patience=0)


def interrupts_deferred() -> AbstractContextManager[Callable[[], None]]:
    """Hold Ctrl-C and SIGTERM back until the check that is given is called; only a second one comes at once.

    Libraries may turn an interrupt in their midst into another error, or be left in a state in which they wait for
    something that never comes.
    """
    return _interrupts(patience=1)


@contextmanager
def unheard_by_children() -> Generator[None]:
    """Block Ctrl-C in processes that are begun meanwhile: a terminal sends it to them, too."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _interrupts(patience: int) -> Generator[Callable[[], None]]:
    """Note interrupts, and raise those after the first `patience` at once; yield a check that raises what was noted."""
    heard = 0

    def hear(number: int, frame: object) -> None:
        nonlocal heard
        heard += 1
        if heard > patience:
            raise KeyboardInterrupt

    def check() -> None:
        if heard:
            raise KeyboardInterrupt

    with _handling(hear, signal.SIGTERM, signal.SIGINT):
        yield check


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
