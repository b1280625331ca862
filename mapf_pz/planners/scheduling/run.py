"""Run a problem whose tasks are assigned to agents during the episode."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mapf_pz._internal.arrays import Ints
from mapf_pz.guidance.library import EdgeWeights
from mapf_pz.instances.files.lorr import LorrProblem
from mapf_pz.instances.heading import Heading
from mapf_pz.instances.instance import Instance, Scenario
from mapf_pz.instances.sources import InstanceList
from mapf_pz.planners.base import Planner
from mapf_pz.planners.plans.files import Schedule
from mapf_pz.planners.plans.plan import Plan
from mapf_pz.planners.scheduling.pool import TaskPool
from mapf_pz.planners.scheduling.schedulers import Scheduler
from mapf_pz.simulator.config import EnvConfig
from mapf_pz.simulator.kernels.cost_tables import default_bytes
from mapf_pz.simulator.simulator import Simulator


@dataclass(frozen=True, eq=False)
class ScheduledRun:
    """The result of `run_problem`."""

    plan: Plan
    """The positions and headings of all agents."""
    num_finished: int
    """Number of finished tasks."""
    instance: Instance
    """The starts, and the goals that each agent visited in order (lifelong)."""
    schedule: Schedule
    """The tasks that were assigned to each agent."""


def run_problem(
    problem: LorrProblem,
    planner: Planner,
    scheduler: Scheduler,
    num_steps: int,
    seed: int = 0,
    edge_weights: EdgeWeights = "uniform",
) -> ScheduledRun:
    """Run a problem for `num_steps` steps; in each step, `scheduler` assigns tasks, then `planner` moves the agents.

    Agents turn, and are delayed as the problem says. The number of revealed tasks is the problem's `num_revealed`.
    Warns about other members of the problem that are not modeled.

    Raises:
        ValueError: The scheduler's assignment is not allowed.
    """
    problem.warn_not_modeled(except_for=("numTasksReveal",))
    simulator = _simulator(problem, num_steps, seed, edge_weights)
    pool = TaskPool(problem, problem.num_revealed)
    planner.compile("rotate")
    planner.reset_states()
    agents = simulator.agents[0]
    cells, headings = [simulator.positions(0)], [agents["heading"].copy()]
    visited: list[list[list[int]]] = [[] for _ in range(problem.team_size)]
    assigned: list[list[tuple[int, int]]] = [[] for _ in range(problem.team_size)]
    revealed = dict.fromkeys(pool.tasks.tolist(), 0)
    for step in range(1, num_steps + 1):
        next_cells = pool.next_cells()
        places = scheduler(pool, simulator.costs_to(next_cells), pool.lengths())
        pool.assign(places)
        for entries, task in zip(assigned, pool.tasks[places].tolist(), strict=True):
            if not entries or entries[-1][1] != task:
                entries.append((step, task))
        simulator.set_goals(next_cells[places])
        simulator.step(planner.decide(simulator)[None])
        for agent in np.flatnonzero(agents["arrived"]):
            visited[agent].append(next_cells[places[agent]].tolist())
        pool.visit(agents["arrived"])
        revealed = dict.fromkeys(pool.tasks.tolist(), step) | revealed
        cells.append(simulator.positions(0))
        headings.append(agents["heading"].copy())
    scenario = _scenario(problem, visited, simulator.goals(0))
    instance = Instance(problem.grid, scenario, np.full(problem.team_size, Heading.EAST))
    tasks = {number: problem.task(number) for number in sorted(revealed)}
    schedule = Schedule(tuple(map(tuple, assigned)), tasks, revealed)
    return ScheduledRun(Plan(np.stack(cells), np.stack(headings)), pool.num_finished, instance, schedule)


def _simulator(problem: LorrProblem, num_steps: int, seed: int, edge_weights: EdgeWeights) -> Simulator:
    """Return a simulator with all agents on their starts, which are their first goals, and with room for all tasks."""
    headings = np.full(problem.team_size, Heading.EAST)
    num_goals, table_bytes = problem.team_size + problem.num_revealed, 20 * (problem.grid.free.size + 1)
    config = EnvConfig(
        source=InstanceList(
            [Instance(problem.grid, Scenario(problem.starts, problem.starts), headings, problem.delays)]
        ),
        on_target="restart",
        max_steps=num_steps,
        view_size=(1, 1),
        edge_weights=edge_weights,
        distance_bytes=default_bytes(num_goals * table_bytes),
    )
    simulator = Simulator(config)
    simulator.reset(seeds={0: seed})
    return simulator


def _scenario(problem: LorrProblem, visited: list[list[list[int]]], current: Ints) -> Scenario:
    """Return the starts, and the visited and current goals of all agents."""
    counts = [len(cells) + 1 for cells in visited]
    goals = np.repeat(current[:, None], max(counts), axis=1)
    for agent, cells in enumerate(visited):
        goals[agent, : len(cells)] = np.reshape(cells, (-1, 2))
    return Scenario(problem.starts, goals, np.array(counts))
