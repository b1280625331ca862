"""The message that kernels are being compiled: on a terminal as long as they are, otherwise once per program."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable, Generator
from contextlib import contextmanager
from threading import Lock
from typing import Any

from numba.core import event

TEXT = "compiling kernels (once per machine and version)"
ERASE_LINE = "\r\x1b[K"
logger = logging.getLogger(__name__)


class CompileMessage(event.Listener):
    """Listens to Numba: shows a message while it compiles kernels of the package; loading them from the cache is none.

    On a terminal, the line is updated and erased in the end.
    """

    def __init__(self) -> None:
        """Show nothing yet."""
        self._is_logged = self._is_counting = False
        self._depth = 0
        self._lock = Lock()

    def on_start(self, event: Any) -> None:
        """Show the message before the first of the kernels that are compiled within each other."""
        is_own = event.data["dispatcher"].py_func.__module__.startswith("mapf_pz.")
        if is_own and self._depth == 0 and not self._is_counting:
            self._show(" ...")
        self._depth += 1

    def on_end(self, event: Any) -> None:
        """Erase the message after the last."""
        self._depth -= 1
        if self._depth == 0 and not self._is_counting:
            self._erase()

    @contextmanager
    def counting(self, total: int) -> Generator[Callable[[], None]]:
        """Show how many of `total` kernels are compiled; yield a function that counts one, for several threads."""
        done = 0

        def count() -> None:
            nonlocal done
            with self._lock:
                done += 1
                self._show(f": {done} of {total}")

        self._is_counting = True
        self._show(f": {done} of {total}" if self._is_live else " ...")
        try:
            yield count
        finally:
            self._is_counting = False
            self._erase()

    @property
    def _is_live(self) -> bool:
        return sys.stderr is not None and sys.stderr.isatty() and logger.isEnabledFor(logging.WARNING)

    def _show(self, state: str) -> None:
        if self._is_live:
            print(f"{ERASE_LINE}{TEXT}{state}", end="", file=sys.stderr, flush=True)
        elif not self._is_logged:
            self._is_logged = True
            logger.warning("%s%s", TEXT, state)

    def _erase(self) -> None:
        if self._is_live:
            print(ERASE_LINE, end="", file=sys.stderr, flush=True)


# With a root logger at DEBUG, as EPyMARL sets it, Numba reports every instruction of a kernel.
numba_logger = logging.getLogger("numba")
if numba_logger.level == logging.NOTSET:
    numba_logger.setLevel(logging.WARNING)

compile_message = CompileMessage()
event.register("numba:compile", compile_message)
