"""Run jobs in this process, in several processes, or on a Ray cluster."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import active_children, get_context, parent_process
from threading import Thread
from typing import TypeVar

from mapf_pz.interrupts import unheard_by_children

Job = TypeVar("Job")
Result = TypeVar("Result")
RAY = "ray"


def run_jobs(function: Callable[[Job], Result], items: Sequence[Job], jobs: int | str) -> Iterator[Result]:
    """Yield the result of `function` for each item, in the order of completion.

    Args:
        function: the function to call. It must be picklable, as must the items and results.
        items: the arguments of the calls.
        jobs: 1: sequentially in this process; more: number of processes; `ray`: in parallel on the Ray cluster at
            `RAY_ADDRESS` or, without this variable, on a local one that is started.

    Raises `ValueError` for other values of `jobs`, and `ImportError` if Ray is not installed.
    """
    if jobs == RAY:
        return _on_ray(function, items) if items else iter(())
    if not isinstance(jobs, int) or jobs < 1:
        raise ValueError(f"jobs={jobs!r}: expected a number of processes, 1 or more, or 'ray'")
    return map(function, items) if jobs == 1 else _in_processes(function, items, jobs)


def _in_processes(function: Callable[[Job], Result], items: Sequence[Job], jobs: int) -> Iterator[Result]:
    existing = set(active_children())
    with ProcessPoolExecutor(jobs, get_context("spawn"), initializer=_start_process) as pool:
        try:
            with unheard_by_children():  # children would print a traceback while they are loading
                futures = [pool.submit(function, item) for item in items]
            for future in as_completed(futures):
                yield future.result()
        except BaseException:  # otherwise running jobs would be waited for
            for process in set(active_children()) - existing:
                process.terminate()
            pool.shutdown(cancel_futures=True)
            raise


def _start_process() -> None:
    """Initialize a process: networks use one thread, as processes share the cores, and it ends with its parent."""
    os.environ["OMP_NUM_THREADS"] = "1"
    Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """Exit as soon as the parent process has ended for any reason."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _on_ray(function: Callable[[Job], Result], items: Sequence[Job]) -> Iterator[Result]:
    import ray
    from ray.exceptions import RayError, RayTaskError

    started_here = not ray.is_initialized()
    if started_here:
        ray.init(log_to_driver=False)
    remote = ray.remote(function)
    pending = [remote.remote(item) for item in items]
    try:
        while pending:
            done, pending = ray.wait(pending)
            yield from ray.get(done)
    except RayTaskError as error:  # its text is a traceback
        raise error.cause from None
    except RayError as error:  # a worker died too often, or Ray itself failed
        raise RuntimeError(f"Ray: {error}") from None
    finally:
        for item in pending:
            ray.cancel(item)
        if started_here:
            ray.shutdown()
