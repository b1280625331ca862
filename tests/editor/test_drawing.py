"""The editor's page without a server, operated in a browser as by its user."""

import random

import numpy as np
import pytest

from mapf_pz.editor.page import save_editor
from mapf_pz.guidance import load_guidance
from mapf_pz.instances import (
    load_problem,
    parse_map,
    parse_scenario,
    read_map,
    read_scenario,
    write_map,
    write_scenario,
)
from mapf_pz.instances.files.movingai import format_map, format_scenario
from mapf_pz.instances.instance import Grid, Instance, Scenario
from mapf_pz.planners import Plan
from mapf_pz.planners.plans.files import write_plan
from tests.helpers.drawing_page import stroke

MAP = """type octile
height 4
width 5
map
.....
.@@..
.@...
...@.
"""
GRID = parse_map(MAP, "small.map")
SCENARIO = Scenario([[0, 0], [3, 0], [2, 4]], [[3, 2], [0, 4], [0, 1]])


@pytest.fixture
def editor(new_page, tmp_path):
    """The page with an empty map of 16 x 16 cells."""
    save_editor(tmp_path / "editor.html")
    page = new_page((tmp_path / "editor.html").as_uri(), viewport={"width": 1000, "height": 700})
    page.wait_for_selector("body[data-ready]")
    return page


def drawing(page):
    """Return what is drawn."""
    return page.evaluate(
        """() => {
            const { drawing } = editor, rows = mapText(drawing).split("\\n").slice(4, -1);
            const weights = drawing.weights && [...drawing.weights].map(String);
            return { name: drawing.name, rows, agents: drawing.agents, weights, turning: drawing.turning };
        }"""
    )


def use(page, tool):
    page.locator("#toolbar button", has_text=tool).first.click()


def obstacles(page):
    """Return the obstacles' cells."""
    rows = drawing(page)["rows"]
    return {(r, c) for r, row in enumerate(rows) for c, letter in enumerate(row) if letter == "@"}


def give(page, *files):
    page.set_input_files("#open-files", list(files))
    page.wait_for_function("$('open-files').value === ''")


def open_small(page, folder):
    write_map(GRID, folder / "small.map")
    write_scenario(SCENARIO, GRID, folder / "small.scen")
    give(page, folder / "small.map", folder / "small.scen")


def saved(page, button, folder):
    """Click on a button that saves files, and return their paths, by extension."""
    page.evaluate("() => { window.kept = []; saveFile = (name, content) => kept.push([name, content]); }")
    page.click(button)
    page.wait_for_function("kept.length")
    (folder / "saved").mkdir(exist_ok=True)
    files = {}
    for name, text in page.evaluate("kept"):
        path = folder / "saved" / name
        path.write_text(text)
        files[path.suffix] = path
    return files


def faults(page):
    page.wait_for_function("!editor.requested")
    return page.locator("#faults li").all_inner_texts()


def test_obstacles_are_drawn_and_erased(editor):
    stroke(editor, (2, 3), (2, 6))
    assert obstacles(editor) == {(2, 3), (2, 4), (2, 5), (2, 6)}
    stroke(editor, (2, 4), (2, 5), button="right")
    assert obstacles(editor) == {(2, 3), (2, 6)}
    use(editor, "erase")
    stroke(editor, (2, 3))
    assert obstacles(editor) == {(2, 6)}


def test_a_rectangle_and_a_region(editor):
    use(editor, "rectangle")
    stroke(editor, (1, 1), (9, 9), (3, 4))
    assert obstacles(editor) == {(r, c) for r in (1, 2, 3) for c in (1, 2, 3, 4)}
    editor.keyboard.down("Shift")
    stroke(editor, (2, 2), (2, 3))
    editor.keyboard.up("Shift")
    assert len(obstacles(editor)) == 10
    use(editor, "fill")
    stroke(editor, (2, 2))
    assert len(obstacles(editor)) == 12
    stroke(editor, (0, 0))
    assert len(obstacles(editor)) == 256
    stroke(editor, (5, 5))
    assert obstacles(editor) == set()


def test_agents_are_placed_moved_turned_and_deleted(editor):
    use(editor, "agents")
    stroke(editor, (1, 1), (1, 5), (4, 5))
    stroke(editor, (2, 2))
    assert faults(editor) == ["agent 1: no goal"]
    stroke(editor, (7, 7))
    agents = drawing(editor)["agents"]
    assert [(agent["start"], agent["goals"]) for agent in agents] == [([1, 1], [[4, 5]]), ([2, 2], [[7, 7]])]
    assert faults(editor) == []
    use(editor, "select and move")
    stroke(editor, (1, 1), (0, 3))
    stroke(editor, (7, 7), (8, 8))
    editor.keyboard.press(".")
    agents = drawing(editor)["agents"]
    assert agents[0] == {"start": [0, 3], "goals": [[4, 5]], "heading": 0}
    assert agents[1] == {"start": [2, 2], "goals": [[8, 8]], "heading": 1}
    use(editor, "more goals")
    stroke(editor, (9, 9))
    assert drawing(editor)["agents"][1]["goals"] == [[8, 8], [9, 9]]
    stroke(editor, (0, 0), button="right")
    assert drawing(editor)["agents"][1]["goals"] == [[8, 8]]
    editor.keyboard.press("Delete")
    assert [agent["start"] for agent in drawing(editor)["agents"]] == [[0, 3]]


def test_faults_are_marked(editor):
    use(editor, "agents")
    stroke(editor, (0, 0), (0, 5))
    stroke(editor, (0, 0), (5, 5))
    stroke(editor, (9, 9), (0, 5))
    use(editor, "obstacles")
    stroke(editor, (5, 5))
    stroke(editor, (8, 0), (8, 15))
    assert faults(editor) == [
        "agent 1: the same start as agent 0",
        "agent 1: goal on an obstacle",
        "agent 2: the same goal as agent 0",
        "agent 2: unreachable goal",
    ]
    editor.check("#lifelong")
    assert "agent 2: the same goal as agent 0" not in faults(editor)
    editor.locator("#faults li button").last.click()
    assert editor.evaluate("editor.selected") == 2


def test_the_keyboard_draws(editor):
    editor.locator("#board").focus()
    keys = "w ArrowDown ArrowRight Enter ArrowRight ArrowDown Enter a ArrowDown Enter ArrowDown ArrowDown Enter"
    for key in keys.split():
        editor.keyboard.press(key)
    assert obstacles(editor) == {(1, 1), (1, 2), (2, 2)}
    assert drawing(editor)["agents"] == [{"start": [3, 2], "goals": [[5, 2]], "heading": 0}]
    editor.keyboard.press("Control+z")
    assert drawing(editor)["agents"] == []
    editor.keyboard.press("Control+y")
    assert len(drawing(editor)["agents"]) == 1
    editor.keyboard.press("r")
    editor.keyboard.press("Enter")
    editor.keyboard.press("ArrowRight")
    editor.keyboard.press("Escape")
    assert obstacles(editor) == {(1, 1), (1, 2), (2, 2)}


@pytest.mark.slow
def test_undo_after_fifty_random_operations_gives_the_first_state(editor, tmp_path):
    open_small(editor, tmp_path)
    first, rng = drawing(editor), random.Random(3)
    states = [first]
    buttons = [
        "#add-agents",
        "#add-obstacles",
        "#add-top",
        "#cut-left",
        "#add-right",
        "#cut-bottom",
        "#uniform",
        "#turning",
    ]
    tools = ["obstacles", "erase", "rectangle", "fill", "agents", "select and move", "lane", "cost of a region"]
    while editor.evaluate("editor.history.past.length") < 51:
        if rng.random() < 0.3:
            editor.click(rng.choice(buttons))
        else:
            use(editor, rng.choice(tools))
            height, width = editor.evaluate("[editor.drawing.height, editor.drawing.width]")
            stroke(editor, *((rng.randrange(height), rng.randrange(width)) for _ in range(2)))
        if drawing(editor) != states[-1]:
            states.append(drawing(editor))
    while editor.evaluate("editor.history.past.length") > 1:
        editor.keyboard.press("Control+z")
    assert drawing(editor) == first
    while editor.evaluate("editor.history.future.length") > 0:
        editor.keyboard.press("Control+Shift+Z")
    assert drawing(editor) == states[-1]


def test_rows_and_columns_are_added_and_cut(editor, tmp_path):
    open_small(editor, tmp_path)
    use(editor, "lane")
    stroke(editor, (0, 0), (0, 3))
    before = drawing(editor)
    for side in ("top", "right", "bottom", "left"):
        editor.click(f"#add-{side}")
    rows = drawing(editor)["rows"]
    assert rows == [".......", *(f".{row}." for row in MAP.split("\n")[4:8]), "......."]
    assert drawing(editor)["agents"][0] == {"start": [1, 1], "goals": [[4, 3]], "heading": 0}
    for side in ("top", "right", "bottom", "left"):
        editor.click(f"#cut-{side}")
    assert drawing(editor) == before
    editor.click("#cut-bottom")
    assert [agent["start"] for agent in drawing(editor)["agents"]] == [[2, 4]]


def test_maps_and_scenarios_are_saved_as_this_package_writes_them(editor, tmp_path):
    open_small(editor, tmp_path)
    files = saved(editor, "#save-scenario", tmp_path)
    assert files[".map"].read_text() == format_map(Grid(GRID.free, "small"))
    assert files[".scen"].read_text() == format_scenario(SCENARIO, Grid(GRID.free, "small"))
    before = drawing(editor)
    editor.click("#new")
    give(editor, *files.values())
    assert drawing(editor) == before


def test_random_scenarios_are_saved_as_this_package_writes_them(editor, tmp_path):
    editor.fill("#density", "35")
    editor.click("#add-obstacles")
    editor.fill("#random-count", "40")
    editor.click("#add-agents")
    assert faults(editor) == []
    files = saved(editor, "#save-scenario", tmp_path)
    grid, scenario = read_map(files[".map"]), read_scenario(files[".scen"])
    assert len(scenario) == 40
    assert files[".scen"].read_text() == format_scenario(parse_scenario(files[".scen"].read_text(), "a", grid), grid)


def test_problems_are_saved(editor, tmp_path):
    open_small(editor, tmp_path)
    use(editor, "more goals")
    editor.locator("#agent-list button").nth(1).click()
    stroke(editor, (1, 0))
    before = drawing(editor)
    problem = load_problem(saved(editor, "#save-problem", tmp_path)[".json"])
    assert (problem.grid.free == GRID.free).all()
    assert problem.starts.tolist() == SCENARIO.starts.tolist()
    assert [problem.task(k).tolist() for k in range(3)] == [[[3, 2]], [[0, 4], [1, 0]], [[0, 1]]]
    editor.click("#new")
    give(editor, *(tmp_path / "saved").iterdir())
    assert drawing(editor) == before


def test_guidance_graphs_are_saved(editor, tmp_path):
    open_small(editor, tmp_path)
    editor.fill("#along", "0.3")
    editor.fill("#against", "7")
    editor.keyboard.press("Tab")
    use(editor, "lane")
    stroke(editor, (0, 0), (0, 2))
    use(editor, "cost of a region")
    stroke(editor, (2, 2), (2, 3))
    before = drawing(editor)
    graph = load_guidance(saved(editor, "#save-graph", tmp_path)[".json"], GRID)
    expected = np.ones((4, 4, 5), np.float32)
    expected[0, 0, :2], expected[2, 0, 1:3], expected[:, 2, 2:4] = 0.3, 7, 0.3
    possible = np.isfinite(graph.move)
    assert np.array_equal(graph.move[possible], expected[possible])
    editor.click("#uniform")
    give(editor, tmp_path / "saved" / "small.json")
    editor.click("#save-graph")
    possible = possible.ravel()
    weights = [np.array(each["weights"], float)[: possible.size] for each in (before, drawing(editor))]
    assert np.array_equal(weights[0][possible], weights[1][possible])


def test_an_image_is_saved(editor, tmp_path):
    open_small(editor, tmp_path)
    text = saved(editor, "#save-svg", tmp_path)[".svg"].read_text()
    assert text.startswith("<svg")
    assert 'viewBox="0 0 120 96"' in text
    assert text.count("<circle") + text.count("<path") > 3


def test_the_copied_code_makes_this_instance(editor, tmp_path):
    open_small(editor, tmp_path)
    editor.locator("#agent-list button").nth(2).click()
    editor.keyboard.press(",")
    code = editor.evaluate("pythonCode(editor.drawing)")
    names = {}
    exec(code, names)
    env = names["env"].unwrapped
    assert env.positions.tolist() == SCENARIO.starts.tolist()
    assert env.headings.tolist() == [0, 0, 3]


def test_wrong_files_change_nothing(editor, tmp_path):
    open_small(editor, tmp_path)
    before = drawing(editor)
    (tmp_path / "bad.map").write_text("type octile\nheight 2\nwidth 2\nmap\n..\n.x\n")
    (tmp_path / "bad.json").write_text('{"layout": ["..", "."]}')
    (tmp_path / "lonely.json").write_text('{"agentFile": "a.agents", "mapFile": "a.map", "teamSize": 1}')
    expected = {
        "bad.map": "bad.map:6: expected one of .GSE@OTW, got 'x'",
        "bad.json": "bad.json: expected 'layout' to be a list of rows of equal length, of ., w, e, @ and T",
        "lonely.json": "lonely.json: expected the file 'mapFile', too: 'a.map'",
    }
    for name, message in expected.items():
        give(editor, tmp_path / name)
        assert editor.locator("#message").inner_text() == message
        assert drawing(editor) == before


def test_a_plan_is_played_and_its_first_conflict_found(editor, tmp_path):
    open_small(editor, tmp_path)
    steps = [[[0, 1], [3, 1], [2, 3]], [[0, 2], [3, 2], [2, 2]], [[0, 2], [2, 2], [2, 2]]]
    positions = np.array([SCENARIO.starts.tolist(), *steps])
    write_plan(Plan(positions), tmp_path / "plan.json", Instance(GRID, SCENARIO))
    give(editor, tmp_path / "plan.json")
    found = editor.locator("#violations li").all_inner_texts()
    assert "step 3: agent 1 and agent 2 at [row 2, col 2]: two agents on one cell" in found
    editor.click("#back-to-drawing")
    assert editor.locator("#board").is_visible()
