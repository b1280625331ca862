"""Measure the numbers of docs/benchmark.md that `mapf-pz evaluate` does not provide.

`python -m experiments.planners.benchmark COMMAND`. All commands but `speed` read files from the
benchmark folders in `MAPF_PZ_BENCHMARK`.
"""

from __future__ import annotations

import math
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from functools import partial
from itertools import product
from typing import Any

import numpy as np
import tyro

from mapf_pz._internal.parallel import run_jobs
from mapf_pz.evaluation.tracker import known_cost
from mapf_pz.instances import FixedMap, InstanceList, load_instance, load_map
from mapf_pz.instances.instance import ActionModel, Instance, Scenario
from mapf_pz.instances.library import benchmark_file
from mapf_pz.planners import EPIBT, PIBT, LaCAM, Planner, planner_of, validate
from mapf_pz.planners.pibt.planner import PREFERENCES, PRIORITIES
from mapf_pz.simulator import Simulator
from mapf_pz.simulator.config import EnvConfig
from tests.helpers.reference_planners import ACTION, SlowEPIBT, SlowPIBT, World


def print_table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Print a table in Markdown."""
    for row in (header, ["---"] * len(header), *rows):
        print("|", " | ".join(map(str, row)), "|", flush=True)


def tracker(
    map: str = "random-32-32-20",
    num_agents: tuple[int, ...] = (100, 200, 400),
    scenarios: tuple[int, ...] = tuple(range(1, 11)),
    time_limits: tuple[float, ...] = (0.0, 1.0, 30.0),
    jobs: int = 1,
) -> None:
    """Print LaCAM's sum of costs (cardinal agents) divided by the best known one of the MAPF tracker.

    Args:
        map: name of the map.
        num_agents: numbers of agents.
        scenarios: numbers of `random` scenarios.
        time_limits: time limits in seconds of CPU time; 0: the first solution.
        jobs: number of processes.
    """
    tasks = [(n, k) for n in num_agents for k in scenarios]
    found: dict[int, list[dict[float, tuple[int, float]]]] = defaultdict(list)
    ratios: dict[int, list[list[float]]] = defaultdict(list)
    for n, k, costs in run_jobs(partial(_solve, map, time_limits), tasks, jobs):
        found[n].append(costs)
        lower, best_known = known_cost(f"{map}-random-{k}", n)
        below = [cost for cost, _ in costs.values() if cost < lower]
        if below:
            raise AssertionError(f"scenario {k}, {n} agents: {below} is below the published bound {lower}")
        best = best_known or math.nan
        ratios[n].append([costs[limit][0] / best if limit in costs else math.nan for limit in time_limits])
    for n in num_agents:
        rows = [
            [
                f"{limit:g} s" if limit else "first solution",
                f"{sum(limit in costs for costs in found[n])} of {len(found[n])}",
                f"{np.nanmean([row[at] for row in ratios[n]]):.3f}",
                f"{np.mean([costs[limit][0] for costs in found[n] if limit in costs]):.0f}",
                f"{np.mean([costs[limit][1] for costs in found[n] if limit in costs]):.2f} s",
            ]
            for at, limit in enumerate(time_limits)
        ]
        print_table([f"{map}, {n} agents", "solved", "SoC / best known", "SoC", "time"], rows)


def _solve(
    map: str, time_limits: Sequence[float], task: tuple[int, int]
) -> tuple[int, int, dict[float, tuple[int, float]]]:
    """Return the number of agents, the scenario, and the cost and time for each time limit."""
    num_agents, scenario = task
    instance = load_instance(map, f"{map}-random-{scenario}", num_agents, action_model="cardinal")
    costs: dict[float, tuple[int, float]] = {}
    for limit in time_limits:
        planner = LaCAM(anytime=limit > 0)
        planner.clock = time.thread_time
        planner.compile("cardinal")
        start = planner.clock()
        plan = planner.solve(instance, time_limit=limit or 30.0, max_steps=10_000)
        if plan is not None:
            if (violation := validate(instance, plan)) is not None:
                raise AssertionError(f"scenario {scenario}, {num_agents} agents: {violation}")
            costs[limit] = plan.sum_of_costs, planner.clock() - start
    return num_agents, scenario, costs


def speed(num_agents: tuple[int, ...] = (100, 200, 400), steps: int = 100, runs: int = 5) -> None:
    """Print the time per lifelong step on random-32-32-20, and that of the same planner in plain Python.

    Both plan the same steps, with identical decisions. Times are medians over the steps of the best run in
    milliseconds.
    """
    grid = load_map("random-32-32-20")
    world = World(grid.free)
    rows: list[list[object]] = []
    planners: dict[str, tuple[Callable[[], Planner], Callable[[], Any]]] = {
        "PIBT": (PIBT, partial(SlowPIBT, world)),
        "EPIBT(3)": (partial(EPIBT, depth=3), partial(SlowEPIBT, world, 3)),
    }
    for name, (make, make_slow) in planners.items():
        for n in num_agents:
            times = [_race(FixedMap(grid, n), world, make(), make_slow(), steps) for _ in range(runs)]
            ours, slow = min(ours for ours, _ in times), min(slow for _, slow in times)
            rows.append([name, n, f"{ours:.3f}", f"{slow:.2f}", f"{slow / ours:.1f}"])
    print_table(["planner", "agents", "ms per step", "plain Python", "ratio"], rows)


def _race(source: FixedMap, world: World, planner: Planner, slow: Any, steps: int) -> tuple[float, float]:
    """Return the median milliseconds per step of both planners."""
    simulator = Simulator(EnvConfig(source=source, on_target="restart", max_steps=steps, view_size=(1, 1)))
    simulator.reset(seeds={0: 0})
    agents = simulator.agents[0]
    ours, theirs = np.zeros(steps), np.zeros(steps)
    seen = []
    for step in range(steps):
        simulator.require_cost_to_go()
        start = time.perf_counter_ns()
        actions = planner.decide(simulator)
        ours[step] = time.perf_counter_ns() - start
        goals = list(map(tuple, simulator.goals(0).tolist()))
        positions = simulator.positions(0).tolist()
        states = [(*cell, heading) for cell, heading in zip(positions, agents["heading"].tolist(), strict=True)]
        seen.append((states, goals, actions.tolist()))
        simulator.step(actions[None])
    for step, (states, goals, actions) in enumerate(seen):
        for goal in goals:
            world.to_go(goal)
        start = time.perf_counter_ns()
        letters = slow.decide(states, goals)
        theirs[step] = time.perf_counter_ns() - start
        if actions != [ACTION[letter] for letter in letters]:
            raise AssertionError(f"step {step}: the planners decide differently")
    return float(np.median(ours)) / 1e6, float(np.median(theirs)) / 1e6


CROWDS = {
    "random-32-32-20": 400,
    "random-64-64-10": 1000,
    "empty-48-48": 1000,
    "room-32-32-4": 200,
    "room-64-64-16": 1000,
    "maze-32-32-4": 390,
    "den312d": 1200,
    "warehouse-10-20-10-2-1": 500,
    "warehouse-10-20-10-2-2": 1000,
}
"""Maps with many agents, for lifelong episodes."""
FEWER = {
    "random-32-32-10": 200,
    "random-32-32-20": 100,
    "empty-32-32": 300,
    "room-32-32-4": 100,
    "room-64-64-16": 200,
    "maze-32-32-4": 50,
    "den312d": 200,
    "warehouse-10-20-10-2-1": 100,
    "warehouse-10-20-10-2-2": 300,
}
"""Maps with fewer agents, for episodes in which each agent stays at its one goal."""


def ablation(
    model: ActionModel = "cardinal", lifelong: bool = True, episodes: int = 5, steps: int = 1000, jobs: int = 1
) -> None:
    """Print PIBT's results with all combinations of its options, as means with standard errors.

    Args:
        model: action model.
        lifelong: goals reached per step in lifelong episodes; otherwise the share of episodes in which all agents are
            at their goals at the same time (CSR), and the sum of costs over its lower bound.
        episodes: number of episodes on each map; the same for all combinations.
        steps: length of an episode.
        jobs: number of processes.
    """
    priorities = PRIORITIES if lifelong else ("late",)
    options = [
        f"priority={priority},swap={swap},preference={preference}"
        for priority, swap, preference in product(priorities, (False, True), PREFERENCES)
    ]
    crowds = CROWDS if lifelong else FEWER
    tasks = [(map, seed, option) for map in crowds for seed in range(episodes) for option in options]
    found: dict[tuple[str, str], list[Sequence[float]]] = defaultdict(list)
    for map, option, figures in run_jobs(partial(_play, model, lifelong, steps), tasks, jobs):
        found[map, option].append(figures)
    rows = [[option, *(_mean_and_error(found[map, option]) for map in crowds)] for option in options]
    print_table([f"{model}, `pibt:`", *(f"{map}, {n} agents" for map, n in crowds.items())], rows)


def _mean_and_error(figures: Sequence[Sequence[float]]) -> str:
    """Return the means of each of the figures with standard errors."""
    means, errors = np.mean(figures, axis=0), np.std(figures, axis=0, ddof=1) / math.sqrt(len(figures))
    return ", ".join(f"{mean:.3g} ± {error:.2g}" for mean, error in zip(means, errors, strict=True))


def _play(
    model: ActionModel, lifelong: bool, steps: int, task: tuple[str, int, str]
) -> tuple[str, str, tuple[float, ...]]:
    """Return the map, the options, and the figures of an episode."""
    map, seed, option = task
    num_agents = (CROWDS if lifelong else FEWER)[map]
    config = EnvConfig(
        source=FixedMap(load_map(map), num_agents),
        on_target="restart" if lifelong else "nothing",
        max_steps=steps,
        action_model=model,
        **Planner.env_kwargs,
    )
    simulator, planner = Simulator(config), planner_of(f"pibt:{option}", seed)
    simulator.reset(seeds={0: seed})
    planner.compile(model)
    while not simulator.over[0]:
        simulator.step(planner.decide(simulator)[None])
    metrics = simulator.metrics(0)
    names = ("avg_throughput",) if lifelong else ("CSR", "SoC_ratio")
    return map, option, tuple(metrics[name] for name in names)


def epibt(
    num_agents: tuple[int, ...] = (100, 400),
    policies: tuple[str, ...] = ("pibt", "epibt:depth=3", "epibt:depth=4", "epibt:depth=3,rounds=10"),
    steps: int = 1000,
) -> None:
    """Print the tasks finished on the instances of the EPIBT paper, `epibt-instances/random` of the benchmark folders.

    Args:
        num_agents: numbers of agents, multiples of 100 up to 800; all face east and turn.
        policies: planners with options.
        steps: length of the episode.
    """
    rows = []
    for n in num_agents:
        for policy in policies:
            instance = _epibt_instance(n, num_goals=steps // 4)
            config = EnvConfig(
                source=InstanceList([instance]), on_target="restart", max_steps=steps, **Planner.env_kwargs
            )
            simulator, planner = Simulator(config), planner_of(policy)
            simulator.reset(seeds={0: 0})
            planner.compile("rotate")
            seconds = 0.0
            while not simulator.over[0]:
                simulator.require_cost_to_go()
                start = time.process_time()
                actions = planner.decide(simulator)
                seconds += time.process_time() - start
                simulator.step(actions[None])
            rows.append([policy, n, simulator.agents[0]["arrivals"].sum(), f"{1000 * seconds / steps:.3f}"])
    print_table(["policy", "agents", "tasks", "ms per step (CPU)"], rows)


def _epibt_instance(num_agents: int, num_goals: int) -> Instance:
    """Return the instance of the EPIBT paper in which agent k gets the tasks k, k + N, ..."""
    folder = "epibt-instances/random"
    grid = load_map(benchmark_file(f"{folder}/map.txt"))
    starts = np.loadtxt(
        benchmark_file(f"{folder}/agents_{num_agents // 100 - 1}.csv"), int, delimiter=",", skiprows=1, usecols=(1, 2)
    )
    tasks = np.loadtxt(benchmark_file(f"{folder}/tasks_one.csv"), int, skiprows=1)
    goals = tasks[: num_agents * num_goals].reshape(num_goals, num_agents).T
    scenario = Scenario(starts, np.stack(np.divmod(goals, grid.shape[1]), axis=-1))
    return Instance(grid, scenario, np.zeros(num_agents, np.int64))


if __name__ == "__main__":
    tyro.extras.subcommand_cli_from_dict({"tracker": tracker, "speed": speed, "ablation": ablation, "epibt": epibt})
