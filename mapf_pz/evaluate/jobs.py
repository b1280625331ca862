"""Work side by side: in this process, in several, or on a Ray cluster."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from typing import TypeVar

Task = TypeVar("Task")
Result = TypeVar("Result")
RAY = "ray"


def run_jobs(function: Callable[[Task], Result], tasks: Sequence[Task], jobs: int | str) -> Iterator[Result]:
    """Yield what `function` returns for each of the tasks, in the order in which they are done.

    Args:
        function: can be pickled, as tasks and results can.
        tasks: what it is called with.
        jobs: 1: one after the other in this process; more: so many processes; `ray`: as many as the Ray cluster has
            room for, which is that of the variable `RAY_ADDRESS` or, without one, begun here.

    Raises `ValueError` for other `jobs`, and `ImportError` where Ray is not installed.
    """
    if jobs == RAY:
        return _on_ray(function, tasks)
    if not isinstance(jobs, int) or jobs < 1:
        raise ValueError(f"jobs={jobs!r}: expected a number of processes, 1 or more, or 'ray'")
    return map(function, tasks) if jobs == 1 else _in_processes(function, tasks, jobs)


def _in_processes(function: Callable[[Task], Result], tasks: Sequence[Task], jobs: int) -> Iterator[Result]:
    with ProcessPoolExecutor(jobs, get_context("spawn"), initializer=_one_thread) as pool:
        try:
            for future in as_completed([pool.submit(function, task) for task in tasks]):
                yield future.result()
        finally:
            pool.shutdown(cancel_futures=True)


def _one_thread() -> None:
    """Let a process's networks use one thread: the processes share the cores already."""
    os.environ["OMP_NUM_THREADS"] = "1"


def _on_ray(function: Callable[[Task], Result], tasks: Sequence[Task]) -> Iterator[Result]:
    import ray

    begun_here = not ray.is_initialized()
    if begun_here:
        ray.init(log_to_driver=False)
    remote = ray.remote(function)
    waiting = [remote.remote(task) for task in tasks]
    try:
        while waiting:
            done, waiting = ray.wait(waiting)
            yield from ray.get(done)
    finally:
        if begun_here:
            ray.shutdown()
