"""How fast environments step: the command `mapf-pz benchmark`.

Every contender plays bouts of one episode's length with random actions; the contenders take turns, so that a slow spell
of the machine meets all of them. A copy of the same observations tells how far from the memory's speed they are; and
POGEMA, the nearest peer, plays on the same map with as many agents and as large views, if it is at hand.
"""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from mapf_pz.config import EnvConfig
from mapf_pz.environment import parallel_env
from mapf_pz.instances import FixedMap, RandomObstacles, load_map
from mapf_pz.simulator import Simulator
from mapf_pz.types import InstanceSource

LEAST_BOUTS = 5


@dataclass(frozen=True)
class BenchmarkOptions:
    """What is stepped, and for how long."""

    map: str | None = None
    """A map's name or the path of a `.map` file; None draws a random map."""
    height: int = 32
    """Rows of a random map."""
    width: int = 32
    """Columns of a random map."""
    density: float = 0.2
    """Share of obstacles on a random map."""
    num_agents: int = 8
    """The number of agents."""
    num_envs: int = 64
    """Environments stepped together, where there is a batch."""
    num_threads: int = 1
    """Threads of the kernels."""
    view_size: tuple[int, int] = EnvConfig.view_size
    """(rows, columns) of each agent's view."""
    max_steps: int = EnvConfig.max_steps
    """Steps of an episode, and of a bout."""
    seconds: float = 10.0
    """Length of the measurement; a few bouts are played in any case."""
    seed: int = 0
    """Decides maps, episodes and actions."""
    new_maps: bool = False
    """Draw a new random map for every episode, instead of one for all."""
    complete: bool = False
    """Observe the cost to go and what each action is worth besides, and earn progress."""
    pogema: str | None = None
    """A Python in which POGEMA 1.4.0 is installed (`make bench-peers`); None leaves it out."""

    def keywords(self) -> dict[str, Any]:
        """Return the keywords of `parallel_env`."""
        keywords: dict[str, Any] = {"view_size": self.view_size, "max_steps": self.max_steps}
        if self.complete:
            channels = (*EnvConfig.channels, "cost_to_go")
            keywords |= {"channels": channels, "features": ("action_advantage",), "reward": "progress"}
        return keywords | {"source": self.source()}

    def source(self) -> InstanceSource:
        """Return where episodes come from; raises `ValueError` where not all agents fit."""
        if self.map is not None:
            return FixedMap(load_map(self.map), self.num_agents)
        maps = RandomObstacles(self.height, self.width, self.density, self.num_agents)
        return maps if self.new_maps else FixedMap(maps.sample(np.random.default_rng(self.seed)).grid, self.num_agents)


class Played(NamedTuple):
    """What a contender did in one bout."""

    steps: int
    """Steps that agents took."""
    wall: float
    """Seconds."""
    cpu: float
    """CPU seconds of all threads."""


Bout = Callable[[], Played]
"""Plays for `max_steps` steps."""


def timed(play: Callable[[], int]) -> Bout:
    """Make a bout out of what returns how many steps agents took."""

    def bout() -> Played:
        wall, cpu = time.perf_counter(), time.process_time()
        steps = play()
        return Played(steps, time.perf_counter() - wall, time.process_time() - cpu)

    return bout


@dataclass(frozen=True)
class Measurement:
    """What came of a contender's bouts."""

    name: str
    """Who played."""
    rate: float
    """Agent steps per second, the median of all bouts."""
    cpu_rate: float
    """Agent steps per CPU second of all threads, the median of all bouts."""
    num_bouts: int
    """How many bouts."""


def simulator_bout(options: BenchmarkOptions) -> Bout:
    """Step the simulator alone: all agents observe after every step, and environments that are over begin anew."""
    simulator = Simulator(EnvConfig.from_keywords(**options.keywords()), options.num_envs, options.num_threads)
    each = (options.num_envs, options.num_agents)
    rng = np.random.default_rng(options.seed)
    actions = rng.integers(simulator.num_actions, size=(options.max_steps, *each))
    simulator.reset(seeds={b: options.seed + b for b in range(options.num_envs)})

    def play() -> int:
        for step in range(options.max_steps):
            simulator.step(actions[step])
            simulator.reset(np.flatnonzero(simulator.over).tolist())
            simulator.observe()
        return actions.size

    return timed(play)


def pettingzoo_bout(options: BenchmarkOptions) -> Bout:
    """Step one environment through its dictionaries."""
    env = parallel_env(**options.keywords())
    rng = np.random.default_rng(options.seed)
    actions = rng.integers(env.simulator.num_actions, size=(options.max_steps, options.num_agents)).tolist()
    env.reset(seed=options.seed)

    def play() -> int:
        for numbers in actions:
            env.step(dict(zip(env.possible_agents, numbers, strict=True)))
            if not env.agents:
                env.reset()
        return options.max_steps * options.num_agents

    return timed(play)


def torchrl_bout(options: BenchmarkOptions) -> Bout:
    """Step the TorchRL environment, as a collector does but without keeping; raises `ImportError` without TorchRL."""
    from mapf_pz.rl.batched_env import BatchedMapfEnv

    env = BatchedMapfEnv(options.num_envs, options.num_threads, **options.keywords())
    env.set_seed(options.seed)
    data = env.reset()

    def play() -> int:
        nonlocal data
        for _ in range(options.max_steps):
            _, data = env.step_and_maybe_reset(env.rand_action(data))
        return options.max_steps * options.num_envs * options.num_agents

    return timed(play)


def copy_bout(options: BenchmarkOptions) -> Bout:
    """Copy what all agents observe, in place of computing it."""
    simulator = Simulator(EnvConfig.from_keywords(**options.keywords()), options.num_envs, options.num_threads)
    simulator.reset(seeds={b: options.seed + b for b in range(options.num_envs)})
    observation = simulator.observe()

    def play() -> int:
        for _ in range(options.max_steps):
            for array in observation:
                array.copy()
        return options.max_steps * options.num_envs * options.num_agents

    return timed(play)


def pogema_bout(integration: str | None, options: BenchmarkOptions) -> Bout:
    """Play in POGEMA, in a process of its own for each bout; raises `ValueError` for what POGEMA cannot do."""
    grid = options.source().grid
    if grid is None or options.view_size[0] != options.view_size[1] or options.view_size[0] % 2 == 0:
        raise ValueError("pogema: expected one map for all episodes, and a square view with an odd number of rows")
    asked = {
        "map": ["".join("." if free else "#" for free in row) for row in grid.free],
        "num_agents": options.num_agents,
        "view_size": options.view_size[0],
        "max_steps": options.max_steps,
        "seed": options.seed,
        "integration": integration,
    }
    command = [str(options.pogema), str(Path(__file__).with_name("pogema_player.py")), json.dumps(asked)]

    def bout() -> Played:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            reason = done.stderr.strip().rpartition("\n")[2]
            raise ValueError(f"pogema: {command[0]} failed, is POGEMA 1.4.0 installed there? {reason}")
        return Played(*json.loads(done.stdout))

    return bout


TORCHRL, COPY = "TorchRL", "memory copy"
CONTENDERS: dict[str, Callable[[BenchmarkOptions], Bout]] = {
    "simulator": simulator_bout,
    "PettingZoo": pettingzoo_bout,
    TORCHRL: torchrl_bout,
    COPY: copy_bout,
}
"""What is measured, by name."""
PEERS: dict[str, Callable[[BenchmarkOptions], Bout]] = {
    "POGEMA": partial(pogema_bout, None),
    "its dicts": partial(pogema_bout, "PettingZoo"),
}
"""The nearest peer, by its own interface, and by the one that it calls PettingZoo's."""


def measure(bouts: dict[str, Bout], seconds: float) -> list[Measurement]:
    """Let all play in turns for about so many seconds in all, after one bout each that does not count."""
    for play in bouts.values():
        play()
    results: dict[str, list[Played]] = {name: [] for name in bouts}
    began = time.perf_counter()
    num_rounds = 0
    while num_rounds < LEAST_BOUTS or time.perf_counter() - began < seconds:
        num_rounds += 1
        for name, play in bouts.items():
            results[name].append(play())
    return [_summary(name, played) for name, played in results.items()]


def _summary(name: str, played: list[Played]) -> Measurement:
    return Measurement(
        name,
        rate=median(one.steps / one.wall for one in played),
        cpu_rate=median(one.steps / one.cpu for one in played),
        num_bouts=len(played),
    )


def as_table(measurements: list[Measurement]) -> Table:
    """Return a table with a row each; the last columns compare rates with those of the memory copy, and of POGEMA."""
    by_name = {one.name: one for one in measurements}
    table = Table(title="thousands of agent steps, medians of bouts")
    table.add_column("")
    headings = ["per s", "per CPU s", "bouts", "of copy"]
    for heading in headings + [f"x {peer}" for peer in PEERS if peer in by_name]:
        table.add_column(heading, justify="right")
    for one in measurements:
        row = [
            f"{one.rate / 1000:,.0f}",
            f"{one.cpu_rate / 1000:,.0f}",
            str(one.num_bouts),
            f"{one.rate / by_name[COPY].rate:.1%}",
        ]
        row += [f"{one.cpu_rate / by_name[peer].cpu_rate:.1f}" for peer in PEERS if peer in by_name]
        table.add_row(one.name, *row)
    return table


def benchmark(load: BenchmarkOptions) -> None:
    """Measure how fast environments step with random actions, and print a table."""
    console = Console()
    contenders = CONTENDERS.copy()
    if find_spec("torchrl") is None:
        console.print(f"{TORCHRL} is left out: it needs the extra, pip install 'mapf-pz[train]'")
        del contenders[TORCHRL]
    if load.pogema is not None:
        contenders |= PEERS
    bouts = {name: prepare(load) for name, prepare in contenders.items()}
    console.print(as_table(measure(bouts, load.seconds)))
