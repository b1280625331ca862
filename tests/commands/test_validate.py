import json

import numpy as np
import pytest

from mapf_pz.commands.main import main
from mapf_pz.guidance import GuidanceGraph, save_guidance
from mapf_pz.instances import write_map, write_scenario
from mapf_pz.instances.instance import Grid, Instance, Scenario
from mapf_pz.planners import Plan
from mapf_pz.planners.plans.files import write_plan

GRID = Grid(np.ones((2, 3), bool), "small")
SCENARIO = Scenario([[0, 0], [1, 2]], [[0, 2], [1, 0]])
CELLS = np.array([[(0, 0), (1, 2)], [(0, 1), (1, 1)], [(0, 2), (1, 0)]])
EAST = np.zeros((3, 2))


def run(capsys, *words):
    """Return the status and the lines of both outputs."""
    status = main(["validate", *map(str, words)])
    out, err = capsys.readouterr()
    return status, out.splitlines(), err.splitlines()


@pytest.fixture
def files(tmp_path):
    """A folder with a map, a scenario, and a problem of 2023 in which agents go east and back."""
    write_map(GRID, tmp_path / "small.map")
    write_scenario(SCENARIO, GRID, tmp_path / "small.scen")
    (tmp_path / "small.agents").write_text("1\n0\n")
    (tmp_path / "small.tasks").write_text("2\n1\n2\n")
    problem = {"mapFile": "small.map", "agentFile": "small.agents", "taskFile": "small.tasks", "teamSize": 1}
    (tmp_path / "2023.json").write_text(json.dumps(problem | {"taskAssignmentStrategy": "roundrobin"}))
    (tmp_path / "2024.json").write_text(json.dumps(problem | {"version": "2024 LoRR"}))
    return tmp_path


@pytest.mark.parametrize("ending", ["json", "csv", "txt"])
def test_a_legal_plan(capsys, files, ending):
    plan = files / f"plan.{ending}"
    write_plan(Plan(CELLS), plan, Instance(GRID, SCENARIO))
    makespan = {"json": ", as the file says", "csv": "", "txt": ", as the file says"}[ending]
    finished = {"json": ", as the file says", "csv": "", "txt": ""}[ending]
    expected = [
        f"{plan}: legal, 2 agents, 2 steps",
        "sum of costs: 4, as the file says",
        f"makespan: 2{makespan}",
        f"tasks finished: 2{finished}",
    ]
    options = [plan, "--map", files / "small.map", "--scenario", files / "small.scen"]
    assert run(capsys, *options) == (0, expected, [])
    assert run(capsys, *options, "--num-agents", 2) == (0, expected, [])
    assert run(capsys, plan, "--scenario", files / "small.scen") == (0, expected, [])  # which names the map


@pytest.mark.parametrize("ending", ["json", "txt"])
def test_starts_and_goals_of_the_file(capsys, files, ending):
    plan = files / f"plan.{ending}"
    write_plan(Plan(CELLS), plan, Instance(GRID, SCENARIO))
    status, out, err = run(capsys, plan, "--map", files / "small.map")
    assert (status, out[1:3], err) == (0, ["sum of costs: 4, as the file says", "makespan: 2, as the file says"], [])


def test_edge_weights(capsys, files):
    """Odd rows lead west and even columns north, at half the cost."""
    cells = np.array([[(0, 0), (1, 2)], [(0, 1), (1, 2)], [(0, 2), (1, 1)], [(0, 2), (1, 0)]])
    write_plan(Plan(cells), files / "plan.json", Instance(GRID, SCENARIO))
    words = [files / "plan.json", "--map", files / "small.map", "--scenario", files / "small.scen"]
    status, out, err = run(capsys, *words, "--edge-weights", "crisscross")
    assert (status, out[4:], err) == (0, ["weighted cost: 3"], [])  # 0.5 + 0.5, and 1 + 0.5 + 0.5
    quarter = GuidanceGraph(np.full((4, 2, 3), 0.25), np.ones((2, 3)))
    save_guidance(quarter.on_map(GRID.free), files / "graph.npz", GRID)
    assert run(capsys, *words, "--edge-weights", files / "graph.npz")[1][4:] == ["weighted cost: 2"]
    assert run(capsys, *words, "--edge-weights", "uniform")[1][4:] == ["weighted cost: 5"]
    error = "--edge-weights random: expected weights that do not differ between episodes"
    assert run(capsys, *words, "--edge-weights", "random") == (1, [], [f"mapf-pz validate: {error}"])


def test_edge_weights_need_one_goal_for_each_agent(capsys, files):
    write_plan(Plan(CELLS[:, :1], EAST[:, :1]), files / "plan.json", Instance(GRID, Scenario([[0, 0]], [[0, 2]]), [0]))
    words = [files / "plan.json", "--problem", files / "2023.json", "--edge-weights", "crisscross"]
    error = "mapf-pz validate: --edge-weights: expected a plan with one goal for each agent"
    assert run(capsys, *words) == (1, [], [error])


def test_an_illegal_plan(capsys, files):
    cells = CELLS.copy()
    cells[1, 1] = 1, 0
    write_plan(Plan(cells[[0, 0, 0]]), files / "plan.txt", Instance(GRID, SCENARIO))
    text = (files / "plan.txt").read_text().replace("1:(0,0),(2,1),", "1:(1,0),(0,1),")
    (files / "plan.txt").write_text(text)
    status, out, err = run(capsys, files / "plan.txt", "--map", files / "small.map", "--scenario", files / "small.scen")
    violation = "step 1: agent 1 at [row 1, col 0]: not a move to an adjacent cell, or not straight ahead"
    assert (status, out) == (1, [])
    assert err == [f"mapf-pz validate: {files}/plan.txt: not legal: {violation}"]


def test_wrong_claims(capsys, files):
    plan = files / "plan.json"
    write_plan(Plan(CELLS), plan, Instance(GRID, SCENARIO))
    plan.write_text(plan.read_text().replace('"sumOfCost": 4', '"sumOfCost": 3'))
    status, out, _ = run(capsys, plan, "--map", files / "small.map", "--scenario", files / "small.scen")
    assert (status, out[1]) == (0, "sum of costs: 4, but the file says 3")


def there_and_back():
    """Return the plan of an agent that gets the tasks 1, 2, 1, 2, ..., of which it finishes three."""
    cols = [0, 1, 2, 2, 2, 1]
    headings = [0, 0, 0, 1, 2, 2]
    return Plan(np.array([[(0, col)] for col in cols]), np.array(headings)[:, None])


def test_tasks_of_2023(capsys, files):
    plan = files / "plan.json"
    goals = np.array([[(0, 1), (0, 2)]])
    write_plan(there_and_back(), plan, Instance(GRID, Scenario([[0, 0]], goals)))
    for options in (["--problem", files / "2023.json"], ["--map", files / "small.map"]):
        status, out, err = run(capsys, plan, *options)
        assert (status, out[0], err) == (0, f"{plan}: legal, 1 agents, 5 steps", [])
        assert out[1:] == [
            f"{name}, as the file says" for name in ("sum of costs: 5", "makespan: 5", "tasks finished: 3")
        ]
    assert run(capsys, plan, "--map", files / "small.map", "--scenario", files / "small.scen")[0] == 1


def test_tasks_of_2024(capsys, files):
    plan = files / "plan.json"
    write_plan(there_and_back(), plan, Instance(GRID, Scenario([[0, 0]], [[[0, 1], [0, 2]]])))
    data = json.loads(plan.read_text()) | {"version": "2024 LoRR", "actualSchedule": ["1:0,2:1"]}
    data |= {"numTaskFinished": 2, "tasks": [[0, 0, [0, 1]], [1, 0, [0, 2]]]}
    plan.write_text(json.dumps(data))
    assert run(capsys, plan, "--problem", files / "2024.json")[1][3] == "tasks finished: 2, as the file says"
    plan.write_text(json.dumps({name: value for name, value in data.items() if name != "actualSchedule"}))
    unknown = "tasks finished: unknown, as the file does not contain the assigned tasks; the file says 2"
    assert run(capsys, plan, "--problem", files / "2024.json")[1][3] == unknown


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ([], "expected either --map or --scenario, or --problem"),
        (["--map", "empty-8-8", "--problem", "a.json"], "expected either --map or --scenario, or --problem"),
        (["--problem", "a.json", "--scenario", "a.scen"], "expected either --map or --scenario, or --problem"),
        (["--map", "empty-8-8", "--num-agents", "2"], "--num-agents: expected --scenario, too"),
        (["--map", "nowhere"], "no .map file is named 'nowhere'"),
        (["--map", "empty-8-8", "--scenario", "nowhere.scen"], "nowhere.scen: no such file"),
        (["--problem", "nowhere.json"], "nowhere.json: no such file"),
        (["--map", "empty-8-8"], "plan.csv: expected a scenario to be given"),
    ],
)
def test_errors(capsys, files, monkeypatch, options, message):
    monkeypatch.chdir(files)
    write_plan(Plan(CELLS), files / "plan.csv", Instance(GRID, SCENARIO))
    status, out, err = run(capsys, "plan.csv", *options)
    assert (status, out, len(err)) == (1, [], 1)
    assert message in err[0]


def test_a_plan_for_other_agents(capsys, files):
    write_plan(Plan(CELLS, EAST), files / "plan.txt", Instance(GRID, SCENARIO))
    status, _, err = run(capsys, files / "plan.txt", "--problem", files / "2023.json")
    assert (status, err) == (1, ["mapf-pz validate: plan: 2 agents, but the instance has 1"])


def test_a_published_plan_on_a_warehouse_map(capsys, benchmark):
    folder = benchmark / "lorr" / "planviz"
    status, out, err = run(capsys, folder / "warehouse_small_2024.json", "--map", folder / "warehouse_small.map")
    assert (status, out[3], err) == (0, "tasks finished: 33, as the file says", [])


def test_all_violations(capsys, files):
    """Each takes a line, which is followed by their number."""
    plan = files / "plan.json"
    waits = Plan(np.repeat(CELLS[:1], 3, axis=0))
    write_plan(waits, plan, Instance(GRID, SCENARIO))
    options = [plan, "--map", files / "small.map", "--scenario", files / "small.scen"]
    lines = [
        f"step 2: agent {agent} at [row {row}, col {col}]: not the agent's goal"
        for agent, (row, col) in enumerate(CELLS[0].tolist())
    ]
    assert run(capsys, *options, "--all") == (1, lines, [f"mapf-pz validate: {plan}: not legal: 2 violations"])
    status, out, err = run(capsys, *options)
    assert (status, out) == (1, [])
    assert err == [f"mapf-pz validate: {plan}: not legal: {lines[0]}"]
    write_plan(Plan(CELLS), plan, Instance(GRID, SCENARIO))
    assert run(capsys, *options, "--all")[0] == 0
