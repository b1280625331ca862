"""Memory and time with many agents."""

from __future__ import annotations

import resource
import sys
import time

import numpy as np

from mapf_pz.instances import load_map
from mapf_pz.instances.instance import ActionModel, Grid, Instance, Scenario
from mapf_pz.instances.place import largest_component
from mapf_pz.instances.sources import InstanceList
from mapf_pz.planners import Planner, planner_of
from mapf_pz.simulator import Simulator
from mapf_pz.simulator.config import EnvConfig


def main(
    num_agents: int,
    map: str = "",
    planner: str = "pibt",
    action_model: ActionModel = "rotate",
    num_goals: int | None = None,
    steps: int = 50,
    num_threads: int = 1,
) -> None:
    """Run a planner with many agents in a lifelong episode, and print its time and memory.

    Prints the time and the memory of the cost to go to all first goals, then medians over steps of the time to compute
    the cost to go to new goals, to plan, and to take the step.

    Args:
        num_agents: Number of agents.
        map: Name or file of a map. Default: 640 x 640 cells, 10 % of them obstacles.
        planner: Planner.
        action_model: Action model.
        num_goals: Number of cells that goals are sampled from. Default: all cells.
        steps: Number of steps.
        num_threads: Number of threads that compute the cost to go and take steps.
    """
    rng = np.random.default_rng(0)
    grid = load_map(map) if map else Grid(rng.random((640, 640)) >= 0.1)
    cells = largest_component(grid.free)
    targets = rng.permutation(cells)[:num_goals]
    scenario = Scenario(rng.permutation(cells)[:num_agents], rng.choice(targets, (num_agents, 100)))
    config = EnvConfig(
        source=InstanceList([Instance(grid, scenario)]),
        action_model=action_model,
        on_target="restart",
        max_steps=steps + 1,
        view_size=(1, 1),
        distance_bytes=2**34,
    )
    simulator = Simulator(config, num_threads=num_threads)
    simulator.reset(seeds={0: 0})
    start = time.perf_counter()
    simulator.require_cost_to_go()
    seconds = time.perf_counter() - start
    tables = int((simulator.tables.arrays.slot >= 0).sum())
    print(f"{num_agents} agents on {grid.shape} cells, {tables} goals: {seconds:.1f} s, {memory():.2f} GB")
    chosen = planner_of(planner)
    chosen.compile(action_model)
    times = np.array([_step(simulator, chosen) for _ in range(steps)])[1:]
    arrived = simulator.agents["arrivals"].sum() / steps
    parts = ("cost to go", "plan", "step")
    print(", ".join(f"{part} {ms:.1f} ms" for part, ms in zip(parts, 1000 * np.median(times, axis=0), strict=True)))
    print(f"{1000 * np.median(times.sum(axis=1)):.1f} ms a step, {arrived:.1f} goals a step, {memory():.2f} GB")


def _step(simulator: Simulator, planner: Planner) -> list[float]:
    """Take a step; return the seconds that its parts took."""
    times = [time.perf_counter()]
    simulator.require_cost_to_go()
    times.append(time.perf_counter())
    actions = planner.decide(simulator)
    times.append(time.perf_counter())
    simulator.step(actions[None])
    times.append(time.perf_counter())
    return np.diff(times).tolist()


def memory() -> float:
    """Return the largest resident memory of this process in GB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024) / 1e9
