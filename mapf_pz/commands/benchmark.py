"""How fast environments step: the command `mapf-pz benchmark`.

Every contender plays bouts of one episode's length with random actions; the contenders take turns, so that a slow spell
of the machine meets all of them. A copy of the same observations tells how far from the memory's speed they are.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from statistics import median
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from mapf_pz.config import EnvConfig
from mapf_pz.environment import parallel_env
from mapf_pz.instances import RandomObstacles
from mapf_pz.simulator import Simulator

LEAST_BOUTS = 3


@dataclass(frozen=True)
class BenchmarkOptions:
    """What is stepped, and for how long."""

    map: str | None = None
    """A map's name or the path of a `.map` file; None draws a new random map for every episode."""
    height: int = 20
    """Rows of a random map."""
    width: int = 20
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
    """Decides episodes and actions."""

    def keywords(self) -> dict[str, Any]:
        """Return the keywords of `parallel_env`."""
        keywords = {"view_size": self.view_size, "max_steps": self.max_steps, "num_agents": self.num_agents}
        if self.map is not None:
            return keywords | {"map": self.map}
        return keywords | {"source": RandomObstacles(self.height, self.width, self.density, self.num_agents)}


Bout = Callable[[], int]
"""Plays for `max_steps` steps, and returns how many steps agents took."""


@dataclass(frozen=True)
class Measurement:
    """What came of a contender's bouts."""

    name: str
    """Who played."""
    rate: float
    """Agent steps per second, the median of all bouts."""
    cpu_rate: float
    """Agent steps per CPU second of all threads, the median of all bouts."""
    wall: float
    """Seconds of all bouts."""
    cpu: float
    """CPU seconds of all bouts, of all threads."""
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

    return play


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

    return play


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

    return play


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

    return play


TORCHRL, COPY = "TorchRL", "memory copy"
CONTENDERS: dict[str, Callable[[BenchmarkOptions], Bout]] = {
    "simulator": simulator_bout,
    "PettingZoo": pettingzoo_bout,
    TORCHRL: torchrl_bout,
    COPY: copy_bout,
}
"""What is measured, by name."""


def measure(bouts: dict[str, Bout], seconds: float) -> list[Measurement]:
    """Let all play in turns for about so many seconds in all, after one bout each that does not count."""
    for play in bouts.values():
        play()
    results: dict[str, list[tuple[int, float, float]]] = {name: [] for name in bouts}
    began = time.perf_counter()
    num_rounds = 0
    while num_rounds < LEAST_BOUTS or time.perf_counter() - began < seconds:
        num_rounds += 1
        for name, play in bouts.items():
            wall, cpu = time.perf_counter(), time.process_time()
            steps = play()
            results[name].append((steps, time.perf_counter() - wall, time.process_time() - cpu))
    return [_summary(name, played) for name, played in results.items()]


def _summary(name: str, played: list[tuple[int, float, float]]) -> Measurement:
    return Measurement(
        name,
        rate=median(steps / wall for steps, wall, _ in played),
        cpu_rate=median(steps / cpu for steps, _, cpu in played),
        wall=sum(wall for _, wall, _ in played),
        cpu=sum(cpu for _, _, cpu in played),
        num_bouts=len(played),
    )


def as_table(measurements: list[Measurement]) -> Table:
    """Return a table with a row each; the last column compares the rates with that of the memory copy."""
    copied = next(one.rate for one in measurements if one.name == COPY)
    table = Table(title="agent steps, medians of bouts")
    table.add_column("")
    for heading in ("per second", "per CPU second", "bouts", "wall [s]", "CPU [s]", "of the copy"):
        table.add_column(heading, justify="right")
    for one in measurements:
        rates = [f"{one.rate:,.0f}", f"{one.cpu_rate:,.0f}", str(one.num_bouts)]
        table.add_row(one.name, *rates, f"{one.wall:.2f}", f"{one.cpu:.2f}", f"{one.rate / copied:.1%}")
    return table


def benchmark(load: BenchmarkOptions) -> None:
    """Measure how fast environments step with random actions, and print a table."""
    console = Console()
    contenders = CONTENDERS.copy()
    if find_spec("torchrl") is None:
        console.print(f"{TORCHRL} is left out: it needs the extra, pip install 'mapf-pz[train]'")
        del contenders[TORCHRL]
    bouts = {name: prepare(load) for name, prepare in contenders.items()}
    console.print(as_table(measure(bouts, load.seconds)))
