"""Work side by side: in this process, in several, or on a Ray cluster."""

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


def run_jobs(function: Callable[[Job], Result], tasks: Sequence[Job], jobs: int | str) -> Iterator[Result]:
    """Yield what `function` returns for each of the tasks, in the order in which they are done.

    Args:
        function: can be pickled, as tasks and results can.
        tasks: what it is called with.
        jobs: 1: one after the other in this process; more: so many processes; `ray`: as many as the Ray cluster has
            room for, which is that of the variable `RAY_ADDRESS` or, without one, begun here.

    Raises `ValueError` for other `jobs`, and `ImportError` where Ray is not installed.
    """
    if jobs == RAY:
        return _on_ray(function, tasks) if tasks else iter(())
    if not isinstance(jobs, int) or jobs < 1:
        raise ValueError(f"jobs={jobs!r}: expected a number of processes, 1 or more, or 'ray'")
    return map(function, tasks) if jobs == 1 else _in_processes(function, tasks, jobs)


def _in_processes(function: Callable[[Job], Result], tasks: Sequence[Job], jobs: int) -> Iterator[Result]:
    others = set(active_children())
    with ProcessPoolExecutor(jobs, get_context("spawn"), initializer=_begin_process) as pool:
        try:
            with unheard_by_children():  # who would tell of it, while they load
                futures = [pool.submit(function, task) for task in tasks]
            for future in as_completed(futures):
                yield future.result()
        except BaseException:  # what is going on would be waited for
            for process in set(active_children()) - others:
                process.terminate()
            pool.shutdown(cancel_futures=True)
            raise


def _begin_process() -> None:
    """Prepare a process: its networks use one thread, as the cores are shared; it ends when, and only when, told to."""
    os.environ["OMP_NUM_THREADS"] = "1"
    Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """Wait until the process that asked for the work is gone, however it ended, and end."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _on_ray(function: Callable[[Job], Result], tasks: Sequence[Job]) -> Iterator[Result]:
    import ray
    from ray.exceptions import RayError, RayTaskError

    begun_here = not ray.is_initialized()
    if begun_here:
        ray.init(log_to_driver=False)
    remote = ray.remote(function)
    waiting = [remote.remote(task) for task in tasks]
    try:
        while waiting:
            done, waiting = ray.wait(waiting)
            yield from ray.get(done)
    except RayTaskError as error:  # its own text is a traceback
        raise error.cause from None
    except RayError as error:  # a worker that died too often, or all of Ray
        raise RuntimeError(f"Ray: {error}") from None
    finally:
        for task in waiting:
            ray.cancel(task)
        if begun_here:
            ray.shutdown()
