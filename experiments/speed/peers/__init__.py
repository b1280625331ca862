"""Other environments beside this one, each in a separate Python, since their dependencies conflict with those here.

A player, a file in this folder, runs in that Python, and prints a `Timing` as JSON.
"""

from __future__ import annotations

import json
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from experiments.speed.runs import Run, Timing
from experiments.speed.workload import Workload

SIMILAR = ("POGEMA", "  its dictionaries")
"""The most similar environment, with its own interface and with its PettingZoo interface."""


@dataclass(frozen=True)
class Peers:
    """Python interpreters in which other environments are installed."""

    pogema: str | None = None
    """Python interpreter with POGEMA 1.4.0 (`make bench`), which gets the same map, agents and size of view. None:
    POGEMA is omitted."""
    rware: str | None = None
    """Python interpreter with `rware` 2.0, whose four robots carry shelves in a warehouse of 11 x 10 cells. None:
    omitted."""
    jumanji: str | None = None
    """Python interpreter with Jumanji 1.1, whose `RobotWarehouse` and `Connector` run as compiled code of one thread in
    256 environments. None: omitted."""


def peer_runs(workload: Workload, peers: Peers) -> dict[str, Run]:
    """Return the runs of the peers that are available; raises `ValueError` for workloads that they do not support."""
    steps = {"max_steps": workload.env.max_steps, "seed": workload.seed}
    runs: dict[str, Run] = {}
    if peers.pogema is not None:
        options = _pogema_options(workload) | steps
        for name, integration in zip(SIMILAR, (None, "PettingZoo"), strict=True):
            runs[name] = _run(peers.pogema, "POGEMA 1.4.0", "pogema", options | {"integration": integration})
    if peers.rware is not None:
        runs["rware, 4 agents"] = _run(peers.rware, "rware 2.0", "rware", steps | {"num_agents": 4})
    if peers.jumanji is not None:
        for name, env in (("RobotWarehouse, 4 agents", "RobotWarehouse-v0"), ("Connector, 10 agents", "Connector-v2")):
            options = steps | {"env": env, "num_envs": 256}
            runs[f"Jumanji's {name}"] = _run(peers.jumanji, "Jumanji 1.1", "jumanji", options)
    return runs


def _pogema_options(workload: Workload) -> dict[str, Any]:
    """Return the map, agents and view of a workload for POGEMA; raises `ValueError` if it does not support them."""
    grid = workload.source.grid
    if grid is None or workload.env.view_size[0] != workload.env.view_size[1] or workload.env.view_size[0] % 2 == 0:
        raise ValueError("pogema: expected one map for all episodes, and a square view with an odd number of rows")
    rows = ["".join("." if free else "#" for free in row) for row in grid.free]
    return {"map": rows, "num_agents": workload.num_agents, "view_size": workload.env.view_size[0]}


def _run(python: str, package: str, name: str, options: dict[str, Any]) -> Run:
    """Return a run that starts a player in a process."""
    command = [python, str(Path(__file__).with_name(f"{name}_player.py")), json.dumps(options)]

    def run() -> Timing:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            reason = done.stderr.strip().rpartition("\n")[2]
            raise ValueError(f"{name}: {python} failed, is {package} installed? {reason}")
        return Timing(*json.loads(done.stdout))

    return run
