"""Files of guidance graphs: what is written is read back to the bit, and other files are refused in one line."""

import json
import zipfile
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mapf_pz import FormatError
from mapf_pz.guidance import (
    GuidanceGraph,
    count_moves,
    load_guidance,
    load_moves,
    open_edges,
    save_guidance,
    save_moves,
)
from mapf_pz.instances.instance import Grid

FORMATS = [".json", ".csv", ".w", ".npz"]
GRID = Grid([[True, True, False], [True, True, True]], "tiny")
GRAPH = GuidanceGraph.random(GRID.free, np.random.default_rng(0)).on_map(GRID.free)
RELEASED = Path(__file__).parents[3] / "shared" / "guidance-graphs"
MAPS_ONLY = ("pibt_empty-48-48.json", "pibt_room-64-64-8.json", "pibt_warehouse_33x36_w_mode.json")


@st.composite
def drawn_graphs(draw):
    """Return a map, and a graph of it: with one-way edges, and equal or different costs of waiting."""
    free = draw(arrays(np.bool_, st.tuples(st.integers(1, 4), st.integers(1, 4))))
    # Larger weights mean blocked edges in WPPL's format.
    positive = st.floats(0, 99_999, exclude_min=True, width=32)
    move = draw(arrays(np.float32, (4, *free.shape), elements=positive | st.just(np.inf)))
    wait = draw(arrays(np.float32, free.shape, elements=positive) | positive.map(lambda w: np.full(free.shape, w)))
    return Grid(free, draw(st.text(max_size=5))), GuidanceGraph(move, wait)


@pytest.mark.parametrize("ending", FORMATS)
@given(drawn_graphs())
def test_what_is_written_is_read(ending, drawn):
    grid, graph = drawn
    with TemporaryDirectory() as folder:
        file = Path(folder) / f"a{ending}"
        save_guidance(graph, file, grid)
        loaded = load_guidance(file, grid)
        assert loaded == graph.on_map(grid.free)
        if ending != ".w":
            assert load_guidance(file) == loaded


@pytest.mark.parametrize("ending", [".json", ".csv", ".npz"])
def test_the_largest_float32_is_kept(tmp_path, ending):
    largest = np.finfo(np.float32).max
    graph = GuidanceGraph(np.full((4, 1, 2), largest), np.full((1, 2), largest))
    grid = Grid([[True, True]])
    save_guidance(graph, tmp_path / f"a{ending}", grid)
    assert load_guidance(tmp_path / f"a{ending}", grid) == graph.on_map(grid.free)


def test_only_weights_of_the_map_are_kept():
    graph = GuidanceGraph(np.full((4, 2, 3), 5.0), np.full((2, 3), 7.0)).on_map(GRID.free)
    np.testing.assert_array_equal(np.isfinite(graph.move), open_edges(GRID.free))
    assert graph.wait.tolist() == [[7, 7, 1], [7, 7, 7]]


# GGO's formats, spelled out.

ONE = {
    "layout": ["w@", ".e"],
    "optimize_wait": True,
    "weights": [1, 2, 3, 10, 11, 12, -1],
}


def test_the_order_of_json(tmp_path):
    """Waits of the three free cells, then down from the first; right and up from the second; left from the third."""
    (tmp_path / "a.json").write_text(json.dumps(ONE))
    graph = load_guidance(tmp_path / "a.json")
    assert graph.wait.tolist() == [[1, 1], [2, 3]]
    inf = np.inf
    assert graph.move.tolist() == [
        [[inf, inf], [11, inf]],
        [[10, inf], [inf, inf]],
        [[inf, inf], [inf, inf]],
        [[inf, inf], [12, inf]],
    ]
    (tmp_path / "a.json").write_text(json.dumps(ONE | {"optimize_wait": False, "weights": [4, 10, 11, 12, 13]}))
    graph = load_guidance(tmp_path / "a.json")
    assert graph.wait.tolist() == [[4, 1], [4, 4]]
    assert graph.move[2, 1, 1] == 13


def test_the_columns_of_csv(tmp_path):
    (tmp_path / "a.json").write_text(json.dumps(ONE))
    grid = Grid([[True, False], [True, True]])
    save_guidance(load_guidance(tmp_path / "a.json"), tmp_path / "a.csv", grid)
    assert (tmp_path / "a.csv").read_text().splitlines() == [
        "id,type,x,y,weight_to_RIGHT,weight_to_UP,weight_to_LEFT,weight_to_DOWN,weight_for_WAIT",
        "0,.,0,0,inf,inf,inf,10.0,1.0",
        "1,@,0,1,inf,inf,inf,inf,inf",
        "2,.,1,0,11.0,12.0,inf,inf,2.0",
        "3,.,1,1,inf,inf,inf,inf,3.0",
    ]


def test_the_order_of_wppl(tmp_path):
    grid = Grid([[True, True]])
    (tmp_path / "a.w").write_text("[1.5, 9, 9, 9, 2, 9, 9, 100000, 9, 3]")  # 9: edges that the map does not have
    graph = load_guidance(tmp_path / "a.w", grid)
    assert graph.move[0].tolist() == [[1.5, np.inf]]
    assert np.isinf(graph.move[1:]).all()
    assert graph.wait.tolist() == [[2, 3]]
    save_guidance(graph, tmp_path / "b.w", grid)
    blocked = 100000.0
    assert json.loads((tmp_path / "b.w").read_text()) == [1.5, *[blocked] * 3, 2, *[blocked] * 4, 3]


def test_numbers_have_as_few_digits_as_float32_needs(tmp_path):
    graph = GuidanceGraph(np.full((4, 1, 2), 0.1), np.full((1, 2), 59.24576870171247))
    save_guidance(graph, tmp_path / "a.json", Grid([[True, True]]))
    assert json.loads((tmp_path / "a.json").read_text())["weights"] == [59.24577, 0.1, 0.1]


# GGO's released files.


def released():
    if not RELEASED.is_dir():
        reason = f"{RELEASED} is absent: GGO's files are not part of the repository"
        return [pytest.param(None, marks=pytest.mark.skip(reason=reason))]
    return [pytest.param(file, id=file.name) for file in sorted(RELEASED.iterdir()) if file.suffix in FORMATS]


@pytest.mark.parametrize("file", released())
def test_released_files(tmp_path, file):
    if file.name in MAPS_ONLY:
        with pytest.raises(FormatError, match=r"\.json: expected 'weights' to be a list, got None$"):
            load_guidance(file)
        return
    layout = json.loads(file.with_suffix(".json").read_text())["layout"]
    grid = Grid(np.array([[cell != "@" for cell in row] for row in layout]), "released")
    graph = load_guidance(file, grid)
    for ending in FORMATS:
        save_guidance(graph, tmp_path / f"a{ending}", grid)
        assert load_guidance(tmp_path / f"a{ending}", grid) == graph
    assert load_guidance(file.with_suffix(".json"), grid) == graph  # tables hold the same weights
    free = graph.move[np.isfinite(graph.move)]
    assert 0.0999 < free.min() <= free.max() <= 100
    if "unweight_32x32.json" in file.name:
        assert graph == GuidanceGraph.uniform(grid.free)
    if "alternate_baseline" in file.name:
        assert graph == GuidanceGraph.crisscross(grid.free).on_map(grid.free)


# Refusals.

OTHER = Grid([[True, True, True], [True, True, False]], "other")


@pytest.mark.parametrize("ending", FORMATS)
def test_graphs_of_another_map(tmp_path, ending):
    file = tmp_path / f"a{ending}"
    save_guidance(GRAPH, file, GRID)
    larger = Grid(np.ones((3, 3), np.bool_), "larger")
    with pytest.raises(FormatError, match=r"a\.\w+: expected .*map 'larger' \(3 x 3\)") as caught:
        load_guidance(file, larger)
    assert len(str(caught.value).splitlines()) == 1
    if ending != ".w":
        with pytest.raises(FormatError, match=r"a\.\w+: expected weights of map 'other', got those of a"):
            load_guidance(file, OTHER)
    with pytest.raises(ValueError, match=r"^guidance graph of shape \(2, 3\): the map's shape is \(3, 3\)"):
        save_guidance(GRAPH, file, larger)


def changed(file, old, new):
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))


@pytest.mark.parametrize(
    ("ending", "old", "new", "message"),
    [
        (".json", '"..', '".#', r"expected row 0 of 'layout' to consist of \.we@T, got '\.#@'"),
        (".json", '"layout": [', '"layout": [".",', "expected 1 cells in row 1 of 'layout', got 3"),
        (".json", '_wait": true', '_wait": 2', "expected 'optimize_wait' to be true or false, got 2"),
        (".json", '_wait": true', '_wait": false', "expected 11 numbers in 'weights', 1 of them for waiting, got 15"),
        (".json", '"weights": [', '"weights": [7,', "expected 15 numbers in 'weights', 5 of them for waiting, got 16"),
        (".json", '"weights": [\n  0.', '"weights": [\n  -1.', "expected a finite number greater than 0 as weight 0"),
        (".json", '"weights": [', '"weights": ["x",', "expected a number as weight 0, got 'x'"),
        (".json", '"weights": [\n  0', '"weights": [\n  1e300, 0', "expected 15 numbers"),
        (".csv", "id,", "no,", r"a\.csv:1: expected the header id,"),
        (".csv", "0,.,", "0,#,", r"a\.csv:2: expected a cell: id,type,"),
        (".csv", "\n1,", "\n2,", r"a\.csv:3: expected all cells of 2 rows and 3 columns in reading order"),
        (".csv", "2,@,0,2,inf", "2,@,0,2,1.5", r"a\.csv:4: expected inf for moves out of the map, and"),
        (".csv", ",0,0,0.", ",0,0,-0.", r"a\.csv:2: expected a cell"),
        (".csv", ",0,0,0.", ",0,0,1e39,#", r"a\.csv:2: expected a cell"),
        (".w", "[0", "{}#[0", "a.w:1:3: expected JSON"),
        (".w", "[0", "[0,0", r"expected 30 numbers, 5 numbers for each cell of map 'tiny' \(2 x 3\), got 31"),
        (".w", "[0.", "[-0.", "expected a finite number greater than 0 as weight 0, got -0"),
    ],
)
def test_malformed_files(tmp_path, ending, old, new, message):
    file = tmp_path / f"a{ending}"
    save_guidance(GRAPH, file, GRID)
    changed(file, old, new)
    with pytest.raises(FormatError, match=message) as caught:
        load_guidance(file, GRID)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize("number", ["1e39", "1e-50", "0", "1e9999"])
def test_numbers_that_are_no_float32(tmp_path, number):
    for ending in (".json", ".csv"):
        save_guidance(GuidanceGraph.uniform(GRID.free), tmp_path / f"a{ending}", GRID)
    changed(tmp_path / "a.json", " 1.0", f" {number}")
    changed(tmp_path / "a.csv", "0,.,0,0,1.0", f"0,.,0,0,{number}")
    with pytest.raises(FormatError, match=r"a\.json: expected a (finite )?number"):
        load_guidance(tmp_path / "a.json")
    changed(tmp_path / "a.json", f" {number}", " NaN")
    with pytest.raises(FormatError, match=r"a\.json: expected a finite number greater than 0 as weight 0, got nan"):
        load_guidance(tmp_path / "a.json")
    with pytest.raises(FormatError, match=r"a\.csv:2: expected (a )?finite number"):
        load_guidance(tmp_path / "a.csv")


def test_an_edge_that_a_table_must_have(tmp_path):
    save_guidance(GRAPH, tmp_path / "a.csv", GRID)
    lines = (tmp_path / "a.csv").read_text().splitlines()
    cells = lines[1].split(",")
    lines[1] = ",".join([*cells[:-1], "inf"])  # waiting cannot be blocked
    (tmp_path / "a.csv").write_text("\n".join(lines))
    with pytest.raises(FormatError, match=r"a\.csv:2: expected a finite number greater than 0, got inf"):
        load_guidance(tmp_path / "a.csv")


def test_endings(tmp_path):
    for call in (lambda: load_guidance("a.txt"), lambda: save_guidance(GRAPH, tmp_path / "a.txt", GRID)):
        with pytest.raises(
            ValueError, match=r"^guidance graph '.*a\.txt': expected .* ends in \.json, \.csv, \.w, \.npz"
        ):
            call()
    with pytest.raises(ValueError, match=r"a\.w: a \.w file does not contain the size of its map"):
        load_guidance("a.w")
    with pytest.raises(FileNotFoundError, match=r"nowhere\.json: no such file"):
        load_guidance("nowhere.json")


def test_weights_that_wppl_cannot_hold(tmp_path):
    graph = GuidanceGraph(np.full((4, 2, 3), 100_000.0), np.ones((2, 3)))
    with pytest.raises(ValueError, match=r"a\.w: expected weights less than 100000, .* got 100000"):
        save_guidance(graph, tmp_path / "a.w", GRID)
    assert not (tmp_path / "a.w").exists()


# Archives.


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"move": np.ones((4, 2, 2))}, r"expected floating-point numbers 'move' \(4, H, W\) and 'wait' \(H, W\)"),
        ({"move": np.ones((4, 2, 3), np.int64)}, "expected floating-point numbers"),
        ({"move": np.zeros((4, 2, 3))}, "expected a finite number greater than 0 as weight 0, got 0"),
        ({"move": np.full((4, 2, 3), np.nan)}, "expected a finite number greater than 0 as weight 0, got nan"),
        ({"wait": np.full((2, 3), np.inf)}, "expected a finite number greater than 0 as weight 0, got inf"),
        ({"digest": "0"}, "expected weights of map 'tiny', got those of another map, 'tiny'"),
        ({"map": np.array([{}], dtype=object)}, "expected an .npz file with the arrays move, wait, map, digest: array"),
    ],
)
def test_malformed_archives(tmp_path, change, message):
    save_guidance(GRAPH, tmp_path / "a.npz", GRID)
    with np.load(tmp_path / "a.npz") as archive:
        contents = dict(archive)
    np.savez(tmp_path / "a.npz", **contents | change)
    with pytest.raises(FormatError, match=message):
        load_guidance(tmp_path / "a.npz", GRID)


def test_an_archive_without_an_array(tmp_path):
    np.savez(tmp_path / "a.npz", move=GRAPH.move, wait=GRAPH.wait)
    with pytest.raises(FormatError, match=r"a\.npz: expected an \.npz file with the arrays move, .*: .*map\.npy"):
        load_guidance(tmp_path / "a.npz")


def test_an_array_that_claims_another_size(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (999999999, 999999), }\n"
        archive.writestr("moves.npy", b"\x93NUMPY\x01\0" + len(header).to_bytes(2, "little") + header)
    with pytest.raises(FormatError, match="array 'moves' is not of the size in its header"):
        load_moves(tmp_path / "a.npz", GRID)


# Counted moves.


def test_moves(tmp_path):
    positions = np.array([[[0, 0], [1, 2]], [[0, 1], [1, 2]], [[1, 1], [1, 1]], [[1, 1], [1, 0]]])
    moves = count_moves(positions, GRID.shape)
    expected = np.zeros((4, 2, 3))
    for heading, row, col in [(0, 0, 0), (1, 0, 1), (2, 1, 2), (2, 1, 1)]:
        expected[heading, row, col] += 1
    np.testing.assert_array_equal(moves, expected)
    save_moves(moves, tmp_path / "moves.npz")
    np.testing.assert_array_equal(load_moves(tmp_path / "moves.npz", GRID), expected)
    save_moves(np.asfortranarray(moves), tmp_path / "moves.npz")
    np.testing.assert_array_equal(load_moves(tmp_path / "moves.npz", GRID), expected)


@pytest.mark.parametrize(
    ("moves", "message"),
    [
        (np.ones((4, 3, 2)), r"expected numbers 'moves' \(4, 2, 3\) for map 'tiny', got float64 \(4, 3, 2\)"),
        (np.ones((4, 2, 3), np.bool_), "expected numbers 'moves'"),
        (np.full((4, 2, 3), -1), "expected finite numbers 0 or more in 'moves'"),
        (np.full((4, 2, 3), np.nan), "expected finite numbers 0 or more in 'moves'"),
    ],
)
def test_malformed_moves(tmp_path, moves, message):
    save_moves(moves, tmp_path / "moves.npz")
    with pytest.raises(FormatError, match=message):
        load_moves(tmp_path / "moves.npz", GRID)
