import itertools
import json
import os
import re
import shlex
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

import mapf_pz
from mapf_pz.commands import main as cli
from mapf_pz.commands.main import COMMANDS, Command, main
from mapf_pz.instances import load_map, map_names, place, write_bundled, write_map, write_scenario
from mapf_pz.instances.instance import Grid


def run(capsys, *words):
    """Run in this process; return the status and the lines of both outputs."""
    try:
        status = main([str(word) for word in words])
    except SystemExit as end:
        status = end.code
    out, err = capsys.readouterr()
    return status, out.splitlines(), err.splitlines()


def python(*words):
    return subprocess.run([sys.executable, *words], capture_output=True, text=True, check=False)


# Help and wrong usage.


@pytest.mark.parametrize("words", [["--help"], ["-h"], []])
def test_overview(capsys, words):
    status, out, err = run(capsys, *words)
    assert status == (0 if words else 2)
    assert [line.split()[0] for line in out if line.startswith("  ")] == list(COMMANDS)
    assert err == []


@pytest.mark.parametrize(
    "words",
    [[name] for name in COMMANDS] + [["maps", "list"], ["maps", "write"], ["maps", "generate"], ["maps", "download"]],
)
def test_help_of_a_command(capsys, words):
    status, out, _ = run(capsys, *words, "--help")
    assert status == 0
    assert out[0].startswith(f"usage: mapf-pz {' '.join(words)} ")


def test_unknown_command(capsys):
    status, out, err = run(capsys, "xyz")
    assert (status, out) == (2, [])
    assert err == [f"mapf-pz: no command 'xyz', expected one of {', '.join(COMMANDS)}"]
    assert run(capsys, "trian") == (2, [], ["mapf-pz: no command 'trian', did you mean 'train'?"])
    with pytest.raises(SystemExit, match="2"):
        main(["evaluate", "--policies=pibt", "--lr", "0.1"])
    *_, first, second = capsys.readouterr().err.splitlines()
    assert first == "--lr: did you mean --learning-rate?"
    assert second == "--policies: did you mean --policy, once for each policy?"


def test_options_have_one_heading(capsys):
    status, out, _ = run(capsys, "solve", "--help")
    headings = [before.strip() for before, line in itertools.pairwise(out) if set(line.strip()) == {"-"}]
    assert (status, headings[:2]) == (0, ["positional arguments", "options"])


@pytest.mark.parametrize(
    "words", [["maps", "fetch"], ["render", "a.gif", "--colour", "1"], ["render", "a.gif", "--seed", "x"]]
)
def test_wrong_options(capsys, words):
    status, out, err = run(capsys, *words)
    assert (status, out) == (2, [])
    assert err


def test_as_a_module():
    done = python("-m", "mapf_pz", "maps", "list")
    assert (done.returncode, done.stderr) == (0, "")
    assert "empty-8-8" in done.stdout
    done = python("-m", "mapf_pz", "render", "a.svg", "--map", "nowhere.map")
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == "mapf-pz render: nowhere.map: no such file\n"


def test_the_version_is_that_of_the_package(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"mapf-pz {mapf_pz.__version__}\n"
    assert re.fullmatch(r"\d+\.\d+\.\d+", mapf_pz.__version__)


def test_the_help_of_training_needs_no_torch():
    command = "try: main(['train', '-h'])\nfinally: print({'torch'} & {*sys.modules})"
    done = python("-c", f"import sys; from mapf_pz.commands.main import main\n{command}")
    assert done.stdout.splitlines()[-1] == "set()"
    assert "A first policy within minutes" in done.stdout


def test_the_overview_loads_little():
    done = python(
        "-c",
        "import sys; from mapf_pz.commands.main import main; main(['-h']); print({'torch', 'numba'} & {*sys.modules})",
    )
    assert (done.stdout.splitlines()[-1], done.stderr) == ("set()", "")


# Errors.


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (ValueError("seven is\n  too many"), "seven is too many"),
        (MemoryError(), "MemoryError"),
        (FileNotFoundError(2, "No such file", "a.map"), "[Errno 2] No such file: 'a.map'"),
        (RuntimeError("call reset()"), "call reset()"),
        (
            ModuleNotFoundError("No module named 'torch'", name="torch"),
            "No module named 'torch': pip install 'mapf-pz[train,render]'",
        ),
    ],
    ids=lambda value: type(value).__name__,
)
def test_errors_take_one_line(capsys, monkeypatch, error, message):
    def fail() -> None:
        raise error

    monkeypatch.setattr(cli, "fail", fail, raising=False)
    monkeypatch.setitem(COMMANDS, "fail", Command("mapf_pz.commands.main:fail", "fails"))
    assert run(capsys, "fail") == (1, [], [f"mapf-pz fail: {message}"])


@pytest.mark.filterwarnings("default")
def test_warnings_take_one_line(capsys, monkeypatch):
    monkeypatch.setattr(cli, "warn", lambda: warnings.warn("half of it\nis missing", stacklevel=1), raising=False)
    monkeypatch.setitem(COMMANDS, "warn", Command("mapf_pz.commands.main:warn", "warns"))
    assert run(capsys, "warn") == (0, [], ["mapf-pz warn: warning: half of it is missing"])


@pytest.mark.parametrize("words", [[], ["maps", "list"], ["maps", "--help"]], ids=str)
@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_a_reader_that_exits_early(words, unbuffered):
    read, write = os.pipe()
    os.close(read)
    command = [sys.executable, "-m", "mapf_pz", *words]
    environment = os.environ | {"PYTHONUNBUFFERED": unbuffered}
    done = subprocess.run(command, stdout=write, stderr=subprocess.PIPE, text=True, check=False, env=environment)
    os.close(write)
    assert (done.returncode, done.stderr) == (141, "")


@pytest.mark.parametrize("words", [["maps", "list"], ["maps", "--help"]], ids=str)
def test_a_closed_standard_output(words):
    command = shlex.join([sys.executable, "-m", "mapf_pz", *words])
    done = subprocess.run(["sh", "-c", f"{command} >&-"], stderr=subprocess.PIPE, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full")
def test_a_full_standard_output():
    command = shlex.join([sys.executable, "-m", "mapf_pz", "--version"])
    done = subprocess.run(["sh", "-c", f"{command} >/dev/full"], stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr == "mapf-pz: standard output: [Errno 28] No space left on device\n"


def test_errors_have_no_control_characters(monkeypatch, capsys):
    def fail() -> None:
        raise ValueError("a\n\x1b[31mred\x1b[0m\x07 name")

    monkeypatch.setattr(cli, "fail", fail, raising=False)
    monkeypatch.setitem(COMMANDS, "fail", Command("mapf_pz.commands.main:fail", "fails"))
    assert run(capsys, "fail") == (1, [], ["mapf-pz fail: a ?[31mred?[0m? name"])


def test_internal_errors_have_a_traceback(monkeypatch):
    def fail() -> None:
        raise AttributeError("no such thing")

    monkeypatch.setattr(cli, "fail", fail, raising=False)
    monkeypatch.setitem(COMMANDS, "fail", Command("mapf_pz.commands.main:fail", "fails"))
    with pytest.raises(AttributeError):
        main(["fail"])


def test_interrupt(capsys, monkeypatch):
    def fail() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(cli, "fail", fail, raising=False)
    monkeypatch.setitem(COMMANDS, "fail", Command("mapf_pz.commands.main:fail", "fails"))
    assert run(capsys, "fail") == (130, [], ["mapf-pz fail: interrupted"])


@pytest.mark.parametrize(
    "words",
    [["solve", "plan.json"], ["render", "a.html", "--policy", "pibt"], ["evaluate", "--policy", "pibt"]],
    ids=lambda words: words[0],
)
def test_too_little_memory_for_the_cost_to_go(capsys, tmp_path, monkeypatch, words):
    monkeypatch.chdir(tmp_path)
    status, out, err = run(capsys, *words, "--map", "empty-8-8", "--num-agents", 2, "--distance-bytes", 260)
    assert (status, out, len(err)) == (1, [], 1)
    assert err[0].endswith("(on the command line --distance-bytes 520)")
    assert not list(tmp_path.iterdir())


# Maps.


def test_maps_list(capsys):
    status, out, err = run(capsys, "maps", "list")
    assert (status, err) == (0, [])
    lines = dict(line.split(maxsplit=1) for line in out)
    assert len(lines) == len(out)
    assert list(lines)[: len(map_names())] == map_names()
    assert lines["empty-8-8"] == "8 x 8        64 free cells, bundled, scenarios random-1 to random-10"
    assert lines["maze-13-13-1"] == "13 x 13       71 free cells, bundled"
    assert lines["brc202d"] == "map of the MovingAI benchmark, mapf-pz maps download"
    assert lines["warehouse_small_10"] == "problem of the League of Robot Runners 2023, 10 agents, bundled"
    assert lines["pogema-mazes-lifelong"] == "128 instances of POGEMA's benchmark, bundled"


def test_maps_list_names_the_folders_of_other_maps(capsys, monkeypatch, tmp_path):
    for variable in ("MAPF_PZ_BENCHMARK", "MAPF_PZ_CACHE"):
        folder = tmp_path / variable / "maps"
        write_bundled(folder)
        (folder / "empty-8-8.map").rename(folder / f"of-{variable}.map")
        monkeypatch.setenv(variable, str(folder.parent))
    _, out, _ = run(capsys, "maps", "list")
    lines = dict(line.split(maxsplit=1) for line in out)
    for variable in ("MAPF_PZ_BENCHMARK", "MAPF_PZ_CACHE"):
        assert lines[f"of-{variable}"] == f"8 x 8        64 free cells, {tmp_path / variable / 'maps'}"
    assert "bundled" in lines["empty-16-16"]


def test_maps_write(capsys, tmp_path):
    folder = tmp_path / "new" / "maps"
    assert run(capsys, "maps", "write", folder) == (0, [f"{len(map_names())} maps written to {folder}"], [])
    assert sorted(file.stem for file in folder.iterdir()) == map_names()
    assert (load_map(folder / "maze-13-13-1.map").free == load_map("maze-13-13-1").free).all()


def test_maps_write_into_a_file(capsys, tmp_path):
    (tmp_path / "file").touch()
    status, out, err = run(capsys, "maps", "write", tmp_path / "file")
    assert (status, out, len(err)) == (1, [], 1)


def test_maps_generate(capsys, tmp_path):
    words = ["--maps", "random", "maze", "--height", 9, "--width", 11, "--num-agents", 4, "--number", 3, "--seed", 5]
    folders = [tmp_path / "first", tmp_path / "second"]
    for folder in folders:
        told = f"3 maps with scenarios written to {folder}"
        assert run(capsys, "maps", "generate", folder, *words) == (0, [told], [])
    first, second = ({file.name: file.read_bytes() for file in folder.iterdir()} for folder in folders)
    assert first == second
    files = sorted(folders[0].glob("*.map"))
    assert [file.name.split("-")[0] for file in files] == ["1", "2", "3"]
    for file in files:
        env = mapf_pz.parallel_env(map=file, scenario=file.with_suffix(".scen"), action_model="cardinal")
        assert (env.simulator.shape, len(env.possible_agents)) == ((9, 11), 4)


@pytest.mark.parametrize(
    ("words", "error"),
    [
        (["--number", 0], "number=0: expected 1 or more"),
        (["--num-agents", 0], "num_agents=0: expected 1 or more"),
        (["--seed", -1], "seed=-1: expected 0 or more"),
        (["--height", 3, "--width", 3, "--num-agents", 10], "10 agents fit on none"),
        (["--maps", "mase"], "maps"),
    ],
)
def test_maps_that_cannot_be_generated(capsys, tmp_path, words, error):
    status, out, err = run(capsys, "maps", "generate", tmp_path / "maps", *words)
    assert (status, out, len(err)) == (1, [], 1)
    assert error in err[0]
    assert not (tmp_path / "maps").exists()


# Render.


def test_render_a_gif(capsys, tmp_path):
    image = pytest.importorskip("PIL.Image")
    file = tmp_path / "new" / "a.gif"
    status, out, err = run(
        capsys, "render", file, "--map", "empty-8-8", "--max-steps", 5, "--num-agents", 3, "--fps", 5
    )
    assert (status, err) == (0, [])
    assert out[0].startswith(f"{file}: 5 steps, CSR 0, ISR ")
    with image.open(file) as gif:
        assert gif.n_frames == 6
        assert gif.info["duration"] == 200


def test_render_a_scenario_on_a_small_map(capsys, tmp_path):
    image = pytest.importorskip("PIL.Image")
    files = [tmp_path / name for name in ("a.map", "a.scen")]
    files[0].write_text("type octile\nheight 2\nwidth 3\nmap\n...\n...\n")
    files[1].write_text("version 1\n0\ta.map\t3\t2\t0\t0\t2\t0\t2\n0\ta.map\t3\t2\t0\t1\t2\t1\t2\n")
    options = ["--map", files[0], "--scenario", files[1], "--num-agents", 2, "--action-model", "cardinal"]
    status, _, err = run(capsys, "render", tmp_path / "a.png", *options)
    assert (status, err) == (0, [])
    with image.open(tmp_path / "a.png") as png:
        assert png.size == (3 * 48, 2 * 48)


class Waits:
    """A policy that observes in its own way, and waits."""

    env_kwargs = {"action_model": "cardinal", "view_size": (3, 3), "channels": ("goal",)}  # noqa: RUF012

    def __init__(self):
        self.seen = []

    def act(self, observations):
        self.seen += [observation.shape for observation in observations.values()]
        return dict.fromkeys(observations, 0)

    def reset_states(self):
        self.seen.clear()


def test_render_a_trained_policy(capsys, tmp_path, monkeypatch):
    pytest.importorskip("PIL")
    policies = pytest.importorskip("mapf_pz.rl.policies.load")
    policy = Waits()
    (tmp_path / "run").mkdir()
    known = {(str(tmp_path / "run"), 7, False, None, False, None): policy}
    monkeypatch.setattr(policies, "load_policy", lambda *arguments: known[arguments])
    options = ["--policy", tmp_path / "run", "--seed", 7, "--max-steps", 4, "--num-agents", 2]
    status, out, err = run(capsys, "render", tmp_path / "a.gif", *options)
    assert (status, err) == (0, [])
    assert ": 4 steps, " in out[0]
    assert policy.seen == [(1, 3, 3)] * 8


@pytest.mark.parametrize("policy", ["pibt", "epibt:depth=2"])
def test_render_a_planner(capsys, tmp_path, policy):
    image = pytest.importorskip("PIL.Image")
    status, out, err = run(capsys, "render", tmp_path / "out.gif", "--policy", policy, "--num-agents", 3)
    assert (status, err) == (0, [])
    assert ", CSR 1, ISR 1, " in out[0]
    with image.open(tmp_path / "out.gif") as gif:
        assert f": {gif.n_frames - 1} steps, " in out[0]


def test_render_a_page(capsys, tmp_path):
    file = tmp_path / "a.html"
    options = ["--policy", "pibt", "--num-agents", 3, "--edge-weights", "crisscross", "--seed", 4]
    status, out, err = run(capsys, "render", file, *options)
    assert (status, err) == (0, [])
    page = file.read_text()
    assert "<title>pibt: empty-8-8, 3 agents</title>" in page
    metrics = dict(part.split() for part in out[0].split(", ")[1:])
    data = json.loads(re.search('<script type="application/json" id="data">(.*)</script>', page)[1])
    (episode,) = data["episodes"]
    assert episode["facts"] == {"policy": "pibt", "seed": "4"}
    assert {name: f"{value:.4g}" for name, value in episode["metrics"].items()} == metrics
    assert "weights" in episode["arrays"]


def test_render_several_policies_side_by_side(capsys, tmp_path):
    file = tmp_path / "a.html"
    status, out, err = run(capsys, "render", file, "--policy", "pibt", "--policy", "random", "--num-agents", 3)
    assert (status, err) == (0, [])
    assert [line.split()[1] for line in out] == ["pibt:", "random:"]
    assert "<title>pibt and random: empty-8-8, 3 agents</title>" in file.read_text()


def test_solve_with_a_trained_policy(capsys, tmp_path):
    pytest.importorskip("torchrl")
    plan, words = tmp_path / "plan.txt", ("--map", "random-16-16-20", "--num-agents", 10)
    words = (*words, "--planner", "mappo+pibt:temperature=0")
    status, out, err = run(capsys, "solve", plan, *words)
    assert (status, err) == (0, [])
    assert re.search(r"10 agents, sum of costs \d+, makespan \d+, ", out[0])
    assert run(capsys, "validate", plan, "--map", "random-16-16-20")[0] == 0


@pytest.mark.parametrize("planner", ["pibt", "epibt", "random"])
def test_an_unfinished_plan_is_reported_and_written_only_if_wanted(capsys, tmp_path, planner):
    grid, plan = tmp_path / "a.map", tmp_path / "plan.txt"
    grid.write_text("type octile\nheight 1\nwidth 5\nmap\n.....\n")
    scenario = tmp_path / "a.scen"
    scenario.write_text("version 1\n0\ta.map\t5\t1\t0\t0\t4\t0\t4\n")
    words = ("solve", plan, "--map", grid, "--scenario", scenario, "--planner", planner, "--max-steps", 2)
    limits = "limits: 10 seconds and 2 steps"
    status, out, err = run(capsys, *words)
    message = f"mapf-pz solve: {planner}: 1 of 1 agents are not at their goals after 2 steps: 0 ({limits}; "
    assert (status, out, err) == (1, [], [f"{message}not written without --partial)"])
    assert not plan.exists()
    assert run(capsys, *words, "--partial") == (1, [], [f"{message}written to {plan})"])
    status, _, err = run(capsys, "validate", plan, "--map", grid, "--scenario", scenario)
    assert (status, "not the agent's goal" in err[-1]) == (1, True)


def test_render_a_plan(capsys, tmp_path):
    plan, file = tmp_path / "plan.json", tmp_path / "a.html"
    assert run(capsys, "solve", plan, "--num-agents", 3)[0] == 0
    status, out, err = run(capsys, "render", file, "--plan", plan, "--map", "empty-8-8")
    assert (status, err) == (0, [])
    assert re.search(r" steps, SoC \d+, makespan \d+, legal$", out[0])
    assert '"violations": []' in file.read_text()
    data = json.loads(plan.read_text())
    data["actualPaths"][0] = data["actualPaths"][0].replace("F", "W", 1)  # all that comes after is one cell off
    plan.write_text(json.dumps(data))
    status, out, err = run(capsys, "render", file, "--plan", plan, "--map", "empty-8-8")
    assert (status, err) == (0, [])
    assert re.search(r", \d+ violations?, the first in step \d+: ", out[0])
    assert '"violations": [{"step": ' in file.read_text()


@pytest.mark.parametrize("on_target", ["nothing", "finish", "restart"])
def test_render_is_reproducible(capsys, tmp_path, on_target):
    pytest.importorskip("PIL")
    outs = []
    for seed, name in [(1, "a"), (1, "b"), (2, "c")]:
        status, out, _ = run(
            capsys, "render", tmp_path / f"{name}.png", "--max-steps", 9, "--seed", seed, "--on-target", on_target
        )
        assert status == 0
        outs.append(out[0].partition(": ")[2])
    pictures = [(tmp_path / f"{name}.png").read_bytes() for name in "abc"]
    assert pictures[0] == pictures[1] != pictures[2]
    assert outs[0] == outs[1]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["a.jpg"], "a.jpg: expected a file name that ends in .html, .svg, .gif, .mp4, .png"),
        (["a.gif", "--plan", "nowhere.json"], "expected either --map or --scenario, or --problem"),
        (["a.gif", "--plan", "nowhere.json", "--map", "empty-8-8"], "nowhere.json: no such file"),
        (["a.gif", "--problem", "nowhere.json"], "--problem: expected --plan"),
        (["a.gif", "--policy", "pibt", "--plan", "a.json"], "expected either --policy or --plan"),
        (["a.gif", "--policy", "pibt", "--policy", "random"], "a.gif: expected an .html file for several episodes"),
        (["a.gif", "--map", "nowhere"], "no .map file is named 'nowhere'"),
        (["a.gif", "--map", "nowhere.map"], "nowhere.map"),
        (["a.gif", "--num-agents", "1000"], "1000"),
        (["a.gif", "--fps", "0"], "fps=0"),
        (["a.gif", "--seed", "-1"], "non-negative"),
        (["a.gif", "--policy", "nobody"], "policy 'nobody'"),
        (["a.gif", "--num-agents", "0"], "num_agents=0: expected a whole number, 1 or more"),
    ],
    ids=str,
)
def test_render_errors(capsys, tmp_path, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    status, out, err = run(capsys, "render", *words)
    assert (status, out, len(err)) == (1, [], 1)
    assert message in err[0]
    assert not list(tmp_path.iterdir())


def test_a_field_of_the_environment_is_refused_while_options_are_parsed(capsys):
    status, _, err = run(capsys, "train", "quickstart", "--num-agents", "0")
    assert status == 2
    text = " ".join("\n".join(err).replace("│", "").split())  # without the frame around the message
    assert "num_agents=0: expected a whole number, 1 or more" in text


@pytest.mark.usefixtures("without_figures")
def test_train_then_evaluate(tmp_path, capsys):
    pytest.importorskip("torchrl")
    run = tmp_path / "run"
    small = "--agent-steps 300 --num-envs 4 --steps-per-batch 8 --num-agents 3 --height 7 --width 7 --num-threads 1"
    assert main(["train", "quickstart", "--output", str(run), "--evaluate", "none", *small.split()]) == 0
    assert (run / "policy.safetensors").exists()
    words = ["--map", "empty-8-8", "--num-agents", "2", "--max-steps", "5", "--episodes", "2"]
    assert main(["evaluate", "--policy", str(run), *words, "--output", str(tmp_path / "evaluation")]) == 0
    assert "│ empty-8-8 │ 2 " in capsys.readouterr().out
    assert len((tmp_path / "evaluation" / "episodes.csv").read_text().splitlines()) == 3


@pytest.mark.usefixtures("without_figures")
def test_a_resumed_run_is_evaluated_again(tmp_path, capsys):
    pytest.importorskip("torchrl")
    image = pytest.importorskip("PIL.Image")
    grid = Grid(np.ones((7, 9), bool))
    write_map(grid, tmp_path / "a.map")
    for seed in range(2):
        write_scenario(place(grid, 3, np.random.default_rng(seed)), grid, tmp_path / f"{seed}.scen")
    tasks = [
        {"random": [7, 7, 0.1], "num_agents": 2, "max_steps": 4, "episodes": 2},
        {"map": "a.map", "scenarios": ["0.scen", "1.scen"], "num_agents": 2, "max_steps": 5},
    ]
    (tmp_path / "mine.json").write_text(json.dumps({"tasks": tasks}))
    small = "--num-envs 4 --steps-per-batch 8 --num-agents 3 --height 7 --width 7 --num-threads 1"
    words = ["--evaluate", tmp_path / "mine.json", "--agent-steps"]
    folder = tmp_path / "run"
    written = []
    for command in (["quickstart", "--output", folder, *words, 100, *small.split()], ["resume", folder, *words, 200]):
        status, out, err = run(capsys, "train", *command)
        assert (status, err) == (0, [])
        assert f"policy, configuration and progress written to {folder}" in out
        assert out[-1].startswith(f"{folder / 'episode.gif'}: 5 steps, ")
        with image.open(folder / "episode.gif") as gif:
            assert gif.width * 7 == gif.height * 9
        written.append((folder / "episodes.csv").read_text().splitlines())
    first, second = written
    assert [line.split(",")[:4] for line in first] == [line.split(",")[:4] for line in second]
    assert len(first) == 1 + 2 + 2
    assert not {*first[1:]} & {*second[1:]}  # the times differ at least
    status, _, err = run(capsys, "train", "resume", folder, "--evaluate", "nothing")
    assert (status, len(err)) == (1, 1)
    assert "suite 'nothing': expected a .json file, or one of " in err[0]


def test_evaluate_reports_unknown_policies(capsys):
    assert main(["evaluate", "--policy", "no-such-run"]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "expected random, a planner (pibt, epibt, " in error
    assert "the folder of a training run, or package.module:Class" in error


COMPILE_TWO_KERNELS = """
import sys
import types
from mapf_pz._internal.jit import jit
sys.modules["mapf_pz.simulator.kernels.fresh"] = sys.modules[__name__]
for number in range(2):
    namespace = {"__name__": "mapf_pz.simulator.kernels.fresh"}
    kernel = types.FunctionType((lambda x: x + 1).__code__, namespace, f"kernel_{number}")
    jit(kernel)(1)
"""


def test_compilation_is_reported_once_per_program_and_not_if_the_cache_has_all_kernels(tmp_path):
    (tmp_path / "kernels.py").write_text(COMPILE_TWO_KERNELS)  # kernels without a file could not be cached
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    first, second = (
        subprocess.run(
            [sys.executable, "-c", "import kernels"],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        )
        for _ in range(2)
    )
    assert [line.startswith("compiling kernels") for line in first.stderr.splitlines()] == [True]
    assert (first.stdout, second.stdout, second.stderr) == ("", "", "")
