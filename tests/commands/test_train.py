import csv
import json
from dataclasses import replace

import numpy as np
import pytest

from mapf_pz import Grid, Scenario
from mapf_pz.commands.main import main
from mapf_pz.instances import write_map, write_scenario
from mapf_pz.simulator.config import REWARDS

pytest.importorskip("torchrl")

from mapf_pz.rl.config import TrackingConfig
from mapf_pz.rl.config_file import load_config

pytestmark = pytest.mark.usefixtures("without_figures")

SHORT = "--agent-steps 100 --num-envs 4 --steps-per-batch 8 --num-epochs 1 --num-agents 3"
SMALL = f"{SHORT} --height 7 --width 7"


def train(capsys, *words):
    """Train in this process; return the status and the lines on stderr."""
    status = main(["train", *map(str, words)])
    return status, capsys.readouterr().err.splitlines()


def contents(folder):
    return {file: file.read_bytes() for file in folder.rglob("*") if file.is_file()}


@pytest.fixture
def suite(tmp_path):
    """A suite for agents that turn."""
    file = tmp_path / "suite.json"
    task = {"random": [7, 7, 0.1], "num_agents": 2, "max_steps": 4, "episodes": 1}
    file.write_text(json.dumps({"tasks": [task | {"env": {"action_model": "rotate"}}]}))
    return file


def test_an_existing_run_is_kept_unless_overwritten(capsys, tmp_path):
    words = ["quickstart", *SMALL.split(), "--evaluate", "none", "--output", tmp_path / "run"]
    assert train(capsys, *words) == (0, [])
    before = contents(tmp_path)
    assert main(["train", *map(str, words)]) == 1
    told = capsys.readouterr()
    assert told.out == ""  # not that it trains
    assert f"{str(tmp_path / 'run')!r} holds a run" in told.err
    assert contents(tmp_path) == before
    assert train(capsys, *words, "--seed", "1", "--overwrite") == (0, [])
    assert contents(tmp_path) != before


def test_the_evaluation_of_an_overwritten_run_is_replaced(capsys, tmp_path, suite):
    """Also if the new run has the same weights with another configuration."""
    words = ["quickstart", *SMALL.split(), "--evaluate", suite, "--output", tmp_path / "run"]
    assert train(capsys, *words)[0] == 0
    assert train(capsys, *words, "--checkpoint-interval", "1000", "--overwrite")[0] == 0


def test_runs_of_several_seeds_do_not_mix_with_a_run(capsys, tmp_path):
    words = ["quickstart", *SMALL.split(), "--evaluate", "none", "--output", tmp_path / "run"]
    assert train(capsys, *words) == (0, [])
    before = contents(tmp_path)
    for more in ([], ["--overwrite"]):
        status, [line] = train(capsys, *words, "--seeds", "0", "1", *more)
        assert status == 1
        assert f"{str(tmp_path / 'run')!r} holds a run" in line
    assert contents(tmp_path) == before


@pytest.mark.parametrize(
    ("preset", "option", "told"),
    [
        ("quickstart", ["--action-model", "cardinal"], "action_model='cardinal': '2 agents on "),
        ("central-ppo", ["--num-agents", "3"], "num_agents=3: '2 agents on "),
        ("quickstart", ["--map", "absent.map"], "absent.map: no such file"),
        ("quickstart", ["--maps", "maze-13-13-1", "--num-agents", "80"], "maps: 'maze-13-13-1': 80 agents do not fit"),
    ],
)
def test_refusals_leave_an_existing_run_as_it_was(capsys, tmp_path, suite, preset, option, told):
    small = ["quickstart", *SMALL.split(), "--output", tmp_path / "run"]
    assert train(capsys, *small, "--evaluate", "none") == (0, [])
    before = contents(tmp_path / "run")
    short = SHORT if "--map" in option else SMALL
    words = [preset, *short.split(), *option, "--evaluate", suite, "--output", tmp_path / "run", "--overwrite"]
    status, [line] = train(capsys, *words)
    assert status == 1
    assert told in line
    assert contents(tmp_path / "run") == before


def test_an_evaluation_in_the_folder_is_kept(capsys, tmp_path):
    (tmp_path / "episodes.csv").write_text("policy\n")
    status, [line] = train(capsys, "quickstart", *SMALL.split(), "--evaluate", "none", "--output", tmp_path)
    assert (status, list(tmp_path.iterdir())) == (1, [tmp_path / "episodes.csv"])
    assert "holds an evaluation" in line


def test_the_length_of_the_run_is_shown(capsys, tmp_path):
    words = [*SMALL.split(), "--evaluate", "none", "--output", str(tmp_path)]
    assert main(["train", "quickstart", *words]) == 0
    assert "training: 2 updates of 96 agent steps, 192 in all" in capsys.readouterr().out
    assert main(["train", "resume", str(tmp_path), "--agent-steps", "193", "--evaluate", "none"]) == 0
    assert "training: 3 updates of 96 agent steps, 288 in all" in capsys.readouterr().out
    assert len((tmp_path / "progress.csv").read_text().splitlines()) == 1 + 3


def test_a_length_below_one_is_refused(capsys, tmp_path):
    for length in ("0", "-5"):
        with pytest.raises(SystemExit):
            main(["train", "quickstart", "--agent-steps", length, "--output", str(tmp_path / "run")])
        assert f"agent_steps={length}: expected a whole number, 1 or more" in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "run").exists()


def test_every_field_of_the_environment_is_a_flag(tmp_path):
    grid = Grid(np.ones((7, 7), np.bool_))
    write_map(grid, tmp_path / "hall.map")
    write_scenario(Scenario([[0, 0], [1, 1], [2, 2]], [[6, 6], [5, 5], [4, 4]]), grid, tmp_path / "hall.scen")
    words = ["--map", tmp_path / "hall.map", "--scenario", tmp_path / "hall.scen", "--on-target", "finish"]
    words += ["--collision-system", "priority", "--no-see-through-walls", "--initial-heading", "east"]
    words += ["--edge-weights", "crisscross", "--goal", "3", "--channels", "view", "goal"]
    run = tmp_path / "run"
    words = [*SHORT.split(), *map(str, words), "--evaluate", "none", "--output", str(run)]
    assert main(["train", "quickstart", *words]) == 0
    env = load_config(run / "config.json").task.env
    assert (env.map, env.scenario) == (str(tmp_path / "hall.map"), str(tmp_path / "hall.scen"))
    assert (env.on_target, env.collision_system, env.see_through_walls) == ("finish", "priority", False)
    assert (env.initial_heading, env.edge_weights, env.channels) == ("east", "crisscross", ("view", "goal"))
    assert env.reward == replace(REWARDS["progress"], goal=3.0)


def test_help_shows_no_field_that_cannot_be_typed(capsys):
    with pytest.raises(SystemExit):
        main(["train", "quickstart", "--help"])
    told = capsys.readouterr().out
    assert "--on-target {nothing,finish,restart}" in told
    assert "--render-mode" not in told


@pytest.mark.parametrize("shield", [False, True])
def test_a_policy_is_evaluated_as_it_was_trained_with_or_without_the_safety_layer(tmp_path, shield):
    crowd = {"random": [5, 5, 0.0], "num_agents": 12, "max_steps": 10, "episodes": 2, "env": {"action_model": "rotate"}}
    file = tmp_path / "suite.json"
    file.write_text(json.dumps({"tasks": [crowd]}))
    flag = "--shield" if shield else "--no-shield"
    words = [
        "quickstart",
        flag,
        *SMALL.split(),
        "--view-size",
        "5",
        "5",
        "--evaluate",
        file,
        "--output",
        tmp_path / "run",
    ]
    assert main(["train", *map(str, words)]) == 0
    with (tmp_path / "run" / "episodes.csv").open() as episodes:
        collisions = [float(row["collisions"]) for row in csv.DictReader(episodes)]
    assert len(collisions) == 2
    assert (sum(collisions) == 0) == shield


def test_progress_is_printed_where_there_is_no_terminal(capsys, tmp_path):
    assert main(["train", "quickstart", *SMALL.split(), "--evaluate", "none", "--output", str(tmp_path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line[:4] for line in lines if "steps/s" in line] == [" 50%", "100%"]


def test_several_seeds_are_runs_in_subfolders(capsys, tmp_path):
    words = ["quickstart", *SMALL.split(), "--seeds", "3", "5", "--evaluate", "none", "--output", tmp_path / "runs"]
    assert train(capsys, *words) == (0, [])
    assert {file.name for file in (tmp_path / "runs").iterdir()} == {"seed-3", "seed-5", "learning_curve.png"}
    for seed in (3, 5):
        assert load_config(tmp_path / "runs" / f"seed-{seed}" / "config.json").seed == seed
    before = contents(tmp_path)
    assert train(capsys, *words) == (0, [])  # finished runs are kept
    after = contents(tmp_path)
    weights = [file for file in before if file.suffix in (".safetensors", ".csv")]
    assert len(weights) == 4
    assert all(before[file] == after[file] for file in weights)
    status, [line] = train(capsys, *words, "--gamma", "0.5")
    assert status == 1
    assert f"output {str(tmp_path / 'runs' / 'seed-3')!r} holds a run with other options" in line
    assert contents(tmp_path) == after


def test_a_sweep_is_a_run_for_each_setting_and_seed(capsys, tmp_path, suite):
    output = tmp_path / "runs"
    words = ["quickstart", *SMALL.split(), "--num-agents", 2, "--hidden", 8, "--seeds", 3, 5, "--evaluate", suite]
    sweep = ["--sweep", "learning-rate=0.002,conv-channels=4 8", "no-shield", "--output", output, "--tags", "small"]
    assert main(["train", *map(str, [*words, *sweep])]) == 0
    names = ["learning-rate=0.002,conv-channels=4-8", "no-shield"]
    assert {file.name for file in output.iterdir()} == {*names, "learning_curve.png", "evaluation.md"}
    for name, channels in zip(names, [(4, 8), (16,)], strict=True):
        for seed in (3, 5):
            config = load_config(output / name / f"seed-{seed}" / "config.json")
            assert (config.seed, config.model.conv_channels, config.model.hidden) == (seed, channels, 8)
            tracking = TrackingConfig(group="runs", run_name=f"runs/{name}/seed-{seed}", tags=("small",))
            assert config.tracking == tracking
    rows = [line.split(" | ") for line in (output / "evaluation.md").read_text().splitlines() if "7 x 7" in line]
    assert [(row[2], row[3], row[4]) for row in rows] == [(name, "2", "2") for name in names]
    capsys.readouterr()
    (output / names[1] / "seed-5" / "episodes.csv").unlink()
    (output / "evaluation.md").unlink()
    assert train(capsys, *words, *sweep) == (0, [])  # what is missing is made
    assert (output / names[1] / "seed-5" / "episodes.csv").exists()
    assert (output / "evaluation.md").exists()


@pytest.mark.parametrize(
    ("sweep", "status", "told"),
    [
        (["hidden=8", "hidden=8"], 1, "expected settings that differ"),
        (["hidden=0"], 2, "hidden"),
        (["size=8"], 2, "size"),
    ],
)
def test_a_wrong_sweep_is_refused_before_it_begins(capsys, tmp_path, sweep, status, told):
    words = ["quickstart", *SMALL.split(), "--evaluate", "none", "--output", str(tmp_path / "runs"), "--sweep", *sweep]
    try:
        found = main(["train", *words])
    except SystemExit as end:
        found = end.code
    assert found == status
    assert told in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()


def test_a_run_starts_from_a_configuration_file(capsys, tmp_path):
    words = ["quickstart", *SMALL.split(), "--evaluate", "none", "--output", tmp_path / "first"]
    assert train(capsys, *words) == (0, [])
    file = tmp_path / "first" / "config.json"
    words = [file, "--seed", "4", "--gamma", "0.9", "--evaluate", "none", "--output", tmp_path / "second"]
    assert train(capsys, *words) == (0, [])
    first, second = (load_config(tmp_path / name / "config.json") for name in ("first", "second"))
    assert second == replace(first, seed=4, ppo=replace(first.ppo, gamma=0.9))


@pytest.mark.parametrize("text", [None, "{", '{"seed": -1}'])
def test_a_missing_or_malformed_configuration_file_is_refused(capsys, tmp_path, text):
    file = tmp_path / "mine.json"
    if text is not None:
        file.write_text(text)
    status, [line] = train(capsys, file, "--output", tmp_path / "run")
    assert status == 1
    assert str(file) in line
    assert not (tmp_path / "run").exists()
