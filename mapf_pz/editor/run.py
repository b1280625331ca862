"""Runs of solvers, each in its own process."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from ctypes import c_double, c_int64
from multiprocessing import RawValue, forkserver, get_all_start_methods, get_context, set_forkserver_preload
from multiprocessing.process import BaseProcess
from threading import Lock
from typing import Any, Literal

from mapf_pz._internal.interrupts import unheard_by_children
from mapf_pz._internal.parallel import use_one_thread
from mapf_pz.editor.requests import Refusal
from mapf_pz.editor.task import Outcome, Task, check_memory
from mapf_pz.editor.worker import Failure, send_map, work
from mapf_pz.instances import MapMixture

State = Literal["running", "done", "failed", "stopped"]
"""What a solver does."""
CAN_FORK = "forkserver" in get_all_start_methods()
"""Whether processes are forked from one that has loaded what policies need; otherwise each loads it."""
MAX_GENERATION_SECONDS = 60.0
"""Time limit of the generation of a map."""
MAX_OVERTIME = 30.0
"""Seconds after its time limit at which a solver is ended. Most end earlier by themselves, with a result."""
LOADED = ["mapf_pz.editor.worker", "mapf_pz.rl.policies.load"]
"""The modules that this process loads, if they are installed."""


def start_fork_server() -> None:
    """Start the process from which those of solvers are forked. It loads its modules in the background."""
    if CAN_FORK:
        use_one_thread()
        set_forkserver_preload(LOADED)
        forkserver.ensure_running()


def start_worker(target: Callable[..., object], *arguments: object) -> tuple[BaseProcess, Any]:
    """Start a process that calls `target` with one end of a connection and the arguments; return it and our end."""
    context = get_context("forkserver") if CAN_FORK else get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=target, args=(theirs, *arguments), daemon=True)
    with unheard_by_children():
        process.start()
    theirs.close()
    return process, ours


class SolverProcess:
    """A process in which a solver runs; afterward, it answers requests about the episode. Its methods block threads."""

    def __init__(self, task: Task) -> None:
        """Start the process and the solver."""
        self.task = task
        """The solver's task."""
        self.state: State = "running"
        """The state at the latest call of `update`."""
        self._step, self._started_at = RawValue(c_int64, 0), RawValue(c_double, 0.0)
        self._process, self._connection = start_worker(work, task, self._step, self._started_at)
        self._lock = Lock()
        self._start("run")

    def update(self) -> State:
        """Receive the solver's outcome, if there is one, or notice that the process has ended; return the state.

        A process that works for `MAX_OVERTIME` longer than its time limit is ended.
        """
        with self._lock:
            if self.state in ("running", "done") and self._connection.poll():
                self._finish(self._received())
            elif self.state == "running" and self._seconds() > self._time_limit + MAX_OVERTIME:
                self._process.kill()
                limit = f"{MAX_OVERTIME:g} seconds after its time limit of {self._time_limit:g} seconds"
                self._finish(Failure(f"{self.task.solver} had no result {limit}, and was ended"))
        return self.state

    def progress(self) -> dict[str, Any]:
        """Return the solver's part of the response to `progress`."""
        running = self.update() == "running"
        step = self._step.value if running else self._outcome.num_steps
        return {
            "name": self.task.solver,
            "state": self.state,
            "step": None if running and self.task.plans_paths else step,
            "steps": self.task.max_steps,
            "seconds": self._seconds() if running else self._outcome.seconds,
            "message": ("" if self._started_at.value else "compiling") if running else self._outcome.message,
            "unfinished": [] if running else list(self._outcome.unfinished),
        }

    def episode(self) -> dict[str, Any]:
        """Return the response to `episode`; raises `Refusal` unless the solver is done."""
        with self._lock:
            self._require_done()
            self._connection.send(("episode", ()))
            answer = self._received()
            if not isinstance(answer, Failure):
                return answer
            if not self._process.is_alive():
                self._finish(answer)
            raise Refusal(400, answer.message)

    def resume(self, start: int, actions: Mapping[int, int], steps: int) -> None:
        """Resume the episode, as `Solving.resume`; raises `Refusal` unless the solver is done and can do so."""
        with self._lock:
            self._require_done()
            if self.task.plans_paths:
                expected = "expected a policy, or a planner of single steps"
                raise Refusal(400, f"{self.task.solver} plans whole paths: {expected}")
            last = self._outcome.num_steps - self._outcome.is_over
            if start > last:
                raise Refusal(400, f"from={start}: expected 0 to {last}, a step before the end of the episode")
            _check_actions(actions, self.task)
            self._start("resume", start, dict(actions), steps)

    def stop(self) -> None:
        """End the process at once."""
        self._process.kill()
        with self._lock:
            self._process.join()
            if self.state == "running":
                self._outcome = Outcome("stopped", self._step.value, seconds=self._seconds())
            self.state = "stopped"
            self._connection.close()

    def _start(self, method: str, *arguments: object) -> None:
        """Send a request that is answered by an `Outcome`."""
        self.state = "running"
        self._outcome = Outcome("", 0)
        self._time_limit = self.task.time_limit if method == "run" else math.inf
        self._started_at.value = 0.0
        self._step.value = 0
        self._connection.send((method, arguments))

    def _seconds(self) -> float:
        """Return how long the solver has been working, without the compilation of kernels."""
        return time.monotonic() - self._started_at.value if self._started_at.value else 0.0

    def _received(self) -> Any:
        """Wait for an answer, and return it; a `Failure` if the process has ended."""
        try:
            return self._connection.recv()
        except (EOFError, OSError):
            self._process.join()
            return Failure(f"the solver's process has ended unexpectedly, exit code {self._process.exitcode}")

    def _finish(self, answer: Outcome | Failure) -> None:
        if isinstance(answer, Failure):
            answer = Outcome(answer.message, self._step.value, seconds=self._seconds())
            self.state = "failed"
        else:
            self.state = "done"
        self._outcome = answer

    def _require_done(self) -> None:
        if self.state != "done":
            raise Refusal(409, f"{self.task.solver}: expected a solver that is done, got one that is {self.state}")


class MapGeneration:
    """The generation of maps, one at a time, in a process that can be ended."""

    def __init__(self) -> None:
        """Start without a process."""
        self._lock = Lock()
        self._process: BaseProcess | None = None

    def run(self, mixture: MapMixture, seed: int) -> dict[str, str]:
        """Return the name and the file of a map; the generation before ends.

        Raises `Refusal` if the map cannot be generated, after `MAX_GENERATION_SECONDS`, and if it is stopped.
        """
        with self._lock:
            self._end()
            process, connection = start_worker(send_map, mixture, seed)
            self._process = process
        with connection:
            try:
                if not connection.poll(MAX_GENERATION_SECONDS):
                    raise Refusal(400, f"map: its generation takes longer than {MAX_GENERATION_SECONDS:g} seconds")
                answer = connection.recv()
            except (EOFError, OSError):
                raise Refusal(409, "map: its generation was stopped") from None
            finally:
                process.kill()
        if isinstance(answer, Failure):
            raise Refusal(400, answer.message)
        return answer

    def stop(self) -> None:
        """End the generation at once, if there is one."""
        with self._lock:
            self._end()

    def _end(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.join()


class Runs:
    """The runs of the server, and the generation of maps: one of each at a time."""

    def __init__(self) -> None:
        """Start without a run."""
        self._lock = Lock()
        self._number = 0
        self._solvers: list[SolverProcess] = []
        self.generation = MapGeneration()
        """The generation of maps."""

    def start(self, tasks: Sequence[Task]) -> int:
        """Start a run of a solver for each task, and return its number; the run before ends.

        Raises `Refusal` (status 409) while another run is running, and as `check_memory`.
        """
        with self._lock:
            self._require_idle()
            self._stop()
            check_memory(tasks)
            self._solvers = [SolverProcess(task) for task in tasks]
            return self._next()

    def resume(self, number: int, solver: int, start: int, actions: Mapping[int, int], steps: int) -> int:
        """Resume the episode of a solver in a new run, which has the same solvers; return its number.

        Raises `Refusal` as `SolverProcess.resume` and `start`.
        """
        with self._lock:
            chosen = self._of(number, solver)
            self._require_idle()
            chosen.resume(start, actions, steps)
            return self._next()

    def solvers(self, number: int) -> list[SolverProcess]:
        """Return the solvers of the latest run; raises `Refusal` (status 404) unless it has this number."""
        if number != self._number or not self._solvers:
            raise Refusal(404, f"there is no run {number}")
        return self._solvers

    def solver(self, number: int, index: int) -> SolverProcess:
        """Return a solver of the latest run; raises `Refusal` (status 404) if there is none."""
        with self._lock:
            return self._of(number, index)

    def stop(self, number: int) -> None:
        """End the processes of the latest run at once; raises `Refusal` unless it has this number."""
        self.solvers(number)
        self._stop()

    def close(self) -> None:
        """End all processes."""
        self._stop()
        self.generation.stop()

    def _of(self, number: int, index: int) -> SolverProcess:
        solvers = self.solvers(number)
        if index >= len(solvers):
            raise Refusal(404, f"solver {index}: the run has {len(solvers)}")
        return solvers[index]

    def _next(self) -> int:
        self._number += 1
        return self._number

    def _require_idle(self) -> None:
        if any(solver.update() == "running" for solver in self._solvers):
            raise Refusal(409, "another run is running: stop it first")

    def _stop(self) -> None:
        for solver in self._solvers:
            solver.stop()


def _check_actions(actions: Mapping[int, int], task: Task) -> None:
    """Raise `Refusal` for an unknown agent or action."""
    num_agents, num_actions = task.instance.num_agents, 5 if task.instance.headings is None else 4
    for agent, action in actions.items():
        if not 0 <= agent < num_agents:
            raise Refusal(400, f"actions: expected agents 0 to {num_agents - 1}, got {agent}")
        if not 0 <= action < num_actions:
            raise Refusal(400, f"actions: expected an action 0 to {num_actions - 1} of agent {agent}, got {action}")
