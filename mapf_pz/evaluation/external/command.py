"""Planners that are programs, in any language: they read a `.map` and a `.scen` file and write a plan file."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import signal
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from mapf_pz._internal.digest import digest
from mapf_pz._internal.printable import printable
from mapf_pz.environment.mapf_env import MapfEnv, parallel_env
from mapf_pz.errors import FormatError
from mapf_pz.evaluation.external.planned_policy import ExternalPlan, NoPlanError, PlannedPolicy
from mapf_pz.instances.files.movingai import write_map, write_scenario
from mapf_pz.instances.instance import Grid, Instance
from mapf_pz.planners import Planner
from mapf_pz.planners.plans.files import Selection, read_plan

PREFIX = "command:"
"""Prefix of policies that are commands."""
TIME_LIMIT = 10.0
"""Default time limit of a command in seconds."""
OVERTIME = 2.0
"""A command that takes longer than this multiple of its time limit is ended."""
REQUIRED = ("map", "scen", "plan")
PLACEHOLDERS = (*REQUIRED, "agents", "seconds", "seed")
_PLACEHOLDER = re.compile(r"\{(\w*)\}")
_MAX_OUTPUT = 4096


@dataclass(frozen=True)
class CommandFactory:
    """Makes a policy that runs a command for the plan of each episode.

    Raises `ValueError` if the command is malformed, or does not exist.
    """

    command: str
    """The command, without its prefix. It is split into arguments as a shell does, but run without a shell. In each
    argument, these are replaced: `{map}` and `{scen}` by the files of the instance, `{plan}` by the file to write,
    `{agents}` by the number of agents, `{seconds}` by the time limit, and `{seed}` by the random seed."""
    time_limit: float = TIME_LIMIT
    """Time limit in seconds, which the command gets as `{seconds}`."""
    seed: int = 0
    """Random seed, which the command gets as `{seed}`."""

    def __post_init__(self) -> None:
        """Check the command."""
        if not self.time_limit > 0:
            raise ValueError(f"time_limit={self.time_limit}: expected a number above 0")
        names = _PLACEHOLDER.findall(self.command)
        for name in names:
            if name not in PLACEHOLDERS:
                expected = ", ".join(f"{{{known}}}" for known in PLACEHOLDERS)
                raise ValueError(f"{PREFIX}{self.command}: expected {expected}, got {{{name}}}")
        missing = [f"{{{name}}}" for name in REQUIRED if name not in names]
        if missing:
            raise ValueError(f"{PREFIX}{self.command}: expected {', '.join(missing)} among its arguments")
        self._program()

    @property
    def identity(self) -> dict[str, Any]:
        """The command, the digest of its program, its time limit and its seed."""
        program = digest(Path(self._program()))
        return {
            "policy": "command",
            "command": self.command,
            "program": program,
            "time_limit": self.time_limit,
            "seed": self.seed,
        }

    def __call__(self, keywords: dict[str, Any]) -> tuple[MapfEnv, PlannedPolicy]:
        """Return the environment and the policy."""
        env = parallel_env(**(Planner.env_kwargs | keywords))
        return env, PlannedPolicy(env, self.plan)

    def plan(self, instance: Instance, name: str) -> ExternalPlan:
        """Run the command for an instance, whose `.scen` file gets the name; raises `NoPlanError` if it fails."""
        with TemporaryDirectory(prefix="mapf-pz-") as folder:
            files = {part: Path(folder) / f"{part}.{part}" for part in ("map", "scen")}
            files["plan"] = Path(folder) / "plan.txt"
            grid = Grid(instance.grid.free, "map")  # the name of its file, which the other file names
            write_map(grid, files["map"])
            write_scenario(instance.scenario, grid, files["scen"])
            numbers = {"agents": instance.num_agents, "seconds": f"{self.time_limit:g}", "seed": self.seed}
            seconds = self._run({name: str(value) for name, value in (files | numbers).items()}, Path(folder))
            selection = Selection(instance.scenario, instance.num_agents, name)
            try:
                return ExternalPlan(read_plan(files["plan"], selection).plan, seconds)
            except FileNotFoundError:
                raise NoPlanError(f"the command wrote no plan in {seconds:.3g} s") from None
            except FormatError as error:
                raise NoPlanError(printable(str(error).replace(f"{folder}/", ""))) from None

    def _program(self) -> str:
        """Return the file of the program; raises `ValueError` if there is none."""
        try:
            arguments = shlex.split(self.command)
        except ValueError as error:
            raise ValueError(f"{PREFIX}{self.command}: {error}") from None
        program = shutil.which(arguments[0]) if arguments else None
        if program is None:
            raise ValueError(f"{PREFIX}{self.command}: expected a program, {arguments[:1]} is none")
        return program

    def _run(self, values: dict[str, str], folder: Path) -> float:
        """Run the command, and return how many seconds it took; raises `NoPlanError` if it fails."""
        arguments = [_PLACEHOLDER.sub(lambda match: values[match[1]], part) for part in shlex.split(self.command)]
        output = folder / "output"
        start = time.perf_counter()
        with output.open("wb") as out:
            # In a separate session, so that the processes that it starts are ended with it.
            process = subprocess.Popen(
                arguments, stdin=subprocess.DEVNULL, stdout=out, stderr=subprocess.STDOUT, start_new_session=True
            )
        try:
            status = process.wait(OVERTIME * self.time_limit)
        except subprocess.TimeoutExpired:
            raise NoPlanError(f"the command was ended after {OVERTIME * self.time_limit:g} s") from None
        finally:
            _end(process)
        seconds = time.perf_counter() - start
        if status:
            raise NoPlanError(f"the command failed with exit status {status}{_last_line(output)}")
        return seconds


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a command that still runs, and the processes that it has started."""
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def _last_line(file: Path) -> str:
    """Return the last line of a command's output, as the end of a message."""
    with file.open("rb") as output:
        output.seek(max(0, file.stat().st_size - _MAX_OUTPUT))
        lines = output.read().decode(errors="replace").split("\n")
    last = next((line.strip() for line in reversed(lines) if line.strip()), "")
    return f": {printable(last)}" if last else ""
