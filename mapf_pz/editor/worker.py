"""The processes of solvers, which answer requests one by one until they are ended, and those that generate maps."""

from __future__ import annotations

import signal
import time
import traceback
from ctypes import c_double, c_int64
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from mapf_pz._internal.parallel import start_process
from mapf_pz.editor.episode import PlannedPaths, PolicyEpisode
from mapf_pz.editor.task import OnStep, Solving, Task
from mapf_pz.errors import USER_ERRORS
from mapf_pz.instances import MapMixture, format_map
from mapf_pz.planners.named import import_code


@dataclass(frozen=True)
class Failure:
    """An error, as the answer to a request."""

    message: str
    """One-line message."""


def work(connection: Connection[Any, Any], task: Task, step: c_int64, started_at: c_double) -> None:
    """Answer requests, each the name of a method of `Solving` and its arguments, by its result or a `Failure`.

    Args:
        connection: the requests and answers.
        task: the solver's task.
        step: shared memory, which is set to the number of steps after each step.
        started_at: shared memory, which is set to `time.monotonic()` when the work begins, after kernels are compiled.
    """
    _start()
    import_code(task.solver)  # the server has checked that it may run

    def show(number: int) -> None:
        step.value = number

    solving: Solving | None = None
    while True:
        method, arguments = connection.recv()
        try:
            solving = solving or _solving(task, show)
            started_at.value = time.monotonic()
            answer = getattr(solving, method)(*arguments)
        except Exception as error:
            answer = _failure(error)
        connection.send(answer)


def send_map(connection: Connection[Any, Any], mixture: MapMixture, seed: int) -> None:
    """Send the name and the file of the map that `mapf-pz maps generate` writes first, or a `Failure`."""
    _start()
    try:
        grid = mixture.source(num_agents=1).sample(np.random.default_rng(seed)).grid
        answer = {"name": grid.name, "map": format_map(grid)}
    except Exception as error:
        answer = _failure(error)
    connection.send(answer)


def _start() -> None:
    start_process()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the server ends this process


def _failure(error: Exception) -> Failure:
    """Return an error as an answer; prints the traceback of a bug."""
    if isinstance(error, USER_ERRORS):
        return Failure(" ".join(str(error).split()) or type(error).__name__)
    traceback.print_exception(error)
    return Failure(f"internal error, see the terminal: {type(error).__name__}")


def _solving(task: Task, on_step: OnStep) -> Solving:
    return PlannedPaths(task) if task.plans_paths else PolicyEpisode(task, on_step)
