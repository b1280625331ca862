"""Schedulers: the rules of the task pool, which tasks they choose, and whole runs."""

import json
import re
import warnings
from dataclasses import replace

import numpy as np
import pytest

from mapf_pz.commands.main import main
from mapf_pz.instances.delays import Delays
from mapf_pz.instances.files.lorr import LorrProblem
from mapf_pz.instances.instance import Grid
from mapf_pz.instances.load import load_problem
from mapf_pz.planners import EPIBT, PIBT, validate
from mapf_pz.planners.plans.files import read_plan
from mapf_pz.planners.plans.plan import reached
from mapf_pz.planners.scheduling import SCHEDULERS, run_problem
from mapf_pz.planners.scheduling.pool import NONE, TaskPool


def problem_of(starts, tasks, reveal=1.5, free=None):
    """A problem on an empty 6 x 6 map."""
    return LorrProblem(
        grid=Grid(np.ones((6, 6), np.bool_) if free is None else free),
        starts=np.array(starts, np.int32),
        errands=np.concatenate(tasks).astype(np.int32),
        offsets=np.cumsum([0, *map(len, tasks)]),
        strategy="entrant",
        version="2024 LoRR",
        reveal=reveal,
    )


def random_problem(num_agents, seed):
    rng = np.random.default_rng(seed)
    free = rng.random((8, 8)) < 0.9
    free[::7] = free[:, ::7] = True  # the border connects most cells
    grid = Grid(free)
    cells = np.argwhere(free)
    connected = [cell for cell in cells.tolist() if not _is_enclosed(free, *cell)]
    starts = rng.permutation(connected)[:num_agents]
    tasks = [rng.choice(connected, rng.integers(1, 5)) for _ in range(40)]
    return LorrProblem(
        grid=grid,
        starts=starts.astype(np.int32),
        errands=np.concatenate(tasks).astype(np.int32),
        offsets=np.cumsum([0, *map(len, tasks)]),
        strategy="entrant",
        version="2024 LoRR",
        reveal=1.5,
    )


def _is_enclosed(free, row, col):
    """Whether the cell is not joined to the border."""
    seen, stack = set(), [(row, col)]
    while stack:
        r, c = stack.pop()
        if (r, c) in seen or not (0 <= r < 8 and 0 <= c < 8) or not free[r, c]:
            continue
        if r in (0, 7) or c in (0, 7):
            return False
        seen.add((r, c))
        stack += [(r + 1, c), (r - 1, c), (r, c + 1), (r, c - 1)]
    return True


THREE_TASKS = ([[0, 4], [0, 0]], [[5, 5]], [[0, 1], [5, 0], [0, 0]])


def test_the_pool_reveals_the_next_task_when_one_is_finished():
    pool = TaskPool(problem_of([[0, 0]], THREE_TASKS), num_revealed=2)
    pool.assign(np.array([1]))
    assert pool.next_cells().tolist() == [[0, 4], [5, 5]]
    pool.visit(np.array([False]))
    assert (pool.num_finished, pool.tasks.tolist()) == (0, [0, 1])
    pool.visit(np.array([True]))
    assert (pool.num_finished, pool.tasks.tolist(), pool.owner.tolist()) == (1, [0, 2], [NONE, NONE])
    assert pool.lengths().tolist() == [4, 11]
    pool.assign(np.array([0]))
    pool.visit(np.array([True]))
    assert pool.next_cells().tolist() == [[0, 0], [0, 1]]
    pool.visit(np.array([True]))
    assert pool.tasks.tolist() == [3, 2]
    assert pool.next_cells()[0].tolist() == [0, 4]  # the tasks start over


def test_assignments_that_are_not_allowed():
    pool = TaskPool(problem_of([[0, 0], [1, 0]], THREE_TASKS), num_revealed=3)
    with pytest.raises(ValueError, match=r"^assignment: expected a different task for each agent$"):
        pool.assign(np.array([1, 1]))
    pool.assign(np.array([0, 1]))
    pool.assign(np.array([1, 0]))  # neither was started
    pool.visit(np.array([False, True]))
    with pytest.raises(ValueError, match=r"^assignment: expected tasks that were started to stay with their agents$"):
        pool.assign(np.array([0, 2]))
    with pytest.raises(ValueError, match=r"^num_revealed=1: expected at least 2, one for each agent$"):
        TaskPool(problem_of([[0, 0], [1, 0]], THREE_TASKS), num_revealed=1)


@pytest.mark.parametrize(
    ("name", "first", "later"),
    [("keep", [0, 1], [0, 1]), ("nearest", [0, 1], [2, 1]), ("shortest", [2, 0], [2, 1])],
)
def test_which_tasks_are_chosen(name, first, later):
    pool = TaskPool(problem_of([[0, 0], [1, 0]], THREE_TASKS), num_revealed=3)
    lengths = np.array([9, 1, 0], np.float32)
    costs = np.array([[1, 9, 2], [3, 12, 13]] if name == "shortest" else [[1, 3, 2], [3, 2, 4]], np.float32)
    places = SCHEDULERS[name](pool, costs, lengths)
    assert places.tolist() == first
    pool.assign(places)
    costs = np.array([[5, 3, 2], [9, 2, 4]], np.float32)
    assert SCHEDULERS[name](pool, costs, lengths).tolist() == later


@pytest.mark.parametrize("name", SCHEDULERS)
def test_started_tasks_stay_with_their_agents(name):
    pool = TaskPool(problem_of([[0, 0], [1, 0]], THREE_TASKS), num_revealed=3)
    pool.assign(np.array([0, 2]))
    pool.visit(np.array([True, False]))
    assert SCHEDULERS[name](pool, np.array([[99, 0, 0], [0, 1, 2]], np.float32), np.zeros(3, np.float32))[0] == 0


def test_one_agent_finishes_tasks_as_fast_as_it_can():
    """It turns and moves: 3 steps to [0, 3]; then a turn and 2 steps to [2, 3], and a turn and 3 steps to [2, 0]."""
    problem = problem_of([[0, 0]], [[[0, 3], [2, 3]], [[2, 0]]], reveal=1)
    run = run_problem(problem, PIBT(), SCHEDULERS["keep"], num_steps=10)
    assert run.num_finished == 2
    assert run.instance.scenario.goals[0, :3].tolist() == [[0, 3], [2, 3], [2, 0]]
    assert reached(run.plan.positions[:, 0], run.instance.scenario.goals[0]) == [3, 6, 10]


@pytest.mark.parametrize("name", SCHEDULERS)
@pytest.mark.parametrize("planner", [PIBT, EPIBT])
def test_a_run_is_legal_and_visits_all_errands_in_order(planner, name):
    problem = random_problem(num_agents=12, seed=3)
    run = run_problem(problem, planner(seed=1), SCHEDULERS[name], num_steps=120)
    assert validate(run.instance, run.plan) is None
    goals, counts = run.instance.scenario.goals, run.instance.scenario.goal_counts
    for agent in range(12):
        steps = reached(run.plan.positions[:, agent], goals[agent, : counts[agent]])
        assert len(steps) >= counts[agent] - 1
    visits = int((counts - 1).sum())
    assert 0 < run.num_finished <= visits
    assert run.schedule.finished(run.plan) == run.num_finished
    assert len(run.schedule.visits(run.plan)) == visits
    again = run_problem(problem, planner(seed=1), SCHEDULERS[name], num_steps=120)
    assert np.array_equal(again.plan.positions, run.plan.positions)


def test_the_command(tmp_path, capsys):
    folder = tmp_path / "problem"
    folder.mkdir()
    (folder / "m.map").write_text("type octile\nheight 3\nwidth 4\nmap\n....\n....\n....\n")
    (folder / "m.agents").write_text("2\n0\n5\n")
    (folder / "m.tasks").write_text("3\n3,8\n11\n2,1,0\n")
    files = {"mapFile": "m.map", "agentFile": "m.agents", "taskFile": "m.tasks"}
    text = json.dumps({**files, "teamSize": 2, "numTasksReveal": 1.5, "version": "2024 LoRR"})
    (folder / "p.json").write_text(text)
    assert load_problem(folder / "p.json").num_revealed == 3
    plan = tmp_path / "plan.json"
    words = ["schedule", str(folder / "p.json"), str(plan), "--planner", "pibt", "--num-steps", "40"]
    assert main(words) == 0
    out = capsys.readouterr().out
    assert out.startswith("p: 2 agents finished ")
    finished = int(out.split("finished ")[1].split()[0])
    file = read_plan(plan)
    assert file.plan.num_steps == 40
    assert file.claims["tasks finished"] == file.schedule.finished(file.plan) == finished > 0
    # As in the files of the competition: [step, agent, task, number of visited errands], and [task, step, errands].
    data = json.loads(plan.read_text())
    assert data["version"] == "2024 LoRR"
    assert [visits for *_, visits in data["events"]].count(1) >= len({task for _, _, task, _ in data["events"]})
    assert data["tasks"][:3] == [[0, 0, [0, 3, 2, 0]], [1, 0, [2, 3]], [2, 0, [0, 2, 0, 1, 0, 0]]]
    last_errands = {task: len(cells) // 2 for task, _, cells in data["tasks"]}
    ends = [step for step, _, task, visits in data["events"] if visits == last_errands[task]]
    assert sorted(step for _, step, _ in data["tasks"] if step) == sorted(ends)  # when the next one is revealed
    for source in (["--problem", str(folder / "p.json")], ["--map", str(folder / "m.map")]):
        assert main(["validate", str(plan), *source]) == 0
        assert f"tasks finished: {finished}, as the file says" in capsys.readouterr().out
    assert main([*words, "--scheduler", "best"]) == 1
    assert "scheduler 'best': expected one of keep, nearest, shortest" in capsys.readouterr().err
    (folder / "p.json").write_text(text.replace("1.5", "0"))
    assert main(words) == 1
    assert "expected 'numTasksReveal' above 0, up to 1000, got 0" in capsys.readouterr().err


@pytest.mark.parametrize("members", [("agentCounter",), ("numTasksReveal", "agentCounter"), ("numTasksReveal",), ()])
def test_what_is_not_modeled_is_reported(members):
    problem = replace(random_problem(num_agents=2, seed=0), not_modeled=members)
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        run_problem(problem, PIBT(), SCHEDULERS["keep"], num_steps=2)
    expected = "problem: not modeled: 'agentCounter'; results are not comparable with the competition's"
    assert [str(warning.message) for warning in found] == [expected] * ("agentCounter" in members)


def test_delayed_agents_finish_fewer_tasks():
    problem = random_problem(num_agents=2, seed=0)
    late = replace(problem, delays=Delays(1.0, (30, 30)))
    runs = [run_problem(one, PIBT(), SCHEDULERS["keep"], num_steps=20) for one in (problem, late)]
    assert runs[0].num_finished > runs[1].num_finished == 0
    assert (runs[1].plan.positions == runs[1].plan.positions[0]).all()


def test_validate_counts_what_a_scheduler_has_assigned(tmp_path, capsys):
    """Also for a problem whose tasks are assigned in turn otherwise."""
    plan = str(tmp_path / "plan.json")
    assert main(["schedule", "warehouse_small_10", plan, "--planner", "pibt", "--num-steps", "60"]) == 0
    assert main(["validate", plan, "--problem", "warehouse_small_10"]) == 0
    finished = capsys.readouterr().out.splitlines()[-1]
    assert re.fullmatch(r"tasks finished: [1-9]\d*, as the file says", finished)
