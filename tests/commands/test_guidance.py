"""The command `mapf-pz guidance`."""

import numpy as np
import pytest

from mapf_pz.commands.main import main
from mapf_pz.guidance import GuidanceGraph, load_guidance, save_moves
from mapf_pz.instances import write_map
from mapf_pz.instances.instance import Grid

GRID = Grid(np.arange(12).reshape(3, 4) != 5, "hall")
MOVES = np.arange(48).reshape(4, 3, 4)
ARROWS = ">>>v\n^@.v\n<<<<\n"


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    write_map(GRID, tmp_path / "hall.map")
    save_moves(MOVES, tmp_path / "moves.npz")
    (tmp_path / "arrows.txt").write_text(ARROWS)
    monkeypatch.chdir(tmp_path)
    return tmp_path


GENERATED = {
    "uniform": ([], GuidanceGraph.uniform(GRID.free)),
    "random": (
        ["--seed", "3", "--low", "2", "--high", "5"],
        GuidanceGraph.random(GRID.free, np.random.default_rng(3), 2, 5),
    ),
    "crisscross": (["--along", "0.2", "--against", "3"], GuidanceGraph.crisscross(GRID.free, 0.2, 3)),
    "highway": (["--arrows", "arrows.txt", "--along", "0.1"], GuidanceGraph.highway(GRID.free, ARROWS, 0.1)),
    "traffic": (
        ["--moves", "moves.npz", "--contraflow", "2", "--congestion", "3"],
        GuidanceGraph.traffic(GRID.free, MOVES, 2, 3),
    ),
}


@pytest.mark.parametrize("name", GENERATED)
def test_generate(name, capsys):
    words, graph = GENERATED[name]
    assert main(["guidance", "generate", name, "--map", "hall.map", "--output", "new/a.npz", *words]) == 0
    assert capsys.readouterr().out == "new/a.npz: guidance graph of map hall\n"
    assert load_guidance("new/a.npz", GRID) == graph.on_map(GRID.free)


def test_convert(capsys):
    assert main(["guidance", "generate", "random", "--map", "hall.map", "--output", "a.npz"]) == 0
    for before, after in [("a.npz", "b.w"), ("b.w", "c.csv"), ("c.csv", "d.json")]:
        assert main(["guidance", "convert", before, after, "--map", "hall.map"]) == 0
    assert load_guidance("d.json", GRID) == load_guidance("a.npz", GRID)
    capsys.readouterr()
    assert main(["guidance", "convert", "d.json", "e.csv", "--map", "empty-8-8"]) == 1
    error = capsys.readouterr().err
    assert error.startswith("mapf-pz guidance: d.json: expected weights of map 'empty-8-8' (8 x 8), got those of a map")


@pytest.mark.parametrize("output", ["a.png", "new/a.svg"])
@pytest.mark.parametrize("words", [["crisscross"], ["a.csv", "--moves", "moves.npz", "--cell-size", "9"]])
def test_show(folder, capsys, output, words):
    assert main(["guidance", "generate", "random", "--map", "hall.map", "--output", "a.csv"]) == 0
    capsys.readouterr()
    assert main(["guidance", "show", *words, "--map", "hall.map", "--output", output]) == 0
    assert capsys.readouterr().out == f"{output}: {words[0]} on map hall\n"
    assert (folder / output).stat().st_size > 100


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["show", "heavy", "--map", "hall.map", "--output", "a.png"], "edge_weights='heavy': expected one of"),
        (
            ["show", "uniform", "--map", "hall.map", "--output", "a.gif"],
            "a.gif: expected a file name that ends in",
        ),
        (["convert", "a.json", "a.txt", "--map", "hall.map"], "guidance graph 'a.txt': expected a file name that ends"),
        (["generate", "uniform", "--map", "hall.map", "--output", "a.txt"], "guidance graph 'a.txt': expected a file"),
        (
            ["generate", "highway", "--map", "hall.map", "--output", "a.w", "--arrows", "hall.map"],
            "arrows: expected 3 lines, got 7",
        ),
        (
            ["generate", "traffic", "--map", "empty-8-8", "--output", "a.w", "--moves", "moves.npz"],
            "moves.npz: expected numbers 'moves' (4, 8, 8) for map 'empty-8-8', got int64 (4, 3, 4)",
        ),
    ],
)
def test_refusals_are_one_line(capsys, words, message):
    assert main(["guidance", *words]) == 1
    error = capsys.readouterr().err
    assert error.startswith(f"mapf-pz guidance: {message}")
    assert error.count("\n") == 1
