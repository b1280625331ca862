"""Compile kernels in several processes, which leave what they compile in the cache.

`python -m mapf_pz._internal.compilation.jobs` is such a process. `multiprocessing` would import the user's
program once more.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from collections import deque
from collections.abc import Callable, Generator, Iterator
from contextlib import ExitStack, contextmanager, suppress
from importlib import import_module
from multiprocessing import parent_process
from operator import attrgetter
from pathlib import Path
from queue import SimpleQueue
from threading import Thread
from typing import IO, Any, NamedTuple, TypeAlias, cast

from mapf_pz._internal.compilation.message import compile_message
from mapf_pz._internal.interrupts import unheard_by_children
from mapf_pz._internal.machine import usable_cores

_Description: TypeAlias = tuple[str, str, tuple[Any, ...]]
"""The name of a kernel's module and its own name there, and the types."""


class Job(NamedTuple):
    """A kernel, and the types of arguments for which it is to be compiled."""

    kernel: Any
    types: tuple[Any, ...]

    def described(self) -> _Description:
        """Return what another process needs to know of the job."""
        return self.kernel.py_func.__module__, self.kernel.path, self.types


def run_jobs(jobs: list[Job]) -> None:
    """Compile kernels: in this process, and in as many others as there are more cores, each a job at a time.

    Raises what compiling raises in this process; jobs that fail in others are left undone.
    """
    left = deque(sorted(jobs, key=lambda job: _work(job.kernel), reverse=True))
    with compile_message.counting(len(jobs)) as count, ExitStack() as workers:
        for _ in range(_num_workers(jobs)):
            workers.enter_context(_worker(left, jobs[0].kernel.root, count))
        for job in _taken(left):
            job.kernel.compile(job.types)
            count()


def _num_workers(jobs: list[Job]) -> int:
    """Return the number of processes to start: none without a cache, or where siblings of this one use the cores."""
    if parent_process() is not None or not sys.executable or any(job.kernel.root is None for job in jobs):
        return 0
    return min(usable_cores(), len(jobs)) - 1


def _taken(jobs: deque[Job]) -> Iterator[Job]:
    """Take one job after the other, as other threads do."""
    with suppress(IndexError):
        while True:
            yield jobs.popleft()


def _work(kernel: Any) -> int:
    """Estimate how long it takes to compile a kernel: the length of its code and of that of all that it calls."""
    found, pending = set[Any](), [kernel]
    while pending:
        function = pending.pop().py_func
        if function not in found:
            found.add(function)
            named = [function.__globals__.get(name) for name in function.__code__.co_names]
            pending += [value for value in named if isinstance(value, type(kernel))]
    return sum(len(function.__code__.co_code) for function in found)


@contextmanager
def _worker(jobs: deque[Job], root: Path, count: Callable[[], None]) -> Generator[None]:
    """Compile jobs in another process, into the cache at `root`; it ends with the context or with this process."""
    path, cache = os.pathsep.join(sys.path), str(root.parents[1])
    inherited = {"PYTHONPATH": path, "PYTHONSAFEPATH": "1", "NUMBA_CACHE_DIR": cache}
    try:
        with unheard_by_children():  # they end as soon as nothing can be sent to them
            process = subprocess.Popen(
                [sys.executable, "-m", __name__, str(root)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env=os.environ | inherited,
            )
    except OSError:  # no process can be started: this one compiles all
        yield
        return
    with process:
        sender = Thread(target=_send, args=(process, jobs, count), daemon=True)
        sender.start()
        try:
            yield
            sender.join()
        finally:
            with suppress(OSError):
                cast("IO[bytes]", process.stdin).close()
            process.wait()
            sender.join()


def _send(process: subprocess.Popen[bytes], jobs: deque[Job], count: Callable[[], None]) -> None:
    """Send jobs one by one, until there are none or the process has ended."""
    requests, replies = cast("IO[bytes]", process.stdin), cast("IO[bytes]", process.stdout)
    with suppress(OSError, ValueError):
        for job in _taken(jobs):
            pickle.dump(job.described(), requests)
            requests.flush()
            if not replies.read(1):
                return
            count()


def _receive(requests: IO[bytes], jobs: SimpleQueue[_Description]) -> None:
    """Receive jobs until no more can come, and end this process then, whatever it is doing."""
    with suppress(Exception):
        while True:
            jobs.put(pickle.load(requests))
    os._exit(0)


def _compile_received(root: str) -> None:
    """Compile the jobs that standard input brings, into the cache at `root`, and answer each with a byte."""
    replies = os.dup(sys.stdout.fileno())
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    jobs = SimpleQueue[_Description]()
    Thread(target=_receive, args=(sys.stdin.buffer, jobs), daemon=True).start()
    while True:
        module, path, types = jobs.get()
        kernel: Any = attrgetter(path)(import_module(module))
        if str(kernel.root) != root:  # other settings
            return
        kernel.compile(types)
        os.write(replies, b".")


if __name__ == "__main__":
    _compile_received(sys.argv[1])
