"""What the page offers by name is what the package has."""

import base64
import multiprocessing
from threading import Thread

import numpy as np
import pytest

from mapf_pz.commands.main import main
from mapf_pz.guidance.library import guidance_graph
from mapf_pz.instances import format_scenario, load_map, load_problem, load_scenario, parse_map, read_problem
from mapf_pz.instances.files.movingai import parse_scenario
from tests.instances.problem_files import write_lorr


def test_names(server, tmp_path, monkeypatch):
    for folder in ("maps", "scens"):
        (tmp_path / folder).mkdir()
    (tmp_path / "maps" / "mine.map").write_text("type octile\nheight 1\nwidth 2\nmap\n..\n")
    for name in ("mine-even-3", "notes"):
        (tmp_path / "scens" / f"{name}.scen").write_text("version 1\n0\tmine.map\t2\t1\t0\t0\t1\t0\t1\n")
    monkeypatch.setenv("MAPF_PZ_BENCHMARK", str(tmp_path))
    names = server.call("names")
    assert {"mine", "random-16-16-20", "Paris_1_256"} <= set(names["maps"])
    assert names["scenarios"]["mine"] == ["mine-even-3"]
    assert names["scenarios"]["Paris_1_256"][:2] == ["Paris_1_256-random-1", "Paris_1_256-random-2"]
    assert "warehouse_small_100" in names["problems"]
    assert names["graphs"][:3] == ["uniform", "random", "crisscross"]
    planners = {planner["name"]: planner["options"] for planner in names["planners"]}
    assert planners["lacam"] == {
        "time_limit": 1.0,
        "anytime": True,
        "clock": "wall",
        "execution": "replan",
        "max_lateness": 5,
    }
    assert planners["pibt"]["priority"] == "late"
    models = {policy["name"]: policy["action_model"] for policy in names["policies"]}
    assert (models["mappo"], models["oneshot-cardinal"]) == ("rotate", "cardinal")
    opened = server.call("open", map="mine", scenario="mine-even-3")
    assert opened["name"] == "mine-even-3.scen"
    assert parse_scenario(opened["text"], "a.scen", load_map("mine")) == load_scenario("mine-even-3")


def test_maps_and_scenarios_are_opened(server):
    opened = server.call("open", map="random-32-32-20")
    grid = load_map("random-32-32-20")
    assert (opened["name"], parse_map(opened["text"], opened["name"])) == ("random-32-32-20.map", grid)
    opened = server.call("open", map="random-32-32-20", scenario="random-32-32-20-random-2")
    expected = format_scenario(load_scenario("random-2", grid), grid)
    assert opened == {"name": "random-32-32-20-random-2.scen", "text": expected}


@pytest.mark.parametrize("in_a_file", [False, True])
def test_problems_are_opened(server, tmp_path, in_a_file):
    folder = tmp_path / "files"
    problem = str(write_lorr(folder)) if in_a_file else "random_50"
    opened = server.call("open", problem=problem)
    (tmp_path / "copy").mkdir()
    for name, text in (("name", "text"), ("mapName", "map"), ("agentsName", "agents"), ("tasksName", "tasks")):
        (tmp_path / "copy" / opened[name]).write_text(opened[text])
    copy, original = read_problem(tmp_path / "copy" / opened["name"]), load_problem(problem)
    for name in ("starts", "errands", "offsets"):
        assert np.array_equal(getattr(copy, name), getattr(original, name))
    for name in ("grid", "strategy", "version", "reveal", "name", "not_modeled"):
        assert getattr(copy, name) == getattr(original, name)


@pytest.mark.usefixtures("forked_solvers")
def test_families_generate_the_maps_of_the_command(server, tmp_path):
    families = {family["name"]: family for family in server.call("names")["families"]}
    assert list(families) == ["random", "walls", "maze", "primal2", "room", "warehouse"]
    options = {option["name"]: option for option in families["maze"]["options"]}
    assert list(options) == ["height", "width", "corridor", "loops"]
    assert (options["loops"]["type"], options["loops"]["default"]) == ("float", 0.0)
    ranges = {option["name"]: (option["type"], option["default"]) for option in families["primal2"]["options"][2:]}
    assert list(ranges.values()) == [("float", 0.5), ("int", 6), ("float", 0.8)]
    assert options["corridor"]["help"].startswith("Width in cells of the corridors of a `maze`")
    for number, family in enumerate(families):
        chosen = {"height": 11, "width": 14, families[family]["options"][2]["name"]: (0.2, 0.3, 2, 0.6, 4, 2)[number]}
        generated = server.call("generate", family=family, options=chosen, seed=5)
        words = [word for name, value in chosen.items() for word in (f"--{name.replace('_', '-')}", str(value))]
        target = str(tmp_path / family)
        assert main(["maps", "generate", target, "--maps", family, "--number", "1", "--seed", "5", *words]) == 0
        assert generated["map"] == (tmp_path / family / f"1-{generated['name']}.map").read_text()


@pytest.mark.parametrize(
    ("members", "error"),
    [
        ({"family": "mazes"}, "family 'mazes': did you mean 'maze'?"),
        ({"family": "maze", "options": {"density": 0.1}}, "option 'density': maze has the options height, width, corr"),
        ({"family": "maze", "options": {"maps": 1}}, "option 'maps': maze has the options "),
        ({"family": "maze", "options": {"height": 2.5}}, "height=2.5: expected a whole number from 1 to"),
        ({"family": "maze", "options": {"height": 1}}, "height=1: expected 2 or more for maps='maze'"),
        ({"family": "maze", "options": {"width": 1025}}, "map: expected at most 1024 x 1024 cells, got 1 x 1025"),
        ({"family": "maze", "seed": -1}, "seed: Input should be greater than or equal to 0"),
        ({"family": "random", "options": {"density": 1.5}}, "density=1.5: expected at least 0 and less than 1"),
    ],
)
def test_maps_that_cannot_be_generated(server, members, error):
    status, message = server.refused("generate", **members)
    assert status == 400
    assert message.startswith(error)


LONGEST = {"family": "primal2", "options": {"height": 1024, "width": 1024, "primal2_components": 1}}


@pytest.mark.usefixtures("forked_solvers")
@pytest.mark.parametrize("end", ["cancel", "generate", "close"])
def test_the_generation_of_a_map_is_ended(server, end):
    before, answers = set(multiprocessing.active_children()), []
    thread = Thread(target=lambda: answers.append(server.refused("generate", **LONGEST)))
    thread.start()
    while not (started := set(multiprocessing.active_children()) - before):
        pass
    if end == "cancel":
        assert server.call("cancel") == {}
    elif end == "generate":
        assert server.call("generate", family="random")["name"] == "random-12-12-15"
    else:
        server.runs.close()
    thread.join()
    assert answers == [(409, "map: its generation was stopped")]
    assert not any(process.is_alive() for process in started)


@pytest.mark.usefixtures("forked_solvers")
def test_the_generation_of_a_map_has_a_time_limit(server, monkeypatch):
    monkeypatch.setattr("mapf_pz.editor.run.MAX_GENERATION_SECONDS", 0)
    before = set(multiprocessing.active_children())
    assert server.refused("generate", **LONGEST) == (400, "map: its generation takes longer than 0 seconds")
    for process in set(multiprocessing.active_children()) - before:
        process.join()


def test_graphs(server):
    grid = load_map("random-24-24-20")
    text = server.call("open", map="random-24-24-20")["text"]
    for name in ("uniform", "crisscross", "random", "random-24-24-20-150"):
        weights = np.frombuffer(base64.b64decode(server.call("graph", map=text, name=name)["weights"]), "<f4")
        graph = guidance_graph(name, grid)
        assert np.array_equal(weights.reshape(5, 24, 24), [*graph.move, graph.wait])
    assert server.refused("graph", map=text, name="other")[1].startswith("graph 'other': expected one of uniform, ")
    error = server.refused("graph", map=text, name="warehouse-10-20-10-2-1-400")[1]
    assert "expected weights of map 'map' (24 x 24), got those of a map of 63 x 161" in error
    assert server.refused("graph", map="no map", name="uniform")[1] == (
        "map.map:1:1: expected 'type octile', got 'no map'"
    )


@pytest.mark.parametrize(
    ("members", "error"),
    [
        ({}, "expected path, map, scenario and map, or problem"),
        ({"scenario": "random-1"}, "expected path, map, scenario and map, or problem"),
        ({"map": "empty-8-8", "problem": "random_20"}, "expected path, map, scenario and map, or problem"),
        ({"map": "emty-8-8"}, "map 'emty-8-8': did you mean 'empty-8-8'?"),
        ({"map": "empty-8-8", "scenario": "empty-8-8-random-11"}, "scenario 'empty-8-8-random-11': did you mean"),
        ({"map": "maze-13-13-1", "scenario": "random-1"}, "scenario 'random-1': map 'maze-13-13-1' has none"),
    ],
)
def test_what_cannot_be_opened(server, members, error):
    status, message = server.refused("open", **members)
    assert status == 400
    assert message.startswith(error)


def test_a_name_is_no_path(server, tmp_path):
    (tmp_path / "a.map").write_text("type octile\nheight 1\nwidth 2\nmap\n..\n")
    path = str(tmp_path / "a.map")
    assert server.refused("open", map=path)[0] == 400
    assert server.refused("open", map="empty-8-8", scenario=path)[0] == 400
