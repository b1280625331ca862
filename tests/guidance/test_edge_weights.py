"""`edge_weights` as the path of a file, or as the name of a bundled graph."""

import dataclasses
import json
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

import mapf_pz
from mapf_pz.commands.main import main
from mapf_pz.guidance import GuidanceGraph, guidance_names, library, save_guidance
from mapf_pz.instances import RandomObstacles, load_instance, load_map, write_map
from mapf_pz.instances.instance import Grid
from mapf_pz.planners import PIBT

GRID = Grid(np.arange(64).reshape(8, 8) % 11 != 5, "hall")
GRAPH = GuidanceGraph.random(GRID.free, np.random.default_rng(0)).on_map(GRID.free)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    write_map(GRID, tmp_path / "hall.map")
    for ending in ("json", "csv", "w", "npz"):
        save_guidance(GRAPH, tmp_path / f"a.{ending}", GRID)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def bundled(tmp_path, monkeypatch):
    """A bundled graph of the name `hall-4`."""
    (tmp_path / "graphs").mkdir()
    save_guidance(GRAPH, tmp_path / "graphs" / "hall-4.npz", GRID)
    monkeypatch.setattr(library.resources, "files", lambda _: tmp_path)


@pytest.mark.parametrize("weights", ["a.json", "a.csv", "a.w", "a.npz", Path("a.csv")])
def test_an_environment_reads_a_file(folder, weights):
    env = mapf_pz.parallel_env(map="hall.map", edge_weights=weights)
    env.reset(seed=0)
    np.testing.assert_array_equal(env.simulator.guidance(0).move, GRAPH.move)


def test_a_bundled_graph(folder, bundled):
    assert guidance_names() == ["hall-4"]
    env = mapf_pz.parallel_env(map="hall.map", edge_weights="hall-4")
    env.reset(seed=0)
    np.testing.assert_array_equal(env.simulator.guidance(0).move, GRAPH.move)
    with pytest.raises(
        ValueError,
        match="^edge_weights='hal': expected one of 'uniform', 'random', 'crisscross', 'hall-4', or the path of a file "
        r"\(\.json, \.csv, \.w, \.npz\)$",
    ):
        mapf_pz.EnvConfig(edge_weights="hal")


@pytest.mark.parametrize(("name", "along"), [("crisscross", 0.5), ("crisscross:0.5", 0.5), ("crisscross:0.7", 0.7)])
def test_crisscross_has_a_weight_along_its_directions(name, along):
    env = mapf_pz.parallel_env(map="empty-8-8", edge_weights=name, num_agents=3)
    env.reset(seed=0)
    expected = GuidanceGraph.crisscross(np.ones((8, 8), bool), along=along)
    np.testing.assert_array_equal(env.simulator.guidance(0).move, expected.move)
    env = mapf_pz.parallel_env(source=RandomObstacles(4, 4, 0.2, 3), edge_weights=name)
    env.reset(seed=0)
    weights = env.simulator.guidance(0).move
    assert set(weights[np.isfinite(weights)]) == {np.float32(along), 1}


@pytest.mark.parametrize("along", ["", "0", "-1", "inf", "nan", "half"])
def test_other_weights_along_its_directions_are_refused(along):
    with pytest.raises(
        ValueError, match=f"^edge_weights='crisscross:{along}': expected a number greater than 0 after "
    ):
        mapf_pz.EnvConfig(edge_weights=f"crisscross:{along}")


def test_weights_that_are_random_in_a_share_of_the_episodes():
    env = mapf_pz.parallel_env(map="empty-8-8", edge_weights="random:0.25", num_agents=3)
    graphs = []
    for seed in range(40):
        env.reset(seed=seed)
        weights = env.simulator.guidance(0).move
        graphs.append(weights[np.isfinite(weights)])
    is_uniform = [bool((weights == 1).all()) for weights in graphs]
    assert 20 < sum(is_uniform) < 38
    different = [weights for weights, uniform in zip(graphs, is_uniform, strict=True) if not uniform]
    assert all(0.1 <= weights.min() < weights.max() <= 1 for weights in different)
    assert len({weights.tobytes() for weights in different}) == len(different)


def test_random_weights_in_all_episodes():
    moves = []
    for name in ("random", "random:1"):
        env = mapf_pz.parallel_env(map="empty-8-8", edge_weights=name, num_agents=3)
        env.reset(seed=0)
        moves.append(env.simulator.guidance(0).move)
    np.testing.assert_array_equal(*moves)


@pytest.mark.parametrize("share", ["", "0", "-1", "1.5", "nan", "half"])
def test_other_shares_are_refused(share):
    advice = "expected a number greater than 0 and at most 1 after 'random:'"
    with pytest.raises(ValueError, match=f"^edge_weights='random:{share}': {advice}$"):
        mapf_pz.EnvConfig(edge_weights=f"random:{share}")


@pytest.mark.parametrize("name", guidance_names())
def test_every_bundled_graph_has_a_card(name):
    folder = Path(str(resources.files("mapf_pz.guidance"))) / "graphs"
    assert json.loads((folder / f"{name}.json").read_text())


@pytest.mark.parametrize(
    ("keywords", "error", "message"),
    [
        ({"edge_weights": "nowhere.json"}, FileNotFoundError, r"nowhere\.json: no such file"),
        ({"map": "empty-8-8"}, mapf_pz.FormatError, r"a\.csv: expected weights of map 'empty-8-8', got those of a map"),
        ({"map": "empty-16-16"}, mapf_pz.FormatError, r"a\.csv: .* \(16 x 16\), got those of a map of 8 x 8 cells"),
        (
            {"map": None, "source": RandomObstacles(8, 8, 0.1, 3)},
            ValueError,
            "edge_weights='a.csv': a file is for one map, but the maps of the episodes differ",
        ),
    ],
)
def test_what_an_environment_refuses(folder, keywords, error, message):
    with pytest.raises(error, match=f"^{message}"):
        mapf_pz.parallel_env(**{"map": "hall.map", "edge_weights": "a.csv"} | keywords)


def test_planners_read_a_file(folder):
    instance = load_instance("hall.map", num_agents=6)
    plan = PIBT(seed=0).solve(instance, edge_weights="a.json")
    np.testing.assert_array_equal(plan.positions, PIBT(seed=0).solve(instance, edge_weights=GRAPH).positions)


def test_the_command_line_reads_a_file(folder, capsys):
    words = ["--map", "hall.map", "--num-agents", "5", "--edge-weights"]
    assert main(["solve", "plan.txt", *words, "a.csv", "--action-model", "cardinal"]) == 0
    assert main(["render", "out.svg", *words, "a.w", "--max-steps", "5"]) == 0
    capsys.readouterr()
    assert main(["render", "out.svg", *words, "b.w"]) == 1
    assert capsys.readouterr().err == "mapf-pz render: b.w: no such file\n"


def test_a_run_does_not_depend_on_the_file(folder):
    rl = pytest.importorskip("mapf_pz.rl")
    from tests.helpers.small_run import TINY, changed

    task = changed(TINY.task, map="hall.map", edge_weights="a.w")
    run = rl.train(dataclasses.replace(TINY, task=task, agent_steps=96), folder / "run")
    (folder / "a.w").unlink()
    assert rl.load_policy(run).env_kwargs["edge_weights"] == GRAPH


def test_the_map_of_json_is_a_map(folder):
    assert load_map("a.json") == Grid(GRID.free, "a")
