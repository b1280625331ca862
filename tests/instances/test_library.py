from pathlib import Path

import numpy as np
import pytest

from mapf_pz.errors import FormatError
from mapf_pz.instances import load_map, load_scenario, map_names, write_map, write_scenario
from mapf_pz.instances.bundled import BUNDLED
from mapf_pz.instances.instance import Grid, Scenario

GRID = Grid([[True, False, True], [True, True, True]], "tiny")
SCENARIO = Scenario([[1, 0]], [[0, 2]])


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """A benchmark of one map and one scenario."""
    (tmp_path / "maps").mkdir()
    (tmp_path / "scens").mkdir()
    write_map(GRID, tmp_path / "maps" / "tiny.map")
    write_scenario(SCENARIO, GRID, tmp_path / "scens" / "tiny-random-1.scen")
    monkeypatch.delenv("MAPF_PZ_BENCHMARK", raising=False)
    return tmp_path


@pytest.fixture
def named(folder, monkeypatch):
    monkeypatch.setenv("MAPF_PZ_BENCHMARK", str(folder))
    return folder


def test_map_names():
    assert set(map_names()) > set(BUNDLED)
    assert all(load_map(name).name == name for name in map_names())


def test_a_map_by_file(folder):
    file = folder / "maps" / "tiny.map"
    for same in (file, str(file)):
        assert load_map(same).free.tolist() == GRID.free.tolist()
    assert load_map(file.rename(folder / "no ending")).shape == (2, 3)


def test_a_map_by_name_of_the_benchmark(named):
    assert load_map("tiny").free.tolist() == GRID.free.tolist()
    write_map(GRID, named / "maps" / "empty-8-8.map")
    assert load_map("empty-8-8").shape == (8, 8)


@pytest.mark.parametrize("drawing", [".#.\n...", "\n\n    .@.\n    ...\n\n  ", ".T.  \r\n...\r\n", "\t.O.\n\t...\n"])
def test_a_map_by_drawing(drawing):
    assert load_map(drawing).free.tolist() == GRID.free.tolist()


def test_a_map_by_array_or_grid():
    assert load_map(GRID) is GRID
    assert load_map(GRID.free).free.tolist() == GRID.free.tolist()


@pytest.mark.parametrize(
    ("map", "error", "message"),
    [
        ("empty-8-9", ValueError, r"^no \.map file is named 'empty-8-9': did you mean 'empty-8-8'.* MAPF_PZ_BENCHMARK"),
        ("", ValueError, r"^no \.map file is named '': A path ends in \.map"),
        ("../maps/tiny", ValueError, "no .map file is named"),
        ("nowhere.map", FileNotFoundError, r"^nowhere\.map: no such file$"),
        (Path("nowhere"), FileNotFoundError, "^nowhere: no such file$"),
        ("\n\n", ValueError, "the drawing is empty"),
        ("\n  ...\n  ..\n", FormatError, "^map:3:3: expected a row of 3 cells, got 2$"),
        ("...\n\n...", FormatError, "^map:2:1: expected a row of 3 cells, got 0$"),
        ("...\n.x.", FormatError, "^map:2:2: expected one of .#@OTW, got 'x'$"),
        (np.zeros((2, 2)), TypeError, "bool array with True for free, got ndarray of float64"),
        (np.zeros(2, np.bool_), ValueError, "expected an array of H x W cells"),
        (3, TypeError, "expected a name"),
        (None, TypeError, "expected a name"),
    ],
)
def test_files_that_are_not_maps_are_refused_in_one_line(named, map, error, message):
    with pytest.raises(error, match=message) as caught:
        load_map(map)
    assert "\n" not in str(caught.value)


def test_a_scenario_by_object_file_or_name(named):
    assert load_scenario(SCENARIO) is SCENARIO
    file = named / "scens" / "tiny-random-1.scen"
    for same in (file, str(file), "tiny-random-1"):
        assert load_scenario(same, GRID).starts.tolist() == [[1, 0]]


def test_files_that_are_not_scenarios_are_refused_in_one_line(named):
    with pytest.raises(ValueError, match=r"^no \.scen file is named 'tiny-random-2': did you mean 'tiny-random-1'"):
        load_scenario("tiny-random-2")
    with pytest.raises(FileNotFoundError, match="no such file"):
        load_scenario("tiny.scen")
    with pytest.raises(FormatError, match="expected the size of map 'empty-8-8'"):
        load_scenario("tiny-random-1", load_map("empty-8-8"))
    with pytest.raises(TypeError, match="got int"):
        load_scenario(4)


def test_without_a_benchmark_folder_names_are_of_bundled_maps_only():
    with pytest.raises(ValueError, match="run mapf-pz maps download, or set MAPF_PZ_BENCHMARK"):
        load_map("tiny")
    with pytest.raises(ValueError, match="set MAPF_PZ_BENCHMARK"):
        load_scenario("tiny-random-1")


def test_bundled_names_come_before_those_of_a_folder(named):
    (named / "scens" / "tiny-random-1.scen").rename(named / "scens" / "den312d-random-1.scen")
    assert len(load_scenario("den312d-random-1")) == 1000
    grid = load_map("den312d")
    assert grid.free.sum() == 2445
    assert len(load_scenario("random-2", grid)) == 1000


def test_relative_names_are_of_the_folder_too(named):
    assert load_scenario("random-1", GRID) == SCENARIO


def test_the_real_benchmark_by_name(benchmark, monkeypatch):
    monkeypatch.setenv("MAPF_PZ_BENCHMARK", str(benchmark))
    grid = load_map("brc202d")
    assert grid.free.sum() == 43151
    assert len(load_scenario("brc202d-random-1", grid)) == 1000
