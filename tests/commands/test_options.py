"""Every option of every command has an effect on what the command prints and writes, or is refused."""

import hashlib
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from mapf_pz.commands.main import COMMANDS, main
from mapf_pz.guidance import save_moves
from mapf_pz.instances import Scenario, load_map, place, write_scenario
from mapf_pz.rl.presets import PRESETS
from tests.commands.option_cases import CASES
from tests.instances.problem_files import write_lorr

SEVERAL = {
    "suite.json": '{"tasks": [{"map": "empty-8-8", "num_agents": [3, 5], "max_steps": 9, "episodes": 2}]}',
    "pogema.yaml": "environment: {on_target: nothing, seed: 0, num_agents: 2, map_name: mine}",
    "maps.yaml": "mine: '.... ....'",
    "other.yaml": "mine: '...... ......'",
}


class Keyboard:
    """A window in which keys are pressed; prints what it shows."""

    is_closed = False

    def __init__(self, *_, **__):
        self._keys = iter(["up", "left", "up", "right", "up", "up", *["space"] * 6, "escape"])

    def show(self, picture, message):
        print(hashlib.sha256(picture.tobytes()).hexdigest(), message)

    def wait(self):
        return [next(self._keys)]

    def close(self):
        self.is_closed = True


def show_arguments(*arguments, **keywords):
    """Print the arguments."""
    print(arguments, keywords)
    return ()


def help_of(capsys, words):
    with pytest.raises(SystemExit):
        main([*words, "--help"])
    return re.sub(r"\x1b\[[0-9;]*m", "", capsys.readouterr().out)


def subcommands(capsys, words):
    """Yield a command, or the commands that it consists of."""
    found = re.search(r"^usage: [^\[]*\[-h\] \{([\w,\n-]+)\}", help_of(capsys, words))
    if found is None:
        yield " ".join(words)
        return
    for name in found[1].split(","):
        yield from subcommands(capsys, [*words, name])


def test_every_command_is_used_here(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "300")
    commands = {name for command in COMMANDS for name in subcommands(capsys, [command])}
    presets = {f"train {name}" for name in PRESETS} - {"train quickstart"}  # they have the same options
    assert {name for name in CASES if " a " not in name} == commands - presets


def options_in_help(capsys, words):
    """Return the options of a command, without the negative forms of those that are True or False."""
    text = help_of(capsys, words)
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
    (folder / "legal.txt").write_text("solution=\n0:(0,0),(5,5),\n1:(1,0),(5,6),\n2:(2,0),(5,7),\n")
    (folder / "plan.txt").write_text("solution=\n0:(0,0),(2,0),\n1:(1,0),(1,0),\n2:(2,0),(0,0),\n")
    policies = ["--policy", "pibt", "--policy", "random", "--num-agents", "2", "3"]
    words = ["--suite", "pogema-puzzles", "--episodes", "2", "--output", str(folder / "results")]
    assert main(["evaluate", *policies, *words]) == 0
    write_lorr(folder)
    write_scenario(Scenario([[4, 4]], [[3, 4]]), grid, folder / "near.scen")
    (folder / "arrows.txt").write_text(">>>>>>>v\n" + "^......v\n" * 6 + "^<<<<<<<\n")
    save_moves(np.arange(256).reshape(4, 8, 8), folder / "moves.npz")
    words = ["--map", "empty-8-8", "--output", str(folder / "weights.npz")]
    assert main(["guidance", "generate", "crisscross", *words]) == 0
    return folder


@pytest.fixture(scope="module")
def trained(material):
    """Add a dataset, and the folder of a training run to the material."""
    pytest.importorskip("torchrl")
    words = ["--num-agents", "4", "--episodes", "2", "--max-steps", "20", "--no-solved-only"]
    assert main(["dataset", "make", str(material / "data"), "--planner", "pibt", *words]) == 0
    words = "--agent-steps 100 --num-envs 4 --steps-per-batch 8 --num-epochs 1 --num-agents 3 --height 7 --width 7"
    output = ["--max-steps", "6", "--evaluate", "none", "--output", str(material / "run")]
    assert main(["train", "quickstart", *words.split(), *output]) == 0


def outcome(capsys, folder, material, case, use, monkeypatch):
    """Run a command in a new folder; return its status, and what it printed and wrote."""
    folder.mkdir(parents=True)
    for file in material.iterdir():
        if file.is_dir():
            (folder / file.name).symlink_to(file)
        else:
            shutil.copy(file, folder)  # a problem's files must not lead out of its folder
    given = {path.name for path in material.iterdir()}
    monkeypatch.chdir(folder)
    try:
        status = main([*case.words.split(), *use.split()])
    except SystemExit as ended:
        status = ended.code
    printed = "".join(capsys.readouterr())
    files = [path for path in sorted(Path().rglob("*")) if path.is_file() and path.parts[0] not in given]
    texts = {path.as_posix(): case.ignored(path.read_bytes().decode(errors="replace")) for path in files}
    return status, case.ignored(printed), texts


SLOW = ("policy export", "train quickstart", "report", "guidance evaluate", "dataset make", "guidance optimize", "play")


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] if name in SLOW else []) for name in CASES]
)
def test_every_option_has_an_effect_or_is_refused(capsys, tmp_path, material, monkeypatch, request, name):
    case = CASES[name]
    if name.startswith(("train", "plot", "dataset export")) or "mappo" in case.words:
        request.getfixturevalue("trained")
        capsys.readouterr()  # what making it printed, in the first test that needs it
    for function in case.replaced:
        monkeypatch.setattr(function, show_arguments)
    monkeypatch.setattr("mapf_pz.commands.play.Window", Keyboard)
    monkeypatch.setenv("MAPF_PZ_CACHE", "cache")
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
            refused = after[0] in (1, 2) and after[1:] != before[1:]
            if after == before or (use.startswith("!") and not refused):
                without.append(option)
    assert without == []
