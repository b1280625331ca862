"""Whatever the bytes in a file: it is read, or refused in one line, soon, and without much memory."""

import io
import os
import pickle
import re
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapf_pz.evaluation import load_suite
from mapf_pz.evaluation.identity import Identities
from mapf_pz.evaluation.results import COLUMNS, Results
from mapf_pz.guidance import load_guidance, load_moves
from mapf_pz.instances import convert_pogema, load_instance, load_map, load_pogema, load_problem, load_scenario
from mapf_pz.instances.instance import Grid, Scenario
from mapf_pz.planners.plans.files import Selection, read_plan
from tests.helpers.corrupt_files import Case, as_json, bounded, changed, fuzzed, outcome, refused
from tests.planners.plans.test_plan_files import TEXT

GRID = Grid([[True] * 6, [True] * 3 + [False] * 3], "tiny")
SCENARIO = Scenario([[0, 0], [1, 0]], [[0, 5], [1, 2]])
IDENTITIES = {
    "policies": {"pibt": {"version": "0.1.0", "options": {"depth": 3}}, "mine": None},
    "tasks": {"a": {"seed": 1}},
}
# Valid files, a reader of each kind, and what may be changed.

MAP = b"type octile\nheight 2\nwidth 6\nmap\n......\n...@@@\n"
SCEN = b"version 1\n1\ttiny.map\t6\t2\t0\t0\t5\t0\t5.00000000\n0\ttiny.map\t6\t2\t0\t1\t2\t1\t2.00000000\n"
PROBLEM = {"mapFile": "tiny.map", "agentFile": "a.agents", "taskFile": "a.tasks", "teamSize": 2, "version": "2024 LoRR"}
LORR = {
    "tiny.map": MAP,
    "a.json": as_json(PROBLEM | {"taskAssignmentStrategy": "roundrobin"}),
    "a.agents": b"3\n0\n2\n6\n",
    "a.tasks": b"# version for LoRR 2024\n3\n0,1\n2,3,0\n1,3\n",
}
ENTRY = {"map_name": "m", "seed": 0, "agents_xy": [[0, 0], [1, 0]], "targets_xy": [[0, 2], [1, 2]]}
LIFELONG = ENTRY | {"targets_xy": [[[0, 2], [0, 1], [0, 0]], [[1, 2], [1, 1]]]}
CONFIG = b"environment: {on_target: nothing, seed: {grid_search: [0, 1]}, num_agents: 2, map_name: &n m}\n"
YAML = {"maps.yaml": b"m: |-\n  ..$!\n  .#..\n", "set.yaml": CONFIG}
POGEMA = {"set.maps.json": as_json({"m": ["..@", "$!."]}), "set.mapf.json": as_json([ENTRY, LIFELONG])}
PLAN = {
    "actionModel": "MAPF_T",
    "teamSize": 2,
    "start": [[0, 0, "E"], [1, 2, "N"]],
    "numTaskFinished": 2,
    "sumOfCost": 6,
    "makespan": 3,
    "actualPaths": ["F,F,W", "F,C,W"],
    "events": [[[0, 0, "assigned"], [0, 2, "finished"]], [[1, 0, "assigned"]]],
    "tasks": [[0, 0, 2], [1, 0, 0]],
}
PLAN_2024 = PLAN | {
    "version": "2024",
    "actualSchedule": ["1:0,3:-1", "1:1"],
    "tasks": [[0, 0, [0, 1, 0, 2]], [1, 0, 0]],
}
PLAN_2026 = PLAN | {
    "agentMaxCounter": 10,
    "actualPaths": ["[(0,0,0,0,0):(F 10,W 5)][(15,1,0,0,0):(C 15)]", "[(0,0,0,0,0):(W 30)]"],
}
CARDINAL = PLAN | {"actionModel": "MAPF", "start": [[0, 0, "N/A"], [1, 2, "N/A"]], "actualPaths": ["R,R,W", "U,L,W"]}
TRACKER = b"""map_name,scen_type,type_id,agents,lower_cost,solution_cost,solution_plan
tiny,random,1,2,3,3,"rr
d"
tiny,even,"1",1,1,1,r
"""
TURNING = b"solution=\n0:(0,0,X_PLUS),(3,2,Y_MINUS)\n1:(1,0,X_PLUS),(3,1,Y_MINUS)\n"
SUITE = {
    "description": "Mine.",
    "tasks": [
        {"map": "tiny.map", "num_agents": [1, 2], "max_steps": 20, "seed": 7, "episodes": 5, "name": "a"},
        {"map": "tiny.map", "scenarios": ["tiny.scen"], "num_agents": 2, "env": {"action_model": "cardinal"}},
        {"random": [5, 7, 0.1], "num_agents": 2, "best": 1.5, "env": {"view_size": [3, 3], "channels": ["view"]}},
        {"pogema": "set.mapf.json", "num_agents": 2, "name": "set", "env": {"initial_heading": [0, 1]}},
        {"lorr": "a.json", "max_steps": 6, "name": "lorr"},
    ],
}
EPISODES = (
    f'{",".join(COLUMNS)}\na,"b,c",1,0,x,7,s/1,1,0.5,1,1.5,inf,2.5,0.25,1.25,4,,,,6,0.25,2,1,0.5,a note\n'
    "üä,b,2,1,,8,,,,,,,,0.5,,,0.5,0,0.75,6,0,1e-3,7,0.25,\n"
).encode()
GGO = {"layout": ["......", "...@@@"], "optimize_wait": False, "weights": [1, *[0.5] * 17, -1, *[2.5e1] * 2]}
GGO_CSV = b"""id,type,x,y,weight_to_RIGHT,weight_to_UP,weight_to_LEFT,weight_to_DOWN,weight_for_WAIT
0,.,0,0,1.5,inf,inf,inf,2
1,w,0,1,inf,inf,3e0,inf,1
2,@,0,2,inf,inf,inf,inf,inf
"""


def guidance(name, content):
    return Case({name: content}, lambda folder: load_guidance(folder / name, GRID if name == "a.w" else None))


def archive(**arrays):
    """Return an archive that is not compressed, so that its arrays are changed, too."""
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def episodes(folder):
    """Read the episodes; what is taken off a file must not change what is in it."""
    read = Results(folder).episodes
    assert repr(Results(folder).episodes) == repr(read)
    return read


def plan(file):
    return Case({"p": file}, lambda folder: read_plan(folder / "p", Selection(SCENARIO, 2)))


CASES = {
    "map": Case({"a.map": MAP}, lambda folder: load_map(folder / "a.map")),
    "scenario": Case({"a.scen": SCEN}, lambda folder: load_scenario(folder / "a.scen")),
    "map and scenario": Case({"m.map": MAP, "a.scen": SCEN}, lambda at: load_instance(at / "m.map", at / "a.scen")),
    "drawing": Case(
        {"a": MAP.partition(b"map\n")[2]}, lambda folder: load_map((folder / "a").read_text("utf-8", "replace") + "\n")
    ),
    "problem": Case(LORR, lambda folder: load_problem(folder / "a.json").instance(3)),
    "pogema": Case(POGEMA, lambda folder: load_pogema(folder / "set.mapf.json", 2)),
    "pogema in YAML": Case(YAML, lambda folder: convert_pogema(folder / "set.yaml", folder / "maps.yaml", folder)),
    "plan of 2023": plan(as_json(PLAN)),
    "plan of 2024": plan(as_json(PLAN_2024)),
    "plan of 2026": plan(as_json(PLAN_2026)),
    "plan without headings": plan(as_json(CARDINAL)),
    "tracker plan": plan(TRACKER),
    "text plan": plan(TEXT.encode()),
    "text plan with headings": plan(TURNING),
    "suite": Case(
        LORR | POGEMA | {"tiny.scen": SCEN, "mine.json": as_json(SUITE)},
        lambda folder: load_suite(folder / "mine.json"),
        ("mine.json",),
    ),
    "episodes": Case({"episodes.csv": EPISODES}, episodes),
    "identities": Case({"identities.json": as_json(IDENTITIES)}, Identities.read),
    "guidance graph in JSON": guidance("a.json", as_json(GGO)),
    "guidance graph in CSV": guidance("a.csv", GGO_CSV),
    "guidance graph of WPPL": guidance("a.w", as_json([1.5, 2, 3, 100000, 1] * 12)),
    "guidance graph in an archive": guidance(
        "a.npz", archive(move=np.full((4, 2, 6), 2.0), wait=np.ones((2, 6)), map="tiny", digest="0")
    ),
    "moves": Case({"a": archive(moves=np.ones((4, 2, 6)))}, lambda folder: load_moves(folder / "a", GRID).any()),
}


@pytest.fixture(autouse=True)
def no_benchmark(monkeypatch):
    monkeypatch.delenv("MAPF_PZ_BENCHMARK", raising=False)


@pytest.mark.parametrize("case", CASES.values(), ids=list(CASES))
def test_the_files_are_valid(case, tmp_path):
    assert case.written(tmp_path)()


@pytest.mark.parametrize("case", CASES.values(), ids=list(CASES))
@pytest.mark.filterwarnings("ignore:.* not modeled:UserWarning")  # members that no problem has
@fuzzed
@given(st.data())
def test_a_changed_file_is_read_or_refused_in_one_line(case, data):
    name = data.draw(st.sampled_from(case.changed or sorted(case.files)))
    content = data.draw(changed(case.files[name]))
    with TemporaryDirectory() as folder:
        outcome(case.written(Path(folder), {name: content}))


# Files that claim much, or are large.


def test_a_map_that_claims_a_thousand_million_rows(tmp_path):
    for old, new in [(b"height 2", b"height 1000000000"), (b"width 6", b"width 999999999"), (b"2", b"9" * 10_000)]:
        (tmp_path / "a.map").write_bytes(MAP.replace(old, new))
        with bounded():
            refused(lambda: load_map(tmp_path / "a.map"), r"a\.map:\d")


@pytest.mark.parametrize("width", [6, 1_000_000])
def test_a_map_with_a_line_of_a_million_characters(tmp_path, width):
    (tmp_path / "a.map").write_bytes(b"type octile\nheight 1\nwidth %d\nmap\n%s\n" % (width, b"." * 1_000_000))
    with bounded():
        grid = outcome(lambda: load_map(tmp_path / "a.map"))
    assert (grid is None) == (width == 6)


@pytest.mark.slow
def test_a_scenario_of_a_million_lines(tmp_path):
    version, line, _ = SCEN.splitlines(keepends=True)
    (tmp_path / "a.scen").write_bytes(version + line * 50_000)
    with bounded(megabytes=100):
        assert len(load_scenario(tmp_path / "a.scen")) == 50_000
    (tmp_path / "a.scen").write_bytes(version + line * 1_000_000)
    assert len(load_scenario(tmp_path / "a.scen")) == 1_000_000
    os.truncate(tmp_path / "a.scen", 2**40)
    with bounded():
        refused(lambda: load_scenario(tmp_path / "a.scen"), "expected at most 67108864 bytes")


BOMBS = [b"[" * 100_000, b'{"a":' * 100_000, b"[" * 100_000 + b"]" * 100_000, b"9" * 10_000, b"1e999", b"[" * 5_000_000]
JSON_READERS = {
    "a.json": load_problem,
    "set.mapf.json": lambda file: load_pogema(file, 1),
    "set.maps.json": lambda file: load_pogema(file.with_name("set.mapf.json"), 1),
    "plan.json": read_plan,
    "mine.json": load_suite,
    "guidance.json": load_guidance,
    "guidance.w": lambda file: load_guidance(file, GRID),
    "maps.yaml": lambda file: convert_pogema(file.with_name("set.yaml"), file, file.parent),
}


@pytest.mark.parametrize("name", JSON_READERS)
@pytest.mark.parametrize("bomb", BOMBS, ids=lambda bomb: f"{bomb[:5].decode()} of {len(bomb)}")
def test_json_bombs(tmp_path, name, bomb):
    Case(LORR | POGEMA | YAML, load_problem).written(tmp_path)
    for content in (bomb, b'{"teamSize": %s}' % bomb, b'{"tasks": [{"num_agents": %s}]}' % bomb):
        (tmp_path / name).write_bytes(content)
        with bounded():
            refused(lambda: JSON_READERS[name](tmp_path / name), re.escape(name))


@pytest.mark.parametrize("grid", [GRID, None])
def test_arrays_that_are_larger_than_the_map(tmp_path, grid):
    weights = np.ones((5, 3000, 3000), np.float32)
    with np.errstate(all="ignore"):
        np.savez_compressed(tmp_path / "a.npz", move=weights[:4], wait=weights[0], map="tiny", digest="0")
        np.savez_compressed(tmp_path / "moves.npz", moves=weights[:4])
    with bounded(megabytes=1):
        refused(lambda: load_guidance(tmp_path / "a.npz", grid), "expected arrays of at most")
        refused(lambda: load_moves(tmp_path / "moves.npz", GRID), "expected arrays of at most")


@pytest.mark.parametrize("name", ["a.json", "a.w"])
def test_weights_beyond_all_numbers(tmp_path, name):
    content = as_json(GGO | {"weights": GGO["weights"][:-1] + [-(10**400)]} if name == "a.json" else [10**400] * 60)
    (tmp_path / name).write_bytes(content)
    refused(lambda: load_guidance(tmp_path / name, GRID), "expected a number as weight")


def test_a_suite_of_too_many_tasks(tmp_path):
    entry = {"map": "den312d", "num_agents": 1}
    for tasks in ([entry] * 1001, [entry | {"num_agents": [1] * 1001}], [entry | {"num_agents": [1] * 501}] * 2):
        (tmp_path / "mine.json").write_bytes(as_json({"tasks": tasks}))
        refused(lambda: load_suite(tmp_path / "mine.json"), "expected at most 1000 tasks, got 100[12]")


@pytest.mark.parametrize("member", ["reward", "view_size", "initial_heading", "channels", "edge_weights"])
def test_every_depth_of_nesting(tmp_path, member):
    for depth in [1, 40, 70, *range(700, 1000, 5)]:
        entry = f'{{"random": [5, 5, 0.1], "num_agents": 2, "env": {{"{member}": {"[" * depth + "]" * depth}}}}}'
        (tmp_path / "mine.json").write_text(f'{{"tasks": [{entry}]}}')
        outcome(lambda: load_suite(tmp_path / "mine.json"))


# Files that name others.

INDIRECT = ["../tiny.map", "../../etc/passwd.map", "in/../../tiny.map", "link/tiny.map"]
OUTSIDE = [*INDIRECT, "{outside}/tiny.map", "/etc/a.map"]
NAMES = [*OUTSIDE, "x" * 300 + ".map", "x" * 5000 + ".map", "a\nb.map", "a\0.map", "\ud800.map", "\u2028.map"]


@pytest.fixture
def folders(tmp_path):
    """A folder of files, in one with a map that no file in the first may name."""
    outside, folder = tmp_path / "out", tmp_path / "out" / "in"
    folder.mkdir(parents=True)
    (outside / "tiny.map").write_bytes(MAP)
    (folder / "link").symlink_to(outside)
    return outside, folder


@pytest.mark.parametrize("name", NAMES, ids=lambda name: ascii(name)[1:20])
@pytest.mark.parametrize("with_benchmark", [False, True])
def test_no_path_in_a_suite_leaves_its_folder(folders, monkeypatch, name, with_benchmark):
    outside, folder = folders
    if with_benchmark:
        monkeypatch.setenv("MAPF_PZ_BENCHMARK", str(folder))
    told = name.replace("{outside}", str(outside))
    suffixes = {"map": ".map", "pogema": ".mapf.json", "lorr": ".json", "scenarios": ".scen", "edge_weights": ".csv"}
    for member, suffix in suffixes.items():
        file = told.replace(".map", suffix)
        of_map = {"scenarios": {member: [file]}, "edge_weights": {"env": {member: file}}}
        entry = {"map": "empty-8-8"} | of_map[member] if member in of_map else {member: file}
        content = as_json({"tasks": [entry | ({} if member == "lorr" else {"num_agents": 1})]})
        read = Case({"mine.json": content}, lambda folder: load_suite(folder / "mine.json")).written(folder)
        refused(read, "in the folder of the JSON" if name in OUTSIDE else None)


@pytest.mark.parametrize("name", NAMES, ids=lambda name: ascii(name)[1:20])
@pytest.mark.parametrize("member", ["mapFile", "agentFile", "taskFile"])
def test_no_path_in_a_problem_leaves_its_folder(folders, name, member):
    outside, folder = folders
    told = {member: name.replace("{outside}", str(outside))}
    case = Case(LORR | {"a.json": as_json(PROBLEM | told)}, lambda folder: load_problem(folder / "a.json"))
    refused(case.written(folder), "in the folder of the JSON" if name in OUTSIDE else None)


def test_folders_below_and_benchmark_folders_are_inside(folders, tmp_path, monkeypatch):
    _, folder = folders
    (folder / "maps").mkdir()
    (folder / "maps" / "tiny.map").write_bytes(MAP)
    (tmp_path / "mine.json").write_bytes(as_json({"tasks": [{"map": "maps/tiny.map", "num_agents": 1}]}))
    refused(lambda: load_suite(tmp_path / "mine.json"), "no file 'maps/tiny.map'")
    monkeypatch.setenv("MAPF_PZ_BENCHMARK", str(folder))
    assert load_suite(tmp_path / "mine.json")[0].name == "tiny"
    (folder / "mine.json").write_bytes((tmp_path / "mine.json").read_bytes())
    monkeypatch.delenv("MAPF_PZ_BENCHMARK")
    assert load_suite(folder / "mine.json")[0].name == "tiny"


# What the changes above come upon too seldom.


def test_names_of_several_lines_in_a_tracker_file(tmp_path):
    (tmp_path / "p").write_bytes(TRACKER.replace(b"tiny", b'"two\nlines\xe2\x80\xa8"'))
    refused(lambda: read_plan(tmp_path / "p", Selection(SCENARIO)), "got 2: the file has plans for two lines")


def test_pickles_are_read_by_no_reader(tmp_path):
    class Evil:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "unpickled"),)

    content = pickle.dumps(Evil())
    for case in CASES.values():
        for name in case.changed or case.files:
            outcome(case.written(tmp_path, {name: content}))
    assert not (tmp_path / "unpickled").exists()
