"""Costs that the MAPF tracker knows."""

import csv

import numpy as np
import pytest

from mapf_pz.commands.main import main
from mapf_pz.errors import FormatError
from mapf_pz.evaluation import EvaluationTask, evaluate
from mapf_pz.evaluation.tracker import KnownCost, known_cost
from mapf_pz.instances import load_map, write_scenario
from mapf_pz.instances.instance import Instance, Scenario

HEADER = '"scen_type","type_id","agents","lower_cost","lower_date","solution_cost","solution_date"\n'
ROWS = [
    ("even", 1, 2, "10.2", "14"),
    ("even", 1, 1, "4", "4"),
    ("even", 1, 3, "9", ""),
    ("random", 1, 2, "7", "7"),
    ("even", 10, 2, "100", "100"),
]


@pytest.fixture
def write(tmp_path, monkeypatch):
    """Return a function that writes the file of a map into the folder of benchmark data."""
    monkeypatch.setenv("MAPF_PZ_BENCHMARK", str(tmp_path))
    monkeypatch.setenv("MAPF_PZ_CACHE", str(tmp_path / "cache"))
    (tmp_path / "costs").mkdir()

    def write_rows(rows, header=HEADER, name="empty-8-8"):
        lines = [f'"{kind}","{number}","{agents}","{low}","","{best}",""\n' for kind, number, agents, low, best in rows]
        (tmp_path / "costs" / f"tracker-bounds-{name}.csv").write_text("\ufeff" + header + "".join(lines))

    return write_rows


@pytest.mark.parametrize(
    ("scenario", "num_agents", "expected"),
    [
        ("empty-8-8-even-1", 1, (4, 4)),
        ("empty-8-8-even-1", 2, (11, 14)),  # bounds are rounded up
        ("empty-8-8-even-1", 3, (11, None)),  # that of fewer agents
        ("empty-8-8-even-1", 4, (11, None)),
        ("empty-8-8-random-1", 2, (7, 7)),
        ("empty-8-8-even-10", 2, (100, 100)),
        ("empty-8-8-even-2", 2, (0, None)),
        ("empty-16-16-even-1", 2, (0, None)),
        ("mine", 2, (0, None)),
        ("", 2, (0, None)),
    ],
)
def test_known_costs(write, scenario, num_agents, expected):
    write(ROWS)
    assert known_cost(scenario, num_agents) == KnownCost(*expected)


@pytest.mark.parametrize(
    ("rows", "header", "message"),
    [
        (ROWS, '"scen_type","agents"\n', "expected the columns type_id, lower_cost, solution_cost"),
        ([("even", 1, 2, "x", "3")], HEADER, "expected numbers of agents and costs: "),
        ([("even", 1, 2, "1", "3.5")], HEADER, "expected numbers of agents and costs: "),
        ([("even", 1, 2, "inf", "3")], HEADER, "expected numbers of agents and costs: "),
    ],
)
def test_malformed_files(write, rows, header, message):
    write(rows, header)
    with pytest.raises(FormatError, match=message):
        known_cost("empty-8-8-even-1", 2)


def crossing(folder):
    """Write `empty-8-8-even-1.scen`, whose two agents have shortest paths of 7 steps, and return it."""
    scenario = Scenario(np.array([[0, 0], [1, 0]]), np.array([[0, 7], [1, 7]]))
    file = folder / "empty-8-8-even-1.scen"
    write_scenario(scenario, load_map("empty-8-8"), file)
    return file


def test_an_evaluation_compares_with_the_best_known_cost(write, tmp_path, capsys):
    write(ROWS)
    words = ["--policy", "pibt", "--scenario", str(crossing(tmp_path)), "--max-steps", "20"]
    for options, expected in (
        (["--action-model", "cardinal"], "1.0"),  # 14 / 14
        (["--action-model", "rotate"], ""),
        (["--action-model", "cardinal", "--on-target", "finish"], ""),
        (["--action-model", "cardinal", "--num-agents", "1"], str(7 / 4)),
        (["--action-model", "cardinal", "--max-steps", "3"], ""),  # not solved
    ):
        output = tmp_path / "-".join(options)
        assert main(["evaluate", *words, *options, "--output", str(output)]) == 0
        with (output / "episodes.csv").open() as file:
            assert [row["best_ratio"] for row in csv.DictReader(file)] == [expected]
    capsys.readouterr()


def test_best_costs_of_a_task():
    instance = Instance(load_map("empty-8-8"), Scenario(np.array([[0, 0]]), np.array([[0, 7]])))
    keywords = {"max_steps": 20, "action_model": "cardinal"}
    task = EvaluationTask("empty", 1, keywords, instances=(instance, instance, instance), best_costs=(7, None, 14))
    episodes = evaluate({"pibt": "pibt"}, [task])
    assert [episode.metrics.get("best_ratio") for episode in episodes] == [1.0, None, 0.5]


def test_solve(write, tmp_path, capsys):
    write(ROWS)
    plan = tmp_path / "plan.csv"
    words = ["solve", str(plan), "--scenario", str(crossing(tmp_path)), "--planner", "lacam", "--time-limit", "0.2"]
    assert main([*words, "--action-model", "cardinal"]) == 0
    first, second = capsys.readouterr().out.splitlines()
    assert "sum of costs 14, makespan 7, 1.000 times the lower bound 14, " in first
    assert second == "MAPF tracker: 1.000 times the best known cost 14, lower bound 11"
    with plan.open() as file:
        (row,) = csv.DictReader(file)
    assert (row["scen_type"], row["type_id"], row["agents"]) == ("even", "1", "2")
    assert (row["lower_cost"], row["solution_cost"]) == ("14", "14")
    words[1] = str(tmp_path / "plan.txt")
    assert main(words) == 0  # agents that turn
    assert len(capsys.readouterr().out.splitlines()) == 1


def test_the_files_of_the_benchmark(benchmark, monkeypatch):
    monkeypatch.setenv("MAPF_PZ_BENCHMARK", str(benchmark))
    assert known_cost("random-32-32-20-random-1", 20) == KnownCost(413, 413)
    for agents in (50, 100, 200, 300):
        known = known_cost("random-32-32-20-random-1", agents)
        assert known.best is None or 0 < known.lower <= known.best
