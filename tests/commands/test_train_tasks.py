"""From the command line, every task: trained, resumed, evaluated and rendered."""

import dataclasses
import json

import numpy as np
import pytest

from mapf_pz import Grid, GuidanceGraph
from mapf_pz.commands.main import main
from mapf_pz.instances import MapMixture, place, write_map, write_scenario
from tests.instances.problem_files import write_lorr, write_pogema

pytest.importorskip("torchrl")

from mapf_pz.rl import load_policy, train
from mapf_pz.rl.config_file import load_config
from tests.helpers.small_run import TINY, changed, rows

pytestmark = pytest.mark.usefixtures("without_figures")

SMALL = "--agent-steps 96 --num-envs 4 --steps-per-batch 8 --num-epochs 1 --num-agents 3 --max-steps 8"
HALL = Grid(np.ones((7, 8), np.bool_), "hall")


@pytest.fixture
def folder(tmp_path):
    """A folder with a map, two scenarios of it, problems, and a suite."""
    write_map(HALL, tmp_path / "hall.map")
    for seed, name in enumerate("ab"):
        write_scenario(place(HALL, 3, np.random.default_rng(seed)), HALL, tmp_path / f"{name}.scen")
    write_lorr(tmp_path)
    write_pogema(tmp_path)
    tasks = [{"map": "hall.map", "scenarios": ["a.scen", "b.scen"], "num_agents": 2, "max_steps": 4}]
    (tmp_path / "suite.json").write_text(json.dumps({"tasks": tasks}))
    return tmp_path


def use(folder, *words):
    """Resume the run in `folder`, evaluate it, and render an episode of the task in `words`."""
    run = str(folder / "run")
    assert main(["train", "resume", run, "--agent-steps", "192", "--evaluate", str(folder / "suite.json")]) == 0
    assert [int(row["agent_steps"]) for row in rows(folder / "run")][-1] == 192
    assert (folder / "run" / "episode.gif").stat().st_size > 0
    map_words = ["--map", str(folder / "hall.map"), "--num-agents", "2", "--max-steps", "4", "--episodes", "1"]
    assert main(["evaluate", "--policy", run, *map_words]) == 0
    assert main(["render", str(folder / "episode.html"), "--policy", run, "--max-steps", "4", *words]) == 0
    assert (folder / "episode.html").stat().st_size > 0


@pytest.mark.parametrize(
    ("words", "shown"),
    [
        ("--map hall.map --scenario a.scen b.scen", "--map hall.map --scenario b.scen"),
        ("--maps random maze warehouse empty-8-8 --height 8 12 --width 9 13 --density 0.1 0.3", "--map maze-13-13-1"),
        ("--scenario depot.json --on-target restart", "--scenario depot.json --on-target restart"),
        ("--scenario 01-set.lmapf.json --on-target restart", "--scenario 01-set.lmapf.json --on-target restart"),
    ],
    ids=["scenarios", "mixture", "robot runners", "pogema"],
)
def test_the_task_is_trained_resumed_evaluated_and_rendered(folder, monkeypatch, words, shown):
    monkeypatch.chdir(folder)
    begin = ["train", "mappo", *SMALL.split(), "--view-size", "3", "3", "--evaluate", "none", "--output", "run"]
    assert main([*begin, *words.split()]) == 0
    use(folder, *shown.split())


def test_flags_of_maps_and_scenarios(folder, monkeypatch):
    monkeypatch.chdir(folder)
    begin = ["train", "mappo", *SMALL.split(), "--evaluate", "none", "--overwrite", "--output", "run"]
    words = "--maps room maze --height 8 12 --width 9 --density 0.2 --corridor 1 2 --room-size 4 --shelf-length 3 4"
    assert main([*begin, *words.split()]) == 0
    assert load_config(folder / "run" / "config.json").task.mixture == MapMixture(
        ("room", "maze"), (8, 12), 9, 0.2, (1, 2), 4, (3, 4)
    )
    assert main([*begin, "--map", "hall.map", "--scenario", "a.scen", "b.scen"]) == 0
    assert load_config(folder / "run" / "config.json").task.env.scenario == ("a.scen", "b.scen")
    assert main([*begin, "--map", "hall.map", "--scenario", "a.scen"]) == 0
    assert load_config(folder / "run" / "config.json").task.env.scenario == "a.scen"


def test_a_range_that_is_not_allowed_is_refused(folder, capsys):
    words = ["train", "mappo", "--height", "20", "10", "--output", str(folder / "run")]
    with pytest.raises(SystemExit):
        main(words)
    assert (
        "height=(20, 10): expected a whole number from 1 to 1073741824, or two in ascending order, a range"
        in " ".join(capsys.readouterr().err.split())
    )
    assert not (folder / "run").exists()


def test_a_guidance_graph_for_the_map_of_a_scenario(folder, monkeypatch):
    monkeypatch.chdir(folder)
    graph = GuidanceGraph.random(HALL.free, np.random.default_rng(0))
    task = changed(TINY.task, map="hall.map", scenario=("a.scen", "b.scen"), edge_weights=graph)
    train(dataclasses.replace(TINY, task=task, agent_steps=96), folder / "run")
    assert load_policy(folder / "run").config.task == task
    run = folder / "run"
    assert main(["train", "resume", str(run), "--agent-steps", "300", "--evaluate", str(folder / "suite.json")]) == 0
    assert (run / "episode.gif").stat().st_size > 0
    assert main(["render", "graph.html", "--policy", str(run), "--map", "hall.map", "--scenario", "a.scen"]) == 0
