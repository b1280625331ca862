"""Every option of these commands has an effect on what the command prints and writes, or is refused."""

import csv
import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from mapf_pz.commands.main import main
from mapf_pz.instances import load_map, place, write_scenario

SEVERAL = {
    "suite.json": '{"tasks": [{"map": "empty-8-8", "num_agents": [3, 5], "max_steps": 9, "episodes": 2}]}',
}
TIMES = re.compile(r"[\d.e-]+ seconds|comp_time=\d+")


class Case(NamedTuple):
    """A command, and a use of each of its options."""

    words: str
    """The command with its arguments, in a folder with `a.scen`, `suite.json` and `plan.txt`."""
    options: dict[str, str]
    """Uses by option: words that are added to the command. `!` at the front: the use is refused by the command. Words
    before `|` are added without the option, too."""
    ignored: Callable[[str], str] = lambda text: TIMES.sub("", text)
    """Removes from a text, of a file or the output, what differs between two equal runs."""


def without_times(text):
    """Remove the columns of times from the episodes; other files and the output repeat them."""
    if not text.startswith("policy,"):
        return ""
    rows = list(csv.DictReader(text.splitlines()))
    return str([{name: row[name] for name in row if name not in ("runtime", "step_ms", "agent_us")} for row in rows])


CASES = {
    "evaluate": Case(
        "evaluate --policy pibt --map empty-8-8 --num-agents 4 --max-steps 9 --episodes 2 --output out",
        {
            "--policy": "--policy random",
            "--suite": "!--suite quickstart",
            "--map": "--map random-16-16-20",
            "--scenario": "--scenario a.scen",
            "--num-agents": "--num-agents 5",
            "--max-steps": "--max-steps 8",
            "--action-model": "--action-model cardinal",
            "--collision-system": "--policy random --num-agents 25 | --collision-system block_both",
            "--on-target": "--on-target restart",
            "--goals": "!--goals alternating",
            "--initial-heading": "--initial-heading east",
            "--edge-weights": "--edge-weights crisscross",
            "--distance-bytes": "!--distance-bytes 1",
            "--episodes": "--episodes 3",
            "--seed": "--seed 5",
            "--policy-seed": "--policy-seed 5",
            "--deterministic": "",  # below
            "--jobs": "!--jobs 0",
            "--output": "--output other",
            "--overwrite": "",  # tests/evaluation/test_identity.py
        },
        without_times,
    ),
    "evaluate a suite": Case(
        "evaluate --policy pibt --suite suite.json --output out",
        {
            "--num-agents": "--num-agents 3",
            "--episodes": "--episodes 1",
            "--seed": "--seed 5",
            "--max-steps": "--max-steps 8",
            "--map": "!--map empty-8-8",
            "--scenario": "!--scenario a.scen",
            "--action-model": "--action-model cardinal",
        },
        without_times,
    ),
    "evaluate a trained policy": Case(
        "evaluate --policy mappo --map empty-8-8 --max-steps 9 --episodes 2 --output out",
        {"--deterministic": "--deterministic", "--action-model": "!--action-model cardinal"},
        without_times,
    ),
    "solve": Case(
        "solve new.txt --map empty-8-8 --num-agents 20 --action-model cardinal",
        {
            "--planner": "--planner lacam:anytime=False",
            "--map": "--map random-16-16-20",
            "--scenario": "--num-agents 4 | --scenario a.scen",
            "--num-agents": "--num-agents 5",
            "--max-steps": "!--max-steps 2",
            "--action-model": "--action-model rotate",
            "--initial-heading": "--action-model rotate | --initial-heading random",
            "--edge-weights": "--edge-weights crisscross",
            "--distance-bytes": "!--distance-bytes 1",
            "--time-limit": "!--time-limit 0",
            "--seed": "--seed 5",
            "--trace": "--trace trace.csv",
        },
    ),
    "validate": Case(
        "validate plan.txt --map empty-8-8",
        {
            "--map": "!--map nowhere",
            "--scenario": "!--scenario a.scen",
            "--num-agents": "!--num-agents 7",
            "--problem": "!--problem suite.json",
            "--all": "--all",
        },
    ),
    "maps generate": Case(
        "maps generate new --maps random maze room warehouse walls --num-agents 3 --number 20 --height 14 --width 14",
        {
            "--maps": "--maps maze",
            "--height": "--height 15",
            "--width": "--width 15",
            "--density": "--density 0.3",
            "--corridor": "--corridor 2",
            "--room-size": "--room-size 3",
            "--shelf-length": "--shelf-length 3",
            "--loops": "--loops 0.5",
            "--wall-density": "--wall-density 0.1",
            "--num-agents": "--num-agents 4",
            "--number": "--number 1",
            "--seed": "--seed 5",
        },
    ),
    "report": Case(
        "report results",
        {
            "--columns": "--columns ISR",
            "--format": "--format latex",
            "--baseline": "--baseline random",
            "--output": "--output table.md",
            "--figures": "--figures figures",
            "--figure-format": "--figures figures | --figure-format svg",
            "--published": "!--figures figures --published nowhere.csv",
        },
    ),
}


def options_in_help(capsys, words):
    """Return the options of a command, without the negative forms of those that are True or False."""
    with pytest.raises(SystemExit):
        main([*words, "--help"])
    text = re.sub(r"\x1b\[[0-9;]*m", "", capsys.readouterr().out)
    return {name for name in re.findall(r"(?<![\w-])--[a-z][\w-]*", text) if not name.startswith("--no-")} - {"--help"}


@pytest.mark.parametrize("name", [name for name in CASES if " a " not in name])
def test_every_option_is_used_here(capsys, monkeypatch, name):
    monkeypatch.setenv("COLUMNS", "300")
    assert set(CASES[name].options) == options_in_help(capsys, name.split())


@pytest.fixture(scope="module")
def material(tmp_path_factory):
    """Return a folder with the files that the commands read."""
    folder = tmp_path_factory.mktemp("material")
    grid = load_map("empty-8-8")
    write_scenario(place(grid, 4, np.random.default_rng(7)), grid, folder / "a.scen")
    for name, text in SEVERAL.items():
        (folder / name).write_text(text)
    (folder / "plan.txt").write_text("solution=\n0:(0,0),(2,0),\n1:(1,0),(1,0),\n2:(2,0),(0,0),\n")
    policies = ["--policy", "pibt", "--policy", "random", "--num-agents", "2", "3"]
    words = ["--map", "empty-8-8", "--max-steps", "9", "--episodes", "2", "--output", str(folder / "results")]
    assert main(["evaluate", *policies, *words]) == 0
    return folder


def outcome(capsys, folder, material, case, use, monkeypatch):
    """Run a command in a new folder; return its status, and what it printed and wrote."""
    folder.mkdir(parents=True)
    for file in material.iterdir():
        (folder / file.name).symlink_to(file)
    given = {path.name for path in material.iterdir()}
    monkeypatch.chdir(folder)
    status = main([*case.words.split(), *use.split()])
    printed = "".join(capsys.readouterr())
    files = [path for path in sorted(Path().rglob("*")) if path.is_file() and path.parts[0] not in given]
    texts = {path.as_posix(): case.ignored(path.read_bytes().decode(errors="replace")) for path in files}
    return status, case.ignored(printed), texts


@pytest.mark.parametrize("name", CASES)
def test_every_option_has_an_effect_or_is_refused(capsys, tmp_path, material, monkeypatch, name):
    case = CASES[name]
    if "mappo" in case.words:
        pytest.importorskip("torch")
    if name == "report":
        pytest.importorskip("matplotlib")
    monkeypatch.setattr("mapf_pz.commands.evaluate.find_spec", lambda name: None)  # figures take seconds
    plain = outcome(capsys, tmp_path / "plain", material, case, "", monkeypatch)
    assert outcome(capsys, tmp_path / "again", material, case, "", monkeypatch) == plain
    without = []
    for number, (option, use) in enumerate(case.options.items()):
        if use:
            before = plain
            shared, _, added = use.removeprefix("!").rpartition("|")
            if shared:
                before = outcome(capsys, tmp_path / f"{number}-without", material, case, shared, monkeypatch)
            after = outcome(capsys, tmp_path / str(number), material, case, f"{shared} {added}", monkeypatch)
            refused = after[0] == 1 and after[1:] != before[1:]
            if after == before or (use.startswith("!") and not refused):
                without.append(option)
    assert without == []
