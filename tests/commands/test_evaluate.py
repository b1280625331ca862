import csv
import json
import os
import re
import signal
import subprocess
import sys

import numpy as np
import pytest

from mapf_pz.commands.main import main
from mapf_pz.evaluation.results import COLUMNS
from mapf_pz.instances import load_map, place, write_scenario
from tests.evaluation.test_parallel import children_of, is_alive, wait_for
from tests.instances.problem_files import write_lorr, write_pogema

SMALL = ["--map", "empty-8-8", "--num-agents", 3, "--max-steps", 20, "--episodes", 4]


@pytest.fixture(autouse=True)
def no_benchmark(monkeypatch):
    monkeypatch.delenv("MAPF_PZ_BENCHMARK", raising=False)


@pytest.fixture
def suite(tmp_path):
    file = tmp_path / "mine.json"
    tasks = [
        {"map": "empty-8-8", "num_agents": [2, 4], "max_steps": 30, "episodes": 3},
        {"random": [6, 6, 0.1], "num_agents": 3, "max_steps": 30, "episodes": 3, "name": "random"},
    ]
    file.write_text(json.dumps({"tasks": tasks}))
    return file


def run(capsys, *words):
    """Run `mapf-pz evaluate` in this process; return the status and the lines of both outputs."""
    try:
        status = main(["evaluate", *map(str, words)])
    except SystemExit as end:
        status = end.code
    out, err = capsys.readouterr()
    return status, out.splitlines(), err.splitlines()


def rows(folder):
    with (folder / "episodes.csv").open() as file:
        return list(csv.DictReader(file))


def files(folder):
    return {file.name for file in folder.iterdir()}


def test_some_columns_in_the_width_of_the_terminal(capsys, monkeypatch, suite):
    monkeypatch.setenv("COLUMNS", "75")
    status, out, _ = run(capsys, "--policy", "pibt", "--suite", suite, "--columns", "ISR", "makespan")
    (header,) = [line for line in out if line.startswith("┃")]
    assert status == 0
    assert re.split(r"\s*┃\s*", header)[-3:] == ["ISR", "makespan", ""]
    assert "CSR" not in header
    assert max(map(len, out)) <= 75


@pytest.mark.slow
@pytest.mark.usefixtures("forked_processes")
def test_policies_on_a_suite_in_processes(capsys, suite, tmp_path):
    output = tmp_path / "new" / "out"
    words = ["--policy", "pibt", "--policy", "random", "--suite", suite, "--jobs", 2, "--output", output]
    status, out, err = run(capsys, *words)
    assert (status, err) == (0, [])
    message = f"table and episodes written to {output}"
    assert message in out
    table = [line for line in out if line.startswith("│")]
    assert [tuple(re.split(r"\s*│\s*", line)[1:5]) for line in table] == [
        (task_name, agents, policy, "3")
        for task_name, agents in [("empty-8-8", "2"), ("empty-8-8", "4"), ("random", "3")]
        for policy in ("pibt", "random")
    ]
    markdown = (output / "evaluation.md").read_text()
    assert [tuple(line.split(" | ")[:3]) for line in markdown.splitlines()[2:4]] == [
        ("| empty-8-8", "2", "pibt"),
        ("| empty-8-8", "2", "random"),
    ]
    assert len(rows(output)) == 2 * 3 * 3
    assert {"episodes.csv", "identities.json", "evaluation.md"} <= files(output)

    before = (output / "episodes.csv").read_bytes()
    status, again, err = run(capsys, *words)
    assert (status, again, err) == (0, out, [])
    assert (output / "episodes.csv").read_bytes() == before


def test_figures_where_there_are_several_numbers_of_agents(capsys, suite, tmp_path):
    pytest.importorskip("matplotlib")
    _, out, _ = run(capsys, "--policy", "pibt", "--suite", suite, "--output", tmp_path / "out")
    assert out[-1] == f"figure written to {tmp_path / 'out' / 'empty-8-8.png'}"
    assert files(tmp_path / "out") == {"episodes.csv", "identities.json", "evaluation.md", "empty-8-8.png"}


def test_figures_need_matplotlib(capsys, suite, tmp_path, monkeypatch):
    monkeypatch.setattr("mapf_pz.commands.evaluate.find_spec", lambda name: None)
    _, out, _ = run(capsys, "--policy", "pibt", "--suite", suite, "--output", tmp_path / "out")
    assert out[-1].startswith("no figures: they require matplotlib, pip install")


def test_nothing_is_written_without_a_folder(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run(capsys, "--policy", "pibt", *SMALL)[0] == 0
    assert files(tmp_path) == set()


def test_a_map(capsys):
    status, out, err = run(capsys, "--policy", "random", *SMALL)
    assert (status, err) == (0, [])
    assert any("│ empty-8-8 │ 3" in line for line in out)


def written_scenarios(folder, *counts):
    """Write `0.scen`, `1.scen` and so on with these numbers of agents; return a sum of distances for each."""
    grid = load_map("empty-8-8")
    for number, count in enumerate(counts):
        scenario = place(grid, count, np.random.default_rng(number))
        write_scenario(scenario, grid, folder / f"{number}.scen")
        yield lambda first, scenario=scenario: np.abs(scenario.starts - scenario.goals)[:first].sum()


ON_SCENARIOS = ["--policy", "pibt", "--map", "empty-8-8", "--max-steps", 20, "--action-model", "cardinal"]


def bounds(folder):
    """Return the lower bound of each episode."""
    return [round(float(row["SoC"]) / float(row["SoC_ratio"])) for row in rows(folder)]


def test_a_scenario_is_one_episode(capsys, tmp_path):
    (cost,) = written_scenarios(tmp_path, 5)
    words = [*ON_SCENARIOS, "--scenario", tmp_path / "0.scen"]
    assert run(capsys, *words, "--output", tmp_path / "out")[0] == 0
    (row,) = rows(tmp_path / "out")
    assert (row["task"], row["num_agents"]) == ("empty-8-8, 0.scen", "5")
    assert bounds(tmp_path / "out") == [cost(5)]
    status, _, err = run(capsys, *words, "--episodes", 2)
    message = (
        "episodes=2: '5 agents on empty-8-8, 0.scen' has 1 instances, and nothing is random with 'pibt'; "
        "expected at most one episode per instance"
    )
    assert (status, err) == (1, [f"mapf-pz evaluate: {message}"])


@pytest.mark.parametrize("words", [["--action-model", "rotate"], ["--edge-weights", "random"]], ids=" ".join)
def test_several_episodes_of_a_scenario_where_something_is_random(capsys, tmp_path, words):
    list(written_scenarios(tmp_path, 12))
    files = ["--scenario", tmp_path / "0.scen", "--episodes", 6]
    assert run(capsys, *ON_SCENARIOS, *files, *words, "--output", tmp_path / "out")[::2] == (0, [])
    assert len({row["SoC"] for row in rows(tmp_path / "out")}) > 1


def test_a_policy_that_ignores_headings_does_not_repeat_a_scenario(capsys, tmp_path):
    pytest.importorskip("torch")
    list(written_scenarios(tmp_path, 3))
    words = ["--map", "empty-8-8", "--scenario", tmp_path / "0.scen", "--max-steps", 5, "--episodes", 2]
    assert run(capsys, "--policy", "mappo", *words)[0] == 0
    status, _, err = run(capsys, "--policy", "mappo", "--policy", "mappo-cardinal", *words)
    assert (status, len(err)) == (1, 1)
    assert "nothing is random with 'mappo-cardinal'" in err[0]


def test_the_numbers_of_agents_of_a_suite_are_selected(capsys, suite, tmp_path):
    words = ["--policy", "pibt", "--suite", suite, "--episodes", 1, "--output", tmp_path / "out", "--num-agents"]
    assert run(capsys, *words, 4, 3)[0] == 0
    assert [(row["task"], row["num_agents"]) for row in rows(tmp_path / "out")] == [("empty-8-8", "4"), ("random", "3")]
    status, _, err = run(capsys, *words, 4, 5)
    message = "mapf-pz evaluate: --num-agents 5: expected some of the suite's, 2, 3, 4"
    assert (status, err) == (1, [message])


def test_a_scenario_names_its_map(capsys, tmp_path):
    grid = load_map("random-16-16-20")
    for number in range(2):
        write_scenario(place(grid, 4, np.random.default_rng(number)), grid, tmp_path / f"{number}.scen")
    (tmp_path / "other").mkdir()
    list(written_scenarios(tmp_path / "other", 4))
    words = ["--policy", "pibt", "--max-steps", 40, "--scenario"]
    assert run(capsys, *words, tmp_path / "0.scen", tmp_path / "1.scen")[0] == 0
    status, _, err = run(capsys, *words, tmp_path / "0.scen", tmp_path / "other" / "0.scen")
    assert (status, len(err)) == (1, 1)
    assert "scenario: expected scenarios of one map, got those of 'random-16-16-20' (" in err[0]
    assert run(capsys, *words, tmp_path / "0.scen", "--map", "empty-8-8")[0] == 1  # --map takes precedence


def test_several_scenarios_and_numbers_of_agents(capsys, tmp_path):
    costs = list(written_scenarios(tmp_path, 5, 6, 7))
    scenarios = ["--scenario", tmp_path / "2.scen", tmp_path / "[01].scen", "--scenario", tmp_path / "0.scen"]
    assert run(capsys, *ON_SCENARIOS, *scenarios, "--num-agents", 4, 2, "--output", tmp_path / "out")[0] == 0
    assert [row["num_agents"] for row in rows(tmp_path / "out")] == ["4"] * 3 + ["2"] * 3
    assert {row["task"] for row in rows(tmp_path / "out")} == {"empty-8-8, 3 scenarios"}
    assert bounds(tmp_path / "out") == [costs[number](count) for count in (4, 2) for number in (2, 0, 1)]


OURS = "mapf-pz solve {plan} --map {map} --scenario {scen} --planner lacam:anytime=False --action-model cardinal"


@pytest.mark.slow
def test_planners_outside_of_the_package(capsys, tmp_path, monkeypatch):
    """A planner of this package, once inside, once as a program, and once as its plan files."""
    monkeypatch.setenv("PATH", os.pathsep.join([os.path.dirname(sys.executable), os.environ["PATH"]]))
    list(written_scenarios(tmp_path, 3))
    plans, solver = tmp_path / "plans", ["--scenario", tmp_path / "0.scen", "--action-model", "cardinal"]
    assert main(["solve", f"{plans}/0-3agents.json", *map(str, solver), "--planner", "lacam:anytime=False"]) == 0
    words = ["--policy", "lacam:anytime=False", "--policy", f"ours=command:{OURS}", "--plans", f"file={plans}"]
    status, out, _ = run(capsys, *words, *solver, "--max-steps", 50, "--time-limit", 60, "--output", tmp_path / "out")
    assert status == 0
    assert not any("failed" in line for line in out)
    found = rows(tmp_path / "out")
    assert [row["policy"] for row in found] == ["lacam:anytime=False", "ours", "file"]
    assert len({(row["CSR"], row["SoC"], row["makespan"]) for row in found}) == 1
    assert [row["runtime"] != "" for row in found] == [True, True, False]
    status, out, _ = run(capsys, "--plans", plans, *solver[:2], "--max-steps", 50)
    message = "1 episodes failed; the first, 0: illegal plan: expected headings, got none; see action_model"
    assert (status, out[-1]) == (0, f"{plans}, 3 agents on 0.scen: {message}")


def test_all_agents_of_the_smallest_scenario_are_used(capsys, tmp_path):
    costs = list(written_scenarios(tmp_path, 6, 5))
    assert run(capsys, *ON_SCENARIOS, "--scenario", tmp_path / "*.scen", "--output", tmp_path / "out")[0] == 0
    assert [row["num_agents"] for row in rows(tmp_path / "out")] == ["5", "5"]
    assert bounds(tmp_path / "out") == [cost(5) for cost in costs]


def test_problem_files(capsys, tmp_path):
    tasks = {
        write_lorr(tmp_path): ("depot.json", "3"),
        write_pogema(tmp_path): ("01-set.lmapf.json", "3"),
    }
    for file, task in tasks.items():
        output = tmp_path / f"evaluation of {file.name}"
        words = ["--policy", "pibt", "--scenario", file, "--max-steps", 9, "--on-target", "restart", "--output", output]
        status, _, err = run(capsys, *words)
        assert (status, err) == (0, [])
        assert {(row["task"], row["num_agents"]) for row in rows(output)} == {task}
        assert all(float(row["avg_throughput"]) > 0 for row in rows(output))


def test_the_environment_of_a_suite_can_be_changed(capsys, suite, tmp_path):
    words = ["--policy", "pibt", "--suite", suite, "--output", tmp_path / "out", "--episodes", 1]
    assert run(capsys, *words, "--on-target", "restart", "--max-steps", 7)[0] == 0
    assert {row["ep_length"] for row in rows(tmp_path / "out")} == {"7.0"}
    assert all(row["avg_throughput"] for row in rows(tmp_path / "out"))


def test_several_numbers_of_agents_on_a_map(capsys, tmp_path):
    words = ["--map", "empty-8-8", "--num-agents", 3, 2, "--max-steps", 20, "--episodes", 1, "--output", tmp_path]
    assert run(capsys, "--policy", "random", *words)[0] == 0
    assert [row["num_agents"] for row in rows(tmp_path)] == ["3", "2"]


def test_several_suites(capsys, suite, tmp_path):
    other = tmp_path / "other.json"
    other.write_text('{"tasks": [{"map": "empty-8-8", "num_agents": 1, "episodes": 2, "max_steps": 30}]}')
    words = ["--policy", "pibt", "--suite", suite, "--suite", other, "--output", tmp_path / "out", "--episodes", 1]
    assert run(capsys, *words)[0] == 0
    assert [(row["num_agents"], row["episode"]) for row in rows(tmp_path / "out")] == [
        ("2", "0"),
        ("4", "0"),
        ("3", "0"),
        ("1", "0"),
    ]
    status, _, err = run(capsys, "--policy", "pibt", "--suite", suite, "--suite", suite)
    expected = "mapf-pz evaluate: two tasks are named '2 agents on empty-8-8': expected unique names"
    assert (status, err) == (1, [expected])


def test_different_settings_have_different_labels(capsys, tmp_path):
    pytest.importorskip("torch")
    words = ["--policy", "mappo", "--policy", "random", *SMALL, "--output", tmp_path]
    for options in ([], ["--deterministic"], ["--policy-seed", 2], ["--policy-seed", 2, "--deterministic"]):
        assert run(capsys, *words, *options)[0] == 0
    names = dict.fromkeys(row["policy"] for row in rows(tmp_path))
    assert list(names) == [
        "mappo",
        "random",
        "mappo, deterministic",
        "mappo, seed 2",
        "random, seed 2",
        "mappo, seed 2, deterministic",
    ]
    acted = {}
    for row in rows(tmp_path):
        acted.setdefault(row["policy"], []).append((row["SoC"], row["collisions"]))
    assert acted["mappo"] != acted["mappo, deterministic"] == acted["mappo, seed 2, deterministic"]
    assert acted["random"] != acted["random, seed 2"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "expected --policy or --plans at least once"),
        (["--policy", "pibt", "--time-limit", 5], "--time-limit: expected only with a policy 'command:...'"),
        (["--policy", "ours=command:nothing"], "command:nothing: expected {map}, {scen}, {plan} among its arguments"),
        (["--plans", "nowhere"], "nowhere: expected a folder with plans, files INSTANCE-Nagents.json|.csv|.txt"),
        (["--policy", "nobody"], "policy 'nobody': expected random, a planner (pibt, epibt, "),
        (["--policy", "pibt:depth=3"], "option 'depth=3': PIBT has the options priority, swap, preference"),
        (["--policy", "pibt", "--suite", "nothing"], "suite 'nothing': expected a .json file, or one of "),
        (["--policy", "pibt", "--suite", "no.json"], "no.json: no such file"),
        (["--policy", "pibt", "--suite", "quickstart", *SMALL], "expected either --suite or --map"),
        (["--policy", "pibt", "--suite", "quickstart", "--scenario", "a.json"], "expected either --suite or --map"),
        (["--policy", "pibt", "--map", "nowhere"], "no .map file is named 'nowhere'"),
        (["--policy", "pibt", *SMALL[:4], "--scenario", "a.scen"], "a.scen: no such file"),
        (["--policy", "pibt", *SMALL[:4], "--scenario", "a*.scen"], "--scenario a*.scen: no file matches this pattern"),
        (["--policy", "pibt", *SMALL[:4], "--scenario"], "scenario=(): expected the path of a file, several paths"),
        (["--policy", "pibt", *SMALL[:2], "--num-agents"], "--num-agents: expected at least one value, got none"),
        (["--policy", "pibt", *SMALL[:2], "--num-agents", 0], "num_agents=0: "),
        (["--policy", "pibt", *SMALL[:2], "--num-agents", 65], "65 agents do not fit"),
        (["--policy", "pibt", *SMALL[:2], "--max-steps", 0], "max_steps=0: "),
        (["--policy", "pibt", *SMALL[:2], "--episodes", 0], "episodes=0: expected 1 or more"),
        (["--policy", "pibt", *SMALL[:2], "--seed", -1], "seed=-1: expected 0 or more"),
        (["--policy", "pibt", *SMALL, "--jobs", 0], "jobs=0: expected a number of processes, 1 or more, or 'ray'"),
        (["--policy", "pibt", *SMALL, "--output", __file__], "File exists"),
    ],
    ids=str,
)
def test_wrong_usage_takes_one_line(capsys, tmp_path, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    status, out, err = run(capsys, *words)
    assert (status, out, len(err)) == (1, [], 1)
    assert message in err[0]
    assert files(tmp_path) == set()


@pytest.mark.parametrize("words", [["--jobs", "two"], ["--polcy", "pibt"], ["--action-model", "fly"]])
def test_wrong_options(capsys, words):
    status, out, err = run(capsys, "--policy", "pibt", *words)
    assert (status, out) == (2, [])
    assert err


def test_a_trained_policy_is_refused_where_actions_are_others(capsys):
    pytest.importorskip("torch")
    status, _, err = run(capsys, "--policy", "mappo", *SMALL, "--action-model", "cardinal")
    assert status == 1
    assert err == ["mapf-pz evaluate: policy 'mappo' requires action_model='rotate', got 'cardinal'"]


def test_another_evaluation_in_the_folder(capsys, tmp_path):
    assert run(capsys, "--policy", "pibt", *SMALL, "--output", tmp_path)[0] == 0
    status, _, err = run(capsys, "--policy", "pibt", *SMALL, "--output", tmp_path, "--seed", 3)
    message = "task '3 agents on empty-8-8': seed differs; expected another folder, or overwrite"
    assert (status, err) == (1, [f"mapf-pz evaluate: {tmp_path}: {message}"])


@pytest.mark.skipif(not os.path.isdir("/proc/self"), reason="looks up processes in /proc")
@pytest.mark.parametrize("jobs", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_interrupted_and_called_again(capsys, tmp_path, jobs):
    words = ["--policy", "pibt", *SMALL[:-1], 1_000_000, "--jobs", jobs, "--output", tmp_path]
    command = [sys.executable, "-m", "mapf_pz", "evaluate", *map(str, words)]
    file = tmp_path / "episodes.csv"
    # A separate session, so that all of its processes get the signal, as in a terminal.
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True) as running:
        wait_for(lambda: file.exists() and file.read_bytes().count(b"\n") > 20)
        workers = children_of(running.pid)
        os.killpg(running.pid, signal.SIGINT)
        _, err = running.communicate()
    assert (running.returncode, err) == (130, "mapf-pz evaluate: interrupted\n")
    assert len(workers) >= (jobs if jobs > 1 else 0)
    wait_for(lambda: not any(map(is_alive, workers)))

    done = rows(tmp_path)
    assert len(done) >= 20
    assert file.read_bytes().endswith(b"\n")
    assert all(len(row) == len(COLUMNS) and None not in row.values() and row["agent_us"] for row in done)
    assert len({row["episode"] for row in done}) == len(done)
    wanted = len(done) + 5
    assert run(capsys, *words, "--episodes", wanted, "--jobs", 1)[0] == 0
    after = rows(tmp_path)
    assert after[: len(done)] == done
    assert {int(row["episode"]) for row in after} >= set(range(wanted))
    assert len({row["episode"] for row in after}) == len(after)
