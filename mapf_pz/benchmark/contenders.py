"""Contenders: our interfaces, the parts of the simulator, a memory copy of the same observations, and POGEMA.

Every bout has one episode's length; the contenders take turns. POGEMA, the nearest peer, plays on the same map with as
many agents and as large views, if it is at hand.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from mapf_pz.benchmark.bouts import Bout, Measurement, Played, measure, timed
from mapf_pz.benchmark.load import Load
from mapf_pz.environment import parallel_env
from mapf_pz.types import Ints

SIMULATOR, COPY, POGEMA = "simulator", "memory copy", "POGEMA"


def simulator_bout(load: Load) -> Bout:
    """Step the simulator alone: all agents observe after every step, and environments that are over begin anew."""
    simulator = load.simulator()
    actions = _random_actions(load, simulator.num_actions)

    def play() -> int:
        for step in range(load.max_steps):
            simulator.step(actions[step])
            simulator.reset(np.flatnonzero(simulator.over).tolist())
            simulator.observe()
        return actions.size

    return timed(play)


def stepping_bout(load: Load) -> Bout:
    """Step only, on and on, also when episodes are over."""
    simulator = load.simulator()
    actions = _random_actions(load, simulator.num_actions)

    def play() -> int:
        for step in range(load.max_steps):
            simulator.step(actions[step])
        return actions.size

    return timed(play)


def observing_bout(load: Load) -> Bout:
    """Observe only."""
    simulator = load.simulator()

    def play() -> int:
        for _ in range(load.max_steps):
            simulator.observe()
        return load.max_steps * load.num_envs * load.num_agents

    return timed(play)


def copy_bout(load: Load) -> Bout:
    """Copy what all agents observe, in place of computing it."""
    observation = load.simulator().observe()

    def play() -> int:
        for _ in range(load.max_steps):
            for array in observation:
                array.copy()
        return load.max_steps * load.num_envs * load.num_agents

    return timed(play)


def pettingzoo_bout(load: Load) -> Bout:
    """Step one environment through its dictionaries."""
    env = parallel_env(**load.keywords())
    rng = np.random.default_rng(load.seed)
    actions = rng.integers(env.simulator.num_actions, size=(load.max_steps, load.num_agents)).tolist()
    env.reset(seed=load.seed)

    def play() -> int:
        for numbers in actions:
            env.step(dict(zip(env.possible_agents, numbers, strict=True)))
            if not env.agents:
                env.reset()
        return load.max_steps * load.num_agents

    return timed(play)


def torchrl_bout(load: Load) -> Bout:
    """Collect with TorchRL, by a random policy; raises `ImportError` without TorchRL."""
    from mapf_pz.rl import BatchedMapfEnv

    env = BatchedMapfEnv(load.num_envs, load.num_threads, **load.keywords())
    env.set_seed(load.seed)
    return _collector_bout(env, load.num_envs, load)


def wrapper_bout(load: Load) -> Bout:
    """Collect from the PettingZoo environment by TorchRL's own wrapper; raises `ImportError` without TorchRL."""
    return _collector_bout(parallel_env(**load.keywords()), 1, load)


def _collector_bout(env: Any, num_envs: int, load: Load) -> Bout:
    from mapf_pz.rl.collect import random_batches

    batches = random_batches(env, env.simulator, num_envs * load.max_steps)

    def play() -> int:
        return next(batches).numel() * load.num_agents

    return timed(play)


def pogema_bout(python: str, integration: str | None, load: Load) -> Bout:
    """Play in POGEMA, in a process of its own for each bout; raises `ValueError` for what POGEMA cannot do."""
    grid = load.source().grid
    if grid is None or load.view_size[0] != load.view_size[1] or load.view_size[0] % 2 == 0:
        raise ValueError("pogema: expected one map for all episodes, and a square view with an odd number of rows")
    asked = {
        "map": ["".join("." if free else "#" for free in row) for row in grid.free],
        "num_agents": load.num_agents,
        "view_size": load.view_size[0],
        "max_steps": load.max_steps,
        "seed": load.seed,
        "integration": integration,
    }
    command = [python, str(Path(__file__).with_name("pogema_player.py")), json.dumps(asked)]

    def bout() -> Played:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            reason = done.stderr.strip().rpartition("\n")[2]
            raise ValueError(f"pogema: {python} failed, is POGEMA 1.4.0 installed there? {reason}")
        return Played(*json.loads(done.stdout))

    return bout


CONTENDERS: dict[str, Callable[[Load], Bout]] = {
    SIMULATOR: simulator_bout,
    "  stepping": stepping_bout,
    "  observing": observing_bout,
    COPY: copy_bout,
    "PettingZoo": pettingzoo_bout,
}
TORCHRL_CONTENDERS: dict[str, Callable[[Load], Bout]] = {
    "TorchRL": torchrl_bout,
    "  PettingZooWrapper": wrapper_bout,
}
PEERS: dict[str, Callable[[str, Load], Bout]] = {
    POGEMA: lambda python, load: pogema_bout(python, None, load),
    "  its dictionaries": lambda python, load: pogema_bout(python, "PettingZoo", load),
}
"""The nearest peer, by its own interface, and by the one that it calls PettingZoo's."""


def contenders(load: Load, pogema: str | None) -> dict[str, Bout]:
    """Return the bouts of all that are at hand; `pogema` is a Python in which POGEMA is installed, or None."""
    makers = CONTENDERS | (TORCHRL_CONTENDERS if _has_torchrl() else {})
    bouts = {name: make(load) for name, make in makers.items()}
    if pogema is not None:
        bouts |= {name: make(pogema, load) for name, make in PEERS.items()}
    return bouts


def contender_table(load: Load, pogema: str | None, seconds: float) -> Table:
    """Measure all contenders: see `as_table`."""
    return as_table(measure(contenders(load, pogema), seconds))


def as_table(measured: dict[str, Measurement]) -> Table:
    """Return a table with a row each; the last columns compare rates with those of the memory copy, and of POGEMA."""
    left_out = None if _has_torchrl() else "TorchRL is left out: it needs the extra, pip install 'mapf-pz[train]'"
    table = Table(title="thousands of agent steps, medians of bouts", caption=left_out)
    table.add_column("")
    peers = [peer for peer in PEERS if peer in measured]
    for heading in ["per s", "per CPU s", "bouts", "of copy"] + [f"x {peer.strip()}" for peer in peers]:
        table.add_column(heading, justify="right")
    for one in measured.values():
        row = [
            f"{one.rate / 1000:,.0f}",
            f"{one.cpu_rate / 1000:,.0f}",
            str(one.num_bouts),
            f"{one.rate / measured[COPY].rate:.1%}",
        ]
        row += [f"{one.cpu_rate / measured[peer].cpu_rate:.1f}" for peer in peers]
        table.add_row(one.name, *row)
    return table


def _has_torchrl() -> bool:
    return find_spec("torchrl") is not None


def _random_actions(load: Load, num_actions: int) -> Ints:
    rng = np.random.default_rng(load.seed)
    return rng.integers(num_actions, size=(load.max_steps, load.num_envs, load.num_agents))
