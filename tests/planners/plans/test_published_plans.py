"""Published plans are legal in a replay, with the costs and finished tasks that their files claim."""

import json
from itertools import cycle

import numpy as np
import pytest

from mapf_pz.errors import FormatError
from mapf_pz.instances import InstanceList, load_instance, load_problem, read_map
from mapf_pz.instances.instance import Instance, Scenario
from mapf_pz.planners import Plan, validate
from mapf_pz.planners.plans.files import Selection, format_plan, parse_plan, read_plan
from mapf_pz.planners.plans.plan import reached
from mapf_pz.planners.problem import Path
from mapf_pz.simulator import Simulator
from mapf_pz.simulator.config import EnvConfig

IN_2023 = {  # plan: problem, agents, steps, tasks finished
    "archive-2023-main/best_solutions/MR23-I-03": ("archive-2023-main/random.domain/MR23-I-03", 200, 500, 3042),
    "archive-2023-main/best_solutions/MR23-I-04": ("archive-2023-main/random.domain/MR23-I-04", 100, 500, 1741),
    "planviz/warehouse_small_2023": ("archive-2023-example/warehouse.domain/EI23-warehouse_small_60", 60, 103, 100),
}
IN_2024 = {
    "archive-2024-test/best_solutions/TR24-random_32_32_20_100": (
        "archive-2024-test/random.domain/random_32_32_20_100", 100, 500, 1186
    ),
    "archive-2024-test/best_solutions/TR24-paris_1_256_250": (
        "archive-2024-test/city.domain/paris_1_256_250", 250, 500, 456
    ),
    "archive-2024-main/best_solutions/MR24-RANDOM-02": ("archive-2024-main/random.domain/RANDOM-02", 200, 600, 1260),
}  # fmt: skip
WITHOUT_SCHEDULE = {
    "archive-2024-main/best_solutions/MR24-RANDOM-01": ("archive-2024-main/random.domain/RANDOM-01", 100, 600, 696),
    "archive-2024-main/best_solutions/MR24-RANDOM-03": ("archive-2024-main/random.domain/RANDOM-03", 400, 800, 2368),
    "archive-2024-main/best_solutions/MR24-RANDOM-04": ("archive-2024-main/random.domain/RANDOM-04", 700, 1000, 2585),
}
OF_PLANVIZ = {  # plan: agents, steps or ticks, tasks finished
    "planviz/warehouse_small_2023": (60, 103, 100),
    "planviz/warehouse_small_2024": (20, 100, 33),
    "planviz/warehouse_small_2026": (200, 1000, 387),
}


def read(benchmark, name):
    return read_plan(benchmark / "lorr" / f"{name}.json")


def problem_of(benchmark, name):
    return load_problem(benchmark / "lorr" / f"{name}.json")


def without_goals(grid, plan):
    """Return a lifelong instance with the plan's starts, as its own goals."""
    return Instance(grid, Scenario(plan.positions[0], plan.positions[0][:, None]), plan.headings[0])


def replayed(instance, plan):
    """Return the number of arrivals in the simulator, which must follow the plan at every step."""
    simulator = Simulator(
        EnvConfig(
            source=InstanceList([instance]), on_target="restart", view_size=(1, 1), max_steps=max(plan.num_steps, 1)
        )
    )
    simulator.reset(seeds={0: 0})
    cells = plan.positions @ np.array([instance.grid.shape[1], 1])
    agents = simulator.agents[0]
    for step, actions in enumerate(Path(cells, plan.headings).actions(simulator.world.leads_to[0]), 1):
        simulator.step(actions[None])
        assert not agents["blocked"].any()
        assert np.array_equal(agents["cell"], cells[step])
        assert np.array_equal(agents["heading"], plan.headings[step])
    return int(agents["arrivals"].sum())


@pytest.mark.parametrize("name", IN_2023)
def test_plans_of_2023(benchmark, name):
    problem_name, num_agents, num_steps, finished = IN_2023[name]
    file, instance = read(benchmark, name), problem_of(benchmark, problem_name).instance()
    assert validate(instance, file.plan) is None
    assert (file.plan.num_agents, file.plan.num_steps) == (num_agents, num_steps)
    assert file.claims == {"sum of costs": num_agents * num_steps, "makespan": num_steps, "tasks finished": finished}
    paths = file.plan.positions.swapaxes(0, 1)
    arrivals = [reached(path, cycle(goals)) for path, goals in zip(paths, instance.scenario.goals, strict=True)]
    assert sum(map(len, arrivals)) == finished
    assert file.schedule.finished(file.plan) == finished
    assert replayed(instance, file.plan) == finished


@pytest.mark.parametrize("name", IN_2023)
def test_plans_of_2023_are_written_with_the_same_events(benchmark, name):
    file, instance = read(benchmark, name), problem_of(benchmark, IN_2023[name][0]).instance()
    published = json.loads((benchmark / "lorr" / f"{name}.json").read_text())
    written = json.loads(format_plan(file.plan, "a.json", instance))
    for key in ("actionModel", "start", "numTaskFinished", "sumOfCost", "makespan", "actualPaths", "events", "tasks"):
        assert written[key] == published[key], key
    assert written.keys() == published.keys()


@pytest.mark.parametrize("name", IN_2024)
def test_plans_of_2024(benchmark, name):
    problem_name, num_agents, num_steps, finished = IN_2024[name]
    file, problem = read(benchmark, name), problem_of(benchmark, problem_name)
    instance = without_goals(problem.grid, file.plan)
    assert (file.plan.num_agents, file.plan.num_steps) == (num_agents, num_steps)
    assert np.array_equal(file.plan.positions[0], problem.starts)
    assert validate(instance, file.plan) is None
    assert file.claims["tasks finished"] == finished
    assert file.schedule.finished(file.plan, problem.task) == finished
    assert file.schedule.finished(file.plan) == finished
    replayed(instance, file.plan)


@pytest.mark.parametrize("name", WITHOUT_SCHEDULE)
def test_plans_without_a_schedule(benchmark, name):
    problem_name, num_agents, num_steps, finished = WITHOUT_SCHEDULE[name]
    file, problem = read(benchmark, name), problem_of(benchmark, problem_name)
    instance = without_goals(problem.grid, file.plan)
    assert (file.plan.num_agents, file.plan.num_steps) == (num_agents, num_steps)
    assert np.array_equal(file.plan.positions[0], problem.starts)
    assert validate(instance, file.plan) is None
    assert file.schedule is None
    assert file.claims == {"makespan": num_steps, "tasks finished": finished}
    replayed(instance, file.plan)


@pytest.mark.parametrize("name", OF_PLANVIZ)
def test_the_plans_of_planviz(benchmark, name):
    num_agents, num_steps, finished = OF_PLANVIZ[name]
    file = read(benchmark, name)
    instance = without_goals(read_map(benchmark / "lorr" / "planviz" / "warehouse_small.map"), file.plan)
    assert (file.plan.num_agents, file.plan.num_steps) == (num_agents, num_steps)
    assert validate(instance, file.plan) is None
    assert file.schedule.finished(file.plan) == file.claims["tasks finished"] == finished
    replayed(instance, file.plan)


def test_a_plan_of_cardinal_agents(benchmark):
    file = read(benchmark, "planviz/mapf_plan_example")
    scenario = benchmark / "scens" / "random-32-32-20-random-1.scen"
    instance = load_instance(benchmark / "maps" / "random-32-32-20.map", scenario, 300, "cardinal")
    assert validate(instance, file.plan) is None
    assert np.array_equal(file.goals, instance.scenario.goals)
    costs = {"sum of costs": 9647, "makespan": 59, "tasks finished": 300}
    assert file.claims == costs
    assert (file.plan.sum_of_costs, file.plan.makespan) == (9647, 59)
    tracker = benchmark / "costs" / "tracker-plan-random-32-32-20-random-1-300agents.csv"
    assert np.array_equal(read_plan(tracker, Selection(instance.scenario)).plan.positions, file.plan.positions)


@pytest.mark.parametrize("kind", ["even", "random"])
@pytest.mark.parametrize("num_agents", range(1, 6))
def test_tracker_plans(benchmark, kind, num_agents):
    name = f"random-32-32-20-{kind}-1"
    scenario = benchmark / "scens" / f"{name}.scen"
    instance = load_instance(benchmark / "maps" / "random-32-32-20.map", scenario, num_agents, "cardinal")
    selection = Selection(instance.scenario, num_agents, name)
    file = read_plan(benchmark / "costs" / "tracker-plans-random-32-32-20.csv", selection)
    assert validate(instance, file.plan) is None
    assert file.claims == {"sum of costs": file.plan.sum_of_costs}


# Broken copies.


@pytest.fixture(scope="module")
def best(benchmark):
    """A published plan: its text, the plan, and the instance."""
    name = "archive-2023-main/best_solutions/MR23-I-04"
    text = (benchmark / "lorr" / f"{name}.json").read_text()
    return text, parse_plan(text, "plan").plan, problem_of(benchmark, IN_2023[name][0]).instance()


def violation_of(best, change_cells=None, change_text=None):
    text, plan, instance = best
    if change_cells is not None:
        cells = plan.positions.copy()
        change_cells(cells)
        return validate(instance, Plan(cells, plan.headings))
    data = json.loads(text)
    change_text(data)
    return validate(instance, parse_plan(json.dumps(data), "plan").plan)


def test_swapped_agents(best):
    def swap(cells):
        cells[200, [3, 70]] = cells[200, [70, 3]]

    violation = violation_of(best, swap)
    assert (violation.kind, violation.step, violation.agents) == ("move", 200, (3,))


def test_a_jump(best):
    occupied = set(map(tuple, best[1].positions[300].tolist()))
    cell = next(cell for cell in np.argwhere(best[2].grid.free).tolist() if tuple(cell) not in occupied)

    def jump(cells):
        cells[300, 41] = cell

    violation = violation_of(best, jump)
    assert (violation.kind, violation.step, violation.agents) == ("move", 300, (41,))


def test_a_move_into_an_obstacle(best):
    _, plan, instance = best
    steps = np.array([(0, 1), (1, 0), (0, -1), (-1, 0)])
    ahead = plan.positions[:-1] + steps[plan.headings[:-1]]
    inside = ((ahead >= 0) & (ahead < instance.grid.shape)).all(axis=2)
    clipped = np.clip(ahead, 0, 31)
    step, agent = np.argwhere(inside & ~instance.grid.free[clipped[..., 0], clipped[..., 1]])[5].tolist()

    def move(data):
        letters = data["actualPaths"][agent].split(",")
        letters[step] = "F"
        data["actualPaths"][agent] = ",".join(letters)

    violation = violation_of(best, change_text=move)
    assert (violation.kind, violation.step, violation.agents) == ("map", step + 1, (agent,))
    assert violation.cells == (tuple(ahead[step, agent].tolist()),)


def test_a_wrong_start(best):
    def move(data):
        data["start"][7][2] = "N"

    violation = violation_of(best, change_text=move)
    assert (violation.kind, violation.step, violation.agents) == ("start", 0, (7,))


def test_a_missing_letter(best):
    def shorten(data):
        data["actualPaths"][9] = data["actualPaths"][9][:-2]

    with pytest.raises(FormatError, match=r"^plan: expected 500 steps for agent 9, as for agent 0, got 499$"):
        violation_of(best, change_text=shorten)


def test_a_missing_letter_and_an_extra_wait(best):
    """The agent does everything one step early, until it collides."""

    def hurry(data):
        data["actualPaths"][9] = data["actualPaths"][9][2:] + ",W"

    violation = violation_of(best, change_text=hurry)
    assert violation is not None
    assert 9 in violation.agents
