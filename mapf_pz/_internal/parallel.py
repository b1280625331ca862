"""Run jobs in this process, in several processes, or on a Ray cluster."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from functools import partial
from multiprocessing import active_children, get_context, parent_process, resource_tracker
from threading import Thread
from typing import Protocol, TypeVar

from mapf_pz._internal.interrupts import unheard_by_children

Job = TypeVar("Job")
Result = TypeVar("Result")
RAY = "ray"
_TRACKER_IS_QUIET = "ignore::UserWarning:multiprocessing.resource_tracker"


def run_jobs(function: Callable[[Job], Result], items: Sequence[Job], jobs: int | str) -> Iterator[Result]:
    """Yield the result of `function` for each item, in the order of completion: see `job_runner`."""
    _check(jobs)
    return _run_all(function, items, jobs) if items else iter(())


def _run_all(function: Callable[[Job], Result], items: Sequence[Job], jobs: int | str) -> Iterator[Result]:
    with job_runner(jobs) as run:
        yield from run(function, items)


def _check(jobs: int | str) -> None:
    if jobs != RAY and (not isinstance(jobs, int) or jobs < 1):
        raise ValueError(f"jobs={jobs!r}: expected a number of processes, 1 or more, or 'ray'")


class RunJobs(Protocol):
    """A function that calls another one with each item, in parallel."""

    def __call__(self, function: Callable[[Job], Result], items: Sequence[Job], /) -> Iterator[Result]:
        """Yield the results in the order of completion; `function`, the items and results must be picklable."""
        ...


@contextmanager
def job_runner(jobs: int | str) -> Generator[RunJobs]:
    """Yield a function that runs jobs, in processes that last as long as the context.

    Args:
        jobs: 1: sequentially in this process; more: number of processes; `ray`: in parallel on the Ray cluster at
            `RAY_ADDRESS` or, without this variable, on a local one that is started.

    Raises `ValueError` for other values of `jobs`, and `ImportError` if Ray is not installed.
    """
    _check(jobs)
    if jobs == RAY:
        with _ray():
            yield _on_ray
        return
    if jobs == 1:
        yield map
        return
    _start_resource_tracker()
    existing = set(active_children())
    with ProcessPoolExecutor(int(jobs), get_context("spawn"), initializer=start_process) as pool:
        try:
            yield partial(_in_processes, pool)
        except BaseException:  # otherwise running jobs would be waited for
            for process in set(active_children()) - existing:
                process.terminate()
            pool.shutdown(cancel_futures=True)
            raise


def _in_processes(
    pool: ProcessPoolExecutor, function: Callable[[Job], Result], items: Sequence[Job]
) -> Iterator[Result]:
    with unheard_by_children():  # children would print a traceback while they are loading
        futures = [pool.submit(function, item) for item in items]
    for future in as_completed(futures):
        yield future.result()


def _start_resource_tracker() -> None:
    """Start the process that removes what is left of killed processes, without its warning that there is something."""
    sys.warnoptions.append(_TRACKER_IS_QUIET)  # of this process; child processes inherit it
    try:
        resource_tracker.ensure_running()
    finally:
        sys.warnoptions.remove(_TRACKER_IS_QUIET)


def use_one_thread() -> None:
    """Let networks of this process and of its children use one thread, unless the user has set another number.

    Networks as small as these are several times slower with two. It has no effect once torch is imported.
    """
    os.environ.setdefault("OMP_NUM_THREADS", "1")


def start_process() -> None:
    """Prepare a new process: networks use one thread, as processes share the cores, and it ends with its parent."""
    os.environ["OMP_NUM_THREADS"] = "1"
    Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """Exit as soon as the parent process has ended for any reason."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@contextmanager
def _ray() -> Generator[None]:
    """Use the Ray that runs already, or start one for the duration of the context."""
    import ray

    started_here = not ray.is_initialized()
    if started_here:
        ray.init(log_to_driver=False)
    try:
        yield
    finally:
        if started_here:
            ray.shutdown()


def _on_ray(function: Callable[[Job], Result], items: Sequence[Job]) -> Iterator[Result]:
    import ray
    from ray.exceptions import RayError, RayTaskError

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
