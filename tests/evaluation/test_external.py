"""Planners outside of the package: commands, and folders of plan files."""

import shlex
import sys

import pytest

from mapf_pz.evaluation import EvaluationTask, evaluate
from mapf_pz.evaluation.external.command import CommandFactory
from mapf_pz.evaluation.external.plan_folder import PlanFolderFactory
from mapf_pz.evaluation.reports.report import failures
from mapf_pz.evaluation.results import read_episodes
from mapf_pz.instances.instance import Grid, Instance, Scenario

PLANNER = """
import sys
kind, grid, scen, plan, agents, seconds, seed = sys.argv[1:]
assert open(grid).read().startswith("type octile\\nheight 2\\nwidth 4\\nmap\\n....\\n..@.\\n")
lines = [line.split("\\t") for line in open(scen) if "\\t" in line][: int(agents)]
assert {line[1] for line in lines} == {"map.map"}
ends = [[(int(line[k]), int(line[k + 1])) for k in (4, 6)] for line in lines]
if kind == "fail":
    print("first\\nout of \\x07memory")
    sys.exit(3)
if kind == "slow":
    import time
    time.sleep(1000)
if kind == "silent":
    sys.exit()
if kind == "nonsense":
    open(plan, "w").write("solution=\\n0:(x)\\n")
    sys.exit()
paths = []
for (x, y), (goal_x, goal_y) in ends:
    path = [(x, y)]
    while x != goal_x:
        x += 1 if x < goal_x else -1
        path.append((x, y))
    while y != goal_y and kind != "unfinished":
        y += 1 if y < goal_y else -1
        path.append((x, y))
    paths.append(path)
steps = max(len(path) for path in paths)
with open(plan, "w") as out:
    out.write(f"seed={seed}\\nseconds={seconds}\\nsolution=\\n")
    for step in range(steps):
        cells = "".join("({},{}),".format(*path[min(step, len(path) - 1)]) for path in paths)
        out.write(f"{step}:{cells}\\n")
"""
GRID = Grid([[True] * 4, [True, True, False, True]], "corner")


def instance(starts, goals):
    return Instance(GRID, Scenario(starts, goals))


RIGHT = instance([[0, 0], [1, 0]], [[0, 2], [1, 1]])
DOWN = instance([[0, 1], [1, 0]], [[1, 3], [0, 0]])
SWAP = instance([[0, 0], [0, 1]], [[0, 1], [0, 0]])


def task(*instances, names=("right", "down", "swap"), **keywords):
    keywords = {"action_model": "cardinal", "max_steps": 9} | keywords
    return EvaluationTask("corner", 2, keywords, instances=instances, instance_names=names[: len(instances)])


@pytest.fixture
def command(tmp_path):
    """Return a function that returns the command of a kind of planner."""
    file = tmp_path / "a planner.py"
    file.write_text(PLANNER)
    start = f"{shlex.quote(sys.executable)} -S {shlex.quote(str(file))}"
    return lambda kind="right": f"command:{start} {kind} {{map}} {{scen}} {{plan}} {{agents}} {{seconds}} {{seed}}"


def test_a_command_plans_each_episode(command, tmp_path):
    episodes = evaluate({"mine": command()}, [task(RIGHT, DOWN)], tmp_path / "out")
    assert [episode.metrics["CSR"] for episode in episodes] == [1, 1]
    assert [episode.metrics["SoC"] for episode in episodes] == [2 + 1, 3 + 1]
    assert [episode.note for episode in episodes] == ["", ""]
    assert all(0 < episode.metrics["runtime"] < 1000 for episode in episodes)
    assert read_episodes(tmp_path / "out") == episodes


def test_an_illegal_plan_fails_with_its_first_violation(command, tmp_path):
    episodes = evaluate({"mine": command()}, [task(RIGHT, DOWN, SWAP)], tmp_path / "out")
    assert [episode.metrics["CSR"] for episode in episodes] == [1, 1, 0]
    assert episodes[2].metrics["ISR"] == 0
    note = "illegal plan: step 1: agent 0 and agent 1 at [row 0, col 1] and [row 0, col 0]: two agents swap cells"
    assert [episode.note for episode in episodes] == ["", "", note]
    assert read_episodes(tmp_path / "out") == episodes
    assert failures(episodes) == [f"mine, 2 agents on corner: 1 episodes failed; the first, swap: {note}"]


def test_a_plan_that_ends_early_is_illegal(command):
    (episode,) = evaluate({"mine": command("unfinished")}, [task(DOWN)])
    assert episode.note == "illegal plan: step 2: agent 0 at [row 0, col 3]: not the agent's goal"
    assert episode.metrics["CSR"] == 0


@pytest.mark.parametrize(
    ("kind", "note"),
    [
        ("fail", "the command failed with exit status 3: out of ?memory"),
        ("nonsense", "plan.txt:2:3: expected a cell (x,y), got '(x)'"),
    ],
)
def test_a_command_that_fails(command, kind, note):
    (episode,) = evaluate({"mine": command(kind)}, [task(RIGHT)])
    assert episode.note == note
    assert episode.metrics["CSR"] == 0
    assert not {"runtime", "step_ms", "agent_us"} & episode.metrics.keys()


def test_a_command_that_writes_no_plan(command):
    (episode,) = evaluate({"mine": command("silent")}, [task(RIGHT)])
    assert episode.note.startswith("the command wrote no plan in ")


def test_a_command_that_takes_too_long_is_ended(command):
    factory = CommandFactory(command("slow").removeprefix("command:"), time_limit=0.25)
    (episode,) = evaluate({"mine": factory}, [task(RIGHT)])
    assert episode.note == "the command was ended after 0.5 s"


def test_agents_that_turn_need_plans_with_headings(command):
    (episode,) = evaluate({"mine": command()}, [task(RIGHT, action_model="rotate")])
    assert episode.note == "illegal plan: expected headings, got none; see action_model"


def test_rules_that_block_a_legal_plan(command):
    following = instance([[0, 0], [0, 1]], [[0, 1], [0, 2]])
    blocked, allowed = (
        evaluate({"mine": command()}, [task(following, collision_system=system)])[0]
        for system in ("block_both", "soft")
    )
    assert blocked.note == "step 1: a legal move was blocked by collision_system='block_both'"
    assert (blocked.metrics["CSR"], allowed.metrics["CSR"], allowed.note) == (0, 1, "")


def test_lifelong_episodes_are_refused(command):
    with pytest.raises(ValueError, match="on_target='restart': expected 'nothing' for external planners"):
        evaluate({"mine": command()}, [task(RIGHT, on_target="restart")])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("no-such-planner {map} {scen} {plan}", r"expected a program, \['no-such-planner'\] is none"),
        ("", "expected {map}, {scen}, {plan} among its arguments"),
        ("python {map} {plan}", "expected {scen} among its arguments"),
        ("python {map} {scen} {plan} {speed}", "expected {map}, .*{seed}, got {speed}"),
        ("python {map} {scen} {plan.__class__}", "expected {plan} among its arguments"),
        ("python '{map} {scen} {plan}", "No closing quotation"),
    ],
)
def test_malformed_commands(words, message):
    with pytest.raises(ValueError, match=message):
        evaluate([f"command:{words}"], [task(RIGHT)])


def test_no_shell_reads_the_command(command, tmp_path):
    marker = tmp_path / "marker"
    episodes = evaluate({"mine": f"{command('right')} ; touch {marker}"}, [task(RIGHT)])
    assert episodes[0].note.startswith("the command failed with exit status 1: ")  # it got three more arguments
    assert not marker.exists()


def test_another_program_is_another_policy(command, tmp_path):
    out, mine = tmp_path / "out", tmp_path / "planner"
    mine.write_text("#!/bin/sh\n")
    mine.chmod(0o700)
    words = {"mine": f"command:{mine} {{map}} {{scen}} {{plan}}"}
    evaluate(words, [task(RIGHT)], out)
    evaluate(words, [task(RIGHT)], out)
    mine.write_text("#!/bin/sh\nexit 1\n")
    with pytest.raises(ValueError, match="policy 'mine': program differs"):
        evaluate(words, [task(RIGHT)], out)


PLANS = {
    "right-2agents.txt": "solution=\n0:(0,0),(0,1),\n1:(1,0),(1,1),\n2:(2,0),(1,1),\n",
    "down-2agents.csv": 'agents,solution_plan\n2,"rru\nd"\n',
    "swap-2agents.txt": "solution=\n0:(0,0),(1,0),\n1:(1,0),(0,0),\n",
}


@pytest.fixture
def plans(tmp_path):
    folder = tmp_path / "plans"
    folder.mkdir()
    for name, text in PLANS.items():
        (folder / name).write_text(text)
    return folder


def test_plans_of_a_folder(plans, tmp_path):
    out, tasks = tmp_path / "out", [task(RIGHT, DOWN, SWAP)]
    episodes = evaluate({"theirs": PlanFolderFactory(plans)}, tasks, out)
    assert [episode.metrics["CSR"] for episode in episodes] == [1, 1, 0]
    assert [episode.metrics["SoC"] for episode in episodes[:2]] == [2 + 1, 3 + 1]
    assert "two agents swap cells" in episodes[2].note
    assert not any("runtime" in episode.metrics for episode in episodes)
    (plans / "swap-2agents.txt").unlink()
    with pytest.raises(ValueError, match="policy 'theirs': plans differ"):
        evaluate({"theirs": PlanFolderFactory(plans)}, tasks, out)
    replaced = evaluate({"theirs": PlanFolderFactory(plans)}, tasks, out, overwrite=True)
    assert replaced[2].note == "expected one plan file swap-2agents.json|.csv|.txt, found 0"


def test_instances_of_the_same_name_have_numbers(plans):
    (plans / "right-2agents.txt").rename(plans / "corner-0-2agents.txt")
    (plans / "down-2agents.csv").rename(plans / "corner-1-2agents.csv")
    episodes = evaluate({"theirs": PlanFolderFactory(plans)}, [task(RIGHT, DOWN, names=("corner", "corner"))])
    assert [(episode.note, episode.metrics["CSR"]) for episode in episodes] == [("", 1), ("", 1)]


def test_a_plan_of_another_instance(plans):
    (plans / "down-2agents.csv").unlink()
    (plans / "right-2agents.txt").rename(plans / "down-2agents.txt")
    (episode,) = evaluate({"theirs": PlanFolderFactory(plans)}, [task(DOWN, names=("down",))])
    assert episode.note == "illegal plan: step 0: agent 0 at [row 0, col 0]: not the instance's start"


def test_a_folder_without_plans(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"expected a folder with plans, files INSTANCE-Nagents\.json"):
        PlanFolderFactory(tmp_path)
