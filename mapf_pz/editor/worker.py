"""The process of a solver, which answers requests one by one until it is ended."""

from __future__ import annotations

import signal
import traceback
from ctypes import c_int64
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

from mapf_pz._internal.parallel import start_process
from mapf_pz.editor.episode import PolicyEpisode
from mapf_pz.editor.planned import PlannedPaths
from mapf_pz.editor.task import OnStep, Solving, Task
from mapf_pz.errors import USER_ERRORS


@dataclass(frozen=True)
class Failure:
    """An error, as the answer to a request."""

    message: str
    """One-line message."""


def work(task: Task, connection: Connection[Any, Any], step: c_int64) -> None:
    """Answer requests, each the name of a method of `Solving` and its arguments, by its result or a `Failure`.

    Args:
        task: the solver's task.
        connection: the requests and answers.
        step: shared memory, which is set to the number of steps after each step.
    """
    start_process()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the server ends this process

    def show(number: int) -> None:
        step.value = number

    solving: Solving | None = None
    while True:
        method, arguments = connection.recv()
        try:
            solving = solving or _solving(task, show)
            answer = getattr(solving, method)(*arguments)
        except USER_ERRORS as error:
            answer = Failure(" ".join(str(error).split()) or type(error).__name__)
        except Exception as error:
            traceback.print_exc()
            answer = Failure(f"internal error, see the terminal: {type(error).__name__}")
        connection.send(answer)


def _solving(task: Task, on_step: OnStep) -> Solving:
    return PlannedPaths(task) if task.plans_paths else PolicyEpisode(task, on_step)
