"""`mapf-pz execute`: the execution of plans under delays."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from mapf_pz.commands.main import main
from mapf_pz.instances import load_map, write_map, write_scenario
from mapf_pz.instances.delays import Delays
from mapf_pz.instances.instance import Grid, Instance, Scenario
from mapf_pz.planners import DependencyGraph, Plan, execute_delayed, validate
from mapf_pz.planners.plans import delayed
from mapf_pz.planners.plans.files import read_plan, write_plan
from mapf_pz.planners.plans.record import record_execution
from mapf_pz.render.recording import episode_data

GRID = Grid(np.ones((1, 4), bool), "corridor")
SCENARIO = Scenario([[0, 1], [0, 0]], [[0, 3], [0, 2]])
INSTANCE = Instance(GRID, SCENARIO)
PLAN = Plan(np.array([[(0, 1), (0, 0)], [(0, 2), (0, 1)], [(0, 3), (0, 2)]]))


def run(capsys, *words):
    """Return the status and the lines of both outputs."""
    status = main(["execute", *map(str, words)])
    out, err = capsys.readouterr()
    return status, out.splitlines(), err.splitlines()


@pytest.fixture
def options(tmp_path):
    """A plan of two agents, one behind the other, and its map and scenario."""
    write_map(GRID, tmp_path / "corridor.map")
    write_scenario(SCENARIO, GRID, tmp_path / "corridor.scen")
    write_plan(PLAN, tmp_path / "plan.json", INSTANCE)
    return [tmp_path / "plan.json", "--map", tmp_path / "corridor.map", "--scenario", tmp_path / "corridor.scen"]


def test_without_delays_the_costs_are_those_of_the_plan(capsys, options):
    costs = "sum of costs 4, makespan 2"
    assert run(capsys, *options, "--delays", "0:1-1") == (
        0,
        [
            f"{options[0]}: {costs}, 2 agents, 2 dependencies",
            f"seed 0: {costs}; if no agent waited for others: {costs}",
        ],
        [],
    )


def test_several_seeds_and_their_mean(capsys, options):
    delays, graph = Delays(0.3, (1, 3)), DependencyGraph.from_plan(PLAN, INSTANCE)
    expected = [execute_delayed(graph, delays, seed) for seed in (1, 2, 3)]
    costs = [one.plan.sum_of_costs for one in expected]
    assert len(set(costs)) > 1
    status, lines, _ = run(capsys, *options, "--delays", "0.3:1-3", "--seeds", 1, 2, 3)
    assert status == 0
    for seed, one, line in zip((1, 2, 3), expected, lines[1:], strict=False):
        alone = f"sum of costs {one.costs_alone.sum()}, makespan {one.costs_alone.max()}"
        done = f"sum of costs {one.plan.sum_of_costs}, makespan {one.plan.makespan}"
        assert line == f"seed {seed}: {done}; if no agent waited for others: {alone}"
    assert lines[4].startswith(f"mean: sum of costs {np.mean(costs):.6g}, makespan ")


def test_files(capsys, options, tmp_path):
    output, graph = tmp_path / "new.txt", tmp_path / "graph.json"
    words = ("--delays", "0.5:2-2", "--seeds", 4, "--output", output, "--graph", graph)
    assert run(capsys, *options, *words)[0] == 0
    loaded = DependencyGraph.from_json(graph.read_text())
    assert loaded == DependencyGraph.from_plan(PLAN, INSTANCE)
    executed = read_plan(output).plan
    assert np.array_equal(executed.positions, execute_delayed(loaded, Delays(0.5, (2, 2)), 4).plan.positions)
    assert validate(INSTANCE, executed) is None


def test_an_execution_knows_who_was_delayed_and_who_waited():
    execution = execute_delayed(DependencyGraph.from_plan(PLAN, INSTANCE), Delays(0.5, (2, 2)), 4)
    moved = (np.diff(execution.plan.positions, axis=0) != 0).any(axis=2)
    left = np.arange(execution.plan.num_steps)[:, None] < execution.plan.costs
    waited = left & ~moved & ~execution.delayed
    assert waited[:, 1].any()
    assert execution.waits_for.tolist() == np.where(waited, [[-1, 0]], -1).tolist()
    assert (execution.delayed & left).any(axis=0).all()
    recording = record_execution(INSTANCE, execution)
    for values, name in ((recording.delayed, "delayed"), (recording.waits_for, "waits_for")):
        assert values[1:].tolist() == getattr(execution, name).tolist()
    assert not recording.delayed[0].any()
    assert (recording.waits_for[0] == -1).all()


def test_the_page_is_that_of_the_first_seed(capsys, options, tmp_path):
    page = tmp_path / "execution.html"
    assert run(capsys, *options, "--delays", "0.5:2-2", "--seeds", 4, 5, "--page", page)[0] == 0
    [shown] = json.loads(re.search(r'id="data">(.*)</script>', page.read_text("utf-8"))[1])["episodes"]
    execution = execute_delayed(DependencyGraph.from_plan(PLAN, INSTANCE), Delays(0.5, (2, 2)), 4)
    assert shown["arrays"] == episode_data(record_execution(INSTANCE, execution))["arrays"]
    assert shown["facts"] == {"plan": "plan.json", "delays": "0.5:2-2", "seed": "4"}
    assert shown["metrics"] == {"SoC": execution.plan.sum_of_costs, "makespan": execution.plan.makespan}


def test_delays_of_a_problem(capsys, tmp_path, monkeypatch):
    """They are those of its file, unless others are given."""
    monkeypatch.setattr(delayed, "MAX_STEPS", 1000)
    write_map(load_map("empty-8-8"), tmp_path / "a.map")
    for name, cells in (("agents", [0, 8]), ("tasks", [3, 11])):
        (tmp_path / f"a.{name}").write_text("\n".join(map(str, [2, *cells])))
    problem = {"mapFile": "a.map", "agentFile": "a.agents", "taskFile": "a.tasks", "teamSize": 2}
    problem |= {"delayConfig": {"pDelay": 1, "minDelay": 1, "maxDelay": 1}}
    (tmp_path / "a.json").write_text(json.dumps(problem))
    plan = Plan(np.array([[(0, 0), (1, 0)], [(0, 1), (1, 1)]]), np.zeros((2, 2)))
    scenario = Scenario([[0, 0], [1, 0]], [[0, 1], [1, 1]])
    write_plan(plan, tmp_path / "plan.txt", Instance(load_map("empty-8-8"), scenario))
    words = [tmp_path / "plan.txt", "--problem", tmp_path / "a.json"]
    status, _, errors = run(capsys, *words)
    assert status == 1
    assert errors[0].startswith("mapf-pz execute: delays=1.0:1-1: the execution has not ended after ")
    assert run(capsys, *words, "--delays", "0:1-1")[0] == 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--delays", "often"), "expected PROBABILITY:SMALLEST-LARGEST, optionally with :poisson and :normal"),
        (("--output", "plan.png"), "plan.png: expected a file name that ends in .json, .csv, .txt"),
        (("--page", "page.svg"), "page.svg: expected a file name that ends in .html"),
        (("--num-agents", "1"), "plan: 2 agents, but the instance has 1"),
    ],
)
def test_bad_options(capsys, options, words, message):
    status, _, errors = run(capsys, *options, *words)
    assert status == 1
    assert message in errors[0]


def test_an_illegal_plan(capsys, options):
    write_plan(Plan(np.array([[(0, 1), (0, 0)], [(0, 1), (0, 1)]])), Path(options[0]), INSTANCE)
    message = "step 1: agent 0 and agent 1 at [row 0, col 1]: two agents on one cell"
    assert run(capsys, *options) == (1, [], [f"mapf-pz execute: {options[0]}: not legal: {message}"])
