import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from mapf_pz.errors import FormatError
from mapf_pz.instances import (
    format_map,
    format_scenario,
    load_map,
    parse_map,
    parse_scenario,
    place,
    read_map,
    read_scenario,
    write_map,
    write_scenario,
)
from mapf_pz.instances.bundled import map_path
from mapf_pz.instances.files.octile import octile_distances
from mapf_pz.instances.instance import Grid, Scenario
from tests.helpers.corrupt_files import near_misses

MAP = "type octile\nheight 2\nwidth 3\nmap\n.@.\n...\n"
GRID = Grid([[True, False, True], [True, True, True]], "tiny")
SCENARIO = "version 1\n0\ttiny.map\t3\t2\t0\t1\t2\t0\t3.00000000\n"

SIZES = {  # (height, width), passable cells: the benchmark's own README
    "Berlin_1_256": ((256, 256), 47540),
    "brc202d": ((481, 530), 43151),
    "den312d": ((81, 65), 2445),
    "lt_gallowstemplar_n": ((180, 251), 10021),
    "maze-128-128-10": ((128, 128), 14818),
    "orz900d": ((656, 1491), 96603),
    "random-32-32-20": ((32, 32), 819),
    "warehouse-10-20-10-2-1": ((63, 161), 5699),
}


def message_of(call, *arguments):
    with pytest.raises(FormatError) as caught:
        call(*arguments)
    message = str(caught.value)
    assert "\n" not in message
    return message


# Maps.


def test_map():
    grid = parse_map(MAP, "folder/tiny.map")
    assert grid.name == "tiny"
    assert grid.free.tolist() == GRID.free.tolist()


def test_passable_and_blocked_characters():
    grid = parse_map("type octile\nheight 1\nwidth 8\nmap\n.GSE@OTW\n", "m")
    assert grid.free.tolist() == [[True] * 4 + [False] * 4]


@pytest.mark.parametrize(
    "text",
    [
        MAP.replace("\n", "\r\n"),
        MAP.rstrip("\n"),
        MAP + "\n \r\n\n",
        MAP + MAP,
        MAP + "\n" + MAP,
        MAP + "\n" + MAP[:20],
    ],
    ids=["CRLF", "no final newline", "blank lines", "a second map", "a second map after a blank line", "half a map"],
)
def test_tolerated_maps(text):
    assert parse_map(text, "m").free.tolist() == GRID.free.tolist()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "m:1:1: expected 'type octile', got ''"),
        (MAP.replace("octile", "hex"), "m:1:1: expected 'type octile', got 'type hex'"),
        (MAP.replace("2", "two"), "m:2:1: expected 'height' and a number, got 'height two'"),
        (MAP.replace("2", "-2"), "m:2:1: expected 'height' and a number, got 'height -2'"),
        (MAP.replace("2", "٢"), "m:2:1: expected 'height' and a number, got 'height ٢'"),
        (MAP.replace("3", "0"), "m:3:7: expected 'width' and a number, 1 or more"),
        (MAP.replace("map\n", "", 1), "m:4:1: expected 'map', got '.@.'"),
        (MAP.replace("@", "x"), "m:5:2: expected one of .GSE@OTW, got 'x'"),
        (MAP.replace("@", "\r"), "m:5:2: expected one of .GSE@OTW, got '\\r'"),
        (MAP.replace("...", ".."), "m:6:3: expected a row of 3 cells, got 2"),
        (MAP.replace("...", "...."), "m:6:4: expected a row of 3 cells, got 4"),
        (MAP.replace("2", "3"), "m:7: expected 3 rows, got 2"),
        (MAP[:-8], "m:5: expected 2 rows, got 0"),
        (MAP.replace("2", "1"), "m:6:1: expected the end of the file after 1 rows"),
        (MAP.replace("2", "1000000000"), "m:2: expected at most 16000000 cells, got 1000000000 x 3"),
        (MAP.replace("2", "9" * 5000), "m:2:1: expected 'height' and a number, got 'height 99999...9999999999999'"),
    ],
)
def test_malformed_maps(text, message):
    assert message_of(parse_map, text, "m") == message


@given(hnp.arrays(np.bool_, hnp.array_shapes(min_dims=2, max_dims=2)), st.sampled_from("@OTW"))
def test_map_round_trip(free, blocked):
    assert parse_map(format_map(Grid(free), blocked), "m").free.tolist() == free.tolist()


@pytest.mark.parametrize("blocked", [".", "", "@T", "#"])
def test_obstacles_are_written_as_one_of_their_characters(blocked):
    with pytest.raises(ValueError, match="expected one of @, O, T, W"):
        format_map(GRID, blocked)


# Scenarios.


def test_scenario():
    scenario = parse_scenario(SCENARIO, "s", GRID)
    assert scenario.starts.tolist() == [[1, 0]]
    assert scenario.goals.tolist() == [[0, 2]]


@pytest.mark.parametrize(
    "text",
    [
        SCENARIO.replace("\n", "\r\n"),
        SCENARIO.rstrip("\n"),
        SCENARIO + "\n\n",
        SCENARIO.replace("version 1", "version 1.0"),
        SCENARIO.replace("version 1\n", ""),
        SCENARIO.replace("tiny.map", "folder/other map"),
        SCENARIO.replace("3.00000000", "3"),
    ],
    ids=["CRLF", "no final newline", "blank lines", "version 1.0", "no version", "another name", "distance"],
)
def test_tolerated_scenarios(text):
    assert parse_scenario(text, "s", GRID).starts.tolist() == [[1, 0]]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("version 1", "version 2", "s:1:1: expected 'version 1', got 'version 2'"),
        ("\t3\t2\t", "\t", "s:2:30: expected 9 columns separated by tabs, got 7"),
        ("00\n", "00\t\n7", "s:2:35: expected 9 columns separated by tabs, got 10"),
        ("\t0\t1", "\tzero\t1", "s:2:16: expected the start x, got 'zero'"),
        ("\t0\t1", "\t-1\t1", "s:2:16: expected the start x, got '-1'"),
        ("3.0", "three", "s:2:24: expected the distance, got 'three0000000'"),
        ("00\n", "00\n\n0\n", "s:3:1: expected 9 columns separated by tabs, got 1"),
        (SCENARIO, "version 1\n", "s:2: expected a line for each agent, got none"),
        (SCENARIO, "", "s:1: expected a line for each agent, got none"),
        ("3\t2", "2\t3", "s:2:12: expected the size of map 'tiny', width 3 and height 2, got 2 and 3"),
        ("\t0\t1\t", "\t0\t2\t", "s:2:16: expected the start to be a free cell of the map, got x=0, y=2"),
        ("\t0\t1\t", "\t1\t0\t", "s:2:16: expected the start to be a free cell of the map, got x=1, y=0"),
        ("\t2\t0\t3", "\t3\t0\t3", "s:2:20: expected the goal to be a free cell of the map, got x=3, y=0"),
    ],
)
def test_malformed_scenarios(old, new, message):
    assert old in SCENARIO
    assert message_of(parse_scenario, SCENARIO.replace(old, new, 1), "s", GRID) == message


def test_a_later_line_is_named():
    good = SCENARIO.split("\n")[1]
    wrong = good.replace("\t0\t1\t", "\t1\t0\t")
    assert message_of(parse_scenario, f"version 1\n{good}\n{wrong}\n", "s", GRID).startswith("s:3:16: ")
    assert message_of(parse_scenario, f"{good}\n{wrong}\n", "s", GRID).startswith("s:2:16: ")


def test_without_a_map_cells_are_checked_against_the_size_in_the_file():
    assert len(parse_scenario(SCENARIO.replace("\t0\t1\t", "\t1\t0\t"), "s")) == 1
    assert "s:2:16" in message_of(parse_scenario, SCENARIO.replace("\t0\t1\t", "\t0\t2\t"), "s")


@given(hnp.arrays(np.bool_, (6, 7)), st.integers(0, 2**32), st.integers(1, 5))
def test_scenario_round_trip(free, seed, num_agents):
    free[0, :5] = True
    grid = Grid(free)
    scenario = place(grid, num_agents, np.random.default_rng(seed))
    text = format_scenario(scenario, grid)
    again = parse_scenario(text, "s", grid)
    assert again.starts.tolist() == scenario.starts.tolist()
    assert again.goals.tolist() == scenario.goals.tolist()
    assert format_scenario(again, grid) == text


@pytest.mark.parametrize(
    ("grid", "starts", "goals", "message"),
    [
        (GRID, [[1, 0]], [[[0, 2], [0, 0]]], "several"),
        (GRID, [[0, 0], [0, 1]], [[0, 2], [0, 2]], "agent 1: expected the start to be a free cell"),
        (GRID, [[0, 0]], [[-1, 2]], "agent 0: expected the goal to be a free cell"),
        (Grid([[True, False, True]]), [[0, 0]], [[0, 2]], "agent 0: no path leads from its start to its goal"),
        (Grid([[True]], "a\tb"), [[0, 0]], [[0, 0]], "tabs"),
    ],
)
def test_unwritable_plans_are_refused(grid, starts, goals, message):
    with pytest.raises(ValueError, match=message):
        format_scenario(Scenario(starts, goals), grid)


def test_octile_distance_cuts_no_corner():
    diagonal = 1.414213562
    grid = parse_map("type octile\nheight 3\nwidth 3\nmap\n.@.\n...\n...\n", "m")
    starts, goals = [[0, 0], [0, 0], [0, 0], [2, 2]], [[0, 2], [2, 2], [0, 0], [1, 0]]
    expected = [4, 2 + diagonal, 0, 1 + diagonal]
    distances = octile_distances(grid.free, np.array(starts), np.array(goals))
    assert distances.tolist() == pytest.approx(expected)


# Untrusted files.


def test_files_round_trip(tmp_path):
    write_map(GRID, tmp_path / "tiny.map")
    assert (tmp_path / "tiny.map").read_bytes() == MAP.encode()
    assert read_map(tmp_path / "tiny.map").name == "tiny"
    write_scenario(parse_scenario(SCENARIO, "s"), GRID, tmp_path / "tiny.scen")
    assert (tmp_path / "tiny.scen").read_bytes() == SCENARIO.encode()
    assert len(read_scenario(str(tmp_path / "tiny.scen"), GRID)) == 1


def test_byte_order_mark(tmp_path):
    (tmp_path / "bom.map").write_bytes(b"\xef\xbb\xbf" + MAP.encode())
    assert read_map(tmp_path / "bom.map").shape == (2, 3)


def test_files_that_are_not_text_are_refused_in_one_line(tmp_path, monkeypatch):
    file = tmp_path / "strange.map"
    with pytest.raises(FileNotFoundError, match=r"strange\.map: no such file$"):
        read_map(file)
    assert message_of(read_map, tmp_path).endswith("expected a file, got a folder or device")
    assert message_of(read_map, "/dev/zero").endswith("expected a file, got a folder or device")
    file.write_bytes(b"type octile\nheight \xff\n")
    assert message_of(read_map, file) == f"{file}:2:8: expected UTF-8 text, got the byte 0xff"
    monkeypatch.setattr("mapf_pz._internal.text.MAX_FILE_BYTES", 10)
    assert message_of(read_scenario, file) == f"{file}: expected at most 10 bytes"


SEPARATORS = "\n\r\t09.@"


@given(st.text() | near_misses(MAP, SEPARATORS))
def test_any_text_is_a_map_or_a_format_error(text):
    try:
        parse_map(text, "m")
    except FormatError as error:
        assert "\n" not in str(error)  # noqa: PT017 (most texts, not all, are refused)


@given(st.text() | near_misses(SCENARIO, SEPARATORS), st.sampled_from([None, GRID]))
def test_any_text_is_a_scenario_or_a_format_error(text, grid):
    try:
        parse_scenario(text, "s", grid)
    except FormatError as error:
        assert "\n" not in str(error)  # noqa: PT017


@given(st.binary())
def test_any_bytes_are_refused(tmp_path_factory, data):
    file = tmp_path_factory.getbasetemp() / "fuzz"
    file.write_bytes(data)
    message_of(read_map, file)
    message_of(read_scenario, file)


# The benchmark's files.


def test_all_benchmark_files_load(benchmark):
    maps = {file.stem: read_map(file) for file in (benchmark / "maps").glob("*.map")}
    assert len(maps) == 27
    for name, (shape, passable) in SIZES.items():
        assert (maps[name].shape, maps[name].free.sum()) == (shape, passable)
    for file in benchmark.glob("lorr/**/warehouse_*.map"):
        assert load_map(file).free.sum() == sum(map(file.read_text().partition("map\n")[2].count, ".ES"))
    scenarios = list((benchmark / "scens").glob("*.scen"))
    assert len(scenarios) == 405
    for file in scenarios:
        scenario = read_scenario(file, maps[file.stem.rsplit("-", 2)[0]])
        assert len(scenario) == file.read_bytes().count(b"\n") - 1


def test_benchmark_scenarios_are_written_byte_for_byte(benchmark):
    for name in ("Berlin_1_256", "den312d", "maze-128-128-2", "random-32-32-10", "warehouse-10-20-10-2-2"):
        grid = read_map(benchmark / "maps" / f"{name}.map")
        for file in (benchmark / "scens" / f"{name}-random-1.scen", benchmark / "scens" / f"{name}-even-1.scen"):
            assert format_scenario(read_scenario(file, grid), grid).encode() == file.read_bytes()


@pytest.mark.parametrize(
    ("name", "blocked"),
    [("Paris_1_256", "@"), ("maze-32-32-4", "@"), ("room-64-64-16", "@"), ("warehouse-20-40-10-2-2", "T")],
)
def test_benchmark_maps_are_written_byte_for_byte(name, blocked):
    file = map_path(name)
    assert format_map(read_map(file), blocked).encode() == file.read_bytes()


def test_other_copies_of_the_benchmark_are_the_same(benchmark):
    paris = read_map(benchmark / "maps" / "Paris_1_256.map").free
    berlin = read_map(benchmark / "maps" / "Berlin_1_256.map").free
    assert np.array_equal(read_map(benchmark / "variants" / "Paris_1_256.crlf.map").free, paris)
    assert np.array_equal(read_map(benchmark / "variants" / "Berlin_1_256.crlf.map").free, berlin)
    double = benchmark / "lorr" / "archive-2023-example" / "city.domain" / "maps" / "Paris_1_256.map"
    assert np.array_equal(read_map(double).free, paris)
    first = read_scenario(benchmark / "scens" / "random-32-32-20-random-1.scen")
    again = read_scenario(benchmark / "variants" / "random-32-32-20-random-1.crlf.scen")
    assert np.array_equal(first.starts, again.starts)
    assert np.array_equal(first.goals, again.goals)
