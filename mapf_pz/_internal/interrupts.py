"""Handling of Ctrl-C and SIGTERM: long work ends early and cleanly, even where Python would lose the interrupt."""

from __future__ import annotations

import signal
from collections.abc import Callable, Generator
from contextlib import AbstractContextManager, contextmanager
from threading import current_thread, main_thread


@contextmanager
def interruptible() -> Generator[Callable[[], None]]:
    """Let SIGTERM, which job queues and `kill` send, act like Ctrl-C; yield a check to call regularly.

    Python drops a `KeyboardInterrupt` that is raised in a finalizer or in a callback from C; the check raises it again.
    Code in C may convert it into another error, such as a `SystemError`, instead of which it is raised at the end.
    """
    with _interrupts(0) as interrupted:

        def check() -> None:
            if interrupted():
                raise KeyboardInterrupt

        try:
            yield check
        except Exception as error:
            if interrupted():
                raise KeyboardInterrupt from error
            raise


def interrupts_deferred(on_first: Callable[[], None] = lambda: None) -> AbstractContextManager[Callable[[], bool]]:
    """Defer Ctrl-C and SIGTERM: yield a function that returns whether one was received; a second one is raised.

    `on_first` is called as soon as the first one is received.

    Libraries may convert an interrupt within their code into another error, or be left waiting for something that never
    happens.
    """
    return _interrupts(1, on_first)


@contextmanager
def unheard_by_children() -> Generator[None]:
    """Block Ctrl-C in processes that are started meanwhile, since a terminal sends it to them, too."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _interrupts(patience: int, on_first: Callable[[], None] = lambda: None) -> Generator[Callable[[], bool]]:
    """Count interrupts, and raise those after the first `patience`; yield whether there were any, as a function."""
    received = 0

    def handle(number: int, frame: object) -> None:
        nonlocal received
        received += 1
        if received > patience:
            raise KeyboardInterrupt
        on_first()

    with _handling(handle, signal.SIGTERM, signal.SIGINT):
        yield lambda: received > 0


@contextmanager
def _handling(handler: Callable[[int, object], None], *numbers: signal.Signals) -> Generator[None]:
    """Handle signals in the main thread, the only one that receives them, except those that the process ignores."""
    is_main = current_thread() is main_thread()
    handled = [number for number in numbers if is_main and signal.getsignal(number) != signal.SIG_IGN]
    before = {number: signal.signal(number, handler) for number in handled}
    try:
        yield
    finally:
        for number in handled:
            signal.signal(number, before[number])
