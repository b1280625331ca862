"""Plan files on the editor's page, which plays and checks them, operated in a browser as by its user."""

import json

import numpy as np
import pytest

from mapf_pz.editor import save_editor
from mapf_pz.instances import write_map, write_scenario
from mapf_pz.instances.instance import Grid, Instance, Scenario
from mapf_pz.planners import Plan, violations
from mapf_pz.planners.plans.files import read_plan, write_plan

FREE = np.array([[1, 1, 1, 1], [1, 0, 1, 1], [1, 1, 1, 1]], bool)
GRID = Grid(FREE, "small")
STARTS, GOALS = np.array([[0, 0], [0, 3]]), np.array([[0, 2], [2, 3]])
INSTANCE = Instance(GRID, Scenario(STARTS, GOALS))
CARDINAL = Plan([[[0, 0], [0, 3]], [[0, 1], [1, 3]], [[0, 2], [2, 3]]])
ROTATING = Plan(
    [[[0, 0], [0, 3]], [[0, 1], [0, 3]], [[0, 2], [1, 3]], [[0, 2], [2, 3]]], [[0, 2], [0, 1], [0, 1], [0, 1]]
)


@pytest.fixture
def editor(new_page, tmp_path):
    """Return a function that opens the page and gives it files, by name and text."""
    save_editor(tmp_path / "editor.html")
    write_map(GRID, tmp_path / "small.map")
    write_scenario(INSTANCE.scenario, GRID, tmp_path / "small.scen")
    page = new_page((tmp_path / "editor.html").as_uri())
    page.wait_for_selector("body[data-ready]")

    def give(*names, **texts):
        for name, text in texts.items():
            (tmp_path / name.replace("__", ".")).write_text(text)
        files = (*names, *(name.replace("__", ".") for name in texts))
        page.set_input_files("#open-files", [tmp_path / name for name in files])
        page.wait_for_function("$('open-files').value === ''")
        return page

    return give


def shown(page):
    """Return the positions (T + 1, N, 2) and headings (T + 1, N) of the page's episode."""
    return page.evaluate(
        """() => {
            const [episode] = player.episodes, steps = [...Array(episode.steps + 1).keys()];
            const each = (read) => steps.map((step) => [...Array(episode.agents).keys()].map((k) => read(k, step)));
            const heading = (k, step) => episode.headings[episode.index(k, step)];
            return [each((k, step) => episode.cell(k, step)), episode.headings ? each(heading) : null];
        }"""
    )


@pytest.mark.parametrize(
    ("plan", "extension"),
    [(CARDINAL, "json"), (CARDINAL, "csv"), (CARDINAL, "txt"), (ROTATING, "json"), (ROTATING, "txt")],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_plan_files_are_read(editor, tmp_path, plan, extension):
    file = tmp_path / f"plan.{extension}"
    headings = None if plan.headings is None else plan.headings[0]
    write_plan(plan, file, Instance(GRID, INSTANCE.scenario, headings))
    page = editor("small.map", "small.scen", file.name)
    positions, headings = shown(page)
    assert positions == plan.positions.tolist()
    assert headings == (None if plan.headings is None else plan.headings.tolist())
    assert page.locator("#violations h2").inner_text() == "No violations of the rules"
    assert page.locator("#title").inner_text() == f"plan.{extension}: small, 2 agents"
    metrics = page.locator("#final td").all_inner_texts()
    assert metrics == ["2", str(plan.num_steps), str(plan.sum_of_costs), str(plan.makespan)]
    if extension != "csv":  # the others contain starts and goals
        page = editor("small.map", file.name)
        assert shown(page)[0] == plan.positions.tolist()
        assert page.evaluate("player.episodes[0].goal(1, 0)") == [2, 3]
    page.keyboard.press("End")
    assert page.evaluate("player.state().step") == plan.num_steps


def test_violations_are_those_of_the_validator(editor, tmp_path):
    rng = np.random.default_rng(0)
    grid = Grid(rng.random((6, 6)) > 0.2, "small")
    free = np.argwhere(grid.free)
    starts, goals = rng.permutation(free)[:8], rng.permutation(free)[:8]
    instance = Instance(grid, Scenario(starts, goals))
    write_map(grid, tmp_path / "small.map")
    moves = np.array([(0, 1), (1, 0), (0, -1), (-1, 0), (0, 0), (0, 2)])
    cells = np.concatenate([starts[None], starts + rng.choice(moves, (12, 8)).cumsum(axis=0)]).clip(0, 6)
    lines = "\n".join(
        f"{k}:" + "".join(f"({col},{row})," for row, col in step) for k, step in enumerate(cells.tolist())
    )
    header = "goals=" + "".join(f"({col},{row})," for row, col in goals.tolist())
    page = editor("small.map", bad__txt=f"{header}\nsolution=\n{lines}\n")
    expected = [str(violation) for violation in violations(instance, Plan(cells))]
    assert len(expected) > 20
    assert sorted(page.locator("#violations a").all_inner_texts()) == sorted(expected)
    np.testing.assert_array_equal(read_plan(tmp_path / "bad.txt").plan.positions, cells)
    turned = "0:(0,0,X_PLUS),\n1:(0,0,X_MINUS),\n2:(0,0,Y_MINUS),\n3:(1,0,Y_MINUS),\n4:(1,0,X_PLUS),\n"
    page = editor("small.map", turned__txt=turned)
    plan = read_plan(tmp_path / "turned.txt").plan
    instance = Instance(grid, Scenario(plan.positions[0], plan.positions[:1].swapaxes(0, 1).repeat(2, axis=1)))
    expected = [str(violation) for violation in violations(instance, plan)]
    assert len(expected) >= 2
    assert sorted(page.locator("#violations a").all_inner_texts()) == sorted(expected)


MAP = "type octile\nheight 2\nwidth 2\nmap\n..\n.@\n"
BOTH = ["small.map", "small.scen"]


def lorr(**members):
    """Return the text of a plan file with some members changed."""
    plan = {"actionModel": "MAPF", "teamSize": 1, "start": [[0, 0, "N/A"]], "actualPaths": ["R,W"]}
    return json.dumps(plan | members)


@pytest.mark.parametrize("schedule", [{"events": []}, {"version": "2024 LoRR", "actualSchedule": []}])
def test_a_plan_with_an_empty_schedule_is_shown(editor, schedule):
    page = editor("small.map", a__json=lorr(**schedule, tasks=[]))
    assert page.evaluate("player.episodes[0].steps") == 2


BAD_FILES = [
    ([], {"a.map": MAP.replace("width 2", "width x")}, "a.map:3: expected 'width' and a number, got 'width x'"),
    ([], {"a.map": MAP.replace("@", "?")}, "a.map:6: expected one of .GSE@OTW, got '?'"),
    ([], {"a.map": MAP.replace("@", "")}, "a.map:6: expected a row of 2 cells, got 1"),
    (["small.map"], {"a.scen": "version 1\n0\ta\t4\t3\n"}, "a.scen:2: expected 9 columns separated by tabs, got 4"),
    (["small.map"], {"a.scen": "0\ta\t4\t3\t1\t1\t0\t0\t1\n"}, "a.scen:1: expected the start to be a free cell"),
    (["small.map"], {"a.scen": "0\ta\t9\t3\t1\t1\t0\t0\t1\n"}, "expected the size of map 'small', width 4"),
    (["small.map"], {"a.json": "{"}, "a.json: expected JSON"),
    (["small.map"], {"a.json": "{}"}, "a.json: expected 'actionModel' MAPF or MAPF_T, got nothing"),
    (["small.map"], {"a.json": lorr(actualPaths=["R,X"])}, "expected one of UDLRW as step 2 of agent 0, got 'X'"),
    (["small.map"], {"a.json": lorr(start=[[0, "x"]])}, "a.json: expected the start of agent 0"),
    (["small.map"], {"a.json": lorr(teamSize=2)}, "a.json: expected 'start' to be a list of at least 2"),
    (["small.map"], {"a.csv": "agents,path\n1,r\n"}, "a.csv: expected a scenario to be given"),
    (BOTH, {"a.csv": "agents,path\n1,rq\n"}, "a.csv: expected one of udlrw as step 2 of agent 0, got 'q'"),
    (BOTH, {"a.csv": "agents,path\n1,r\n2,r\n"}, "a.csv: expected one plan, got 2"),
    (BOTH, {"a.txt": "solution=\n0:(0,0),(1,0),(2,0),\n"}, "expected at most 2 agents, as in scenario"),
    (["small.map"], {"a.txt": "solution=\n0:(0,0),\n2:(0,0),\n"}, "a.txt:3: expected '1:' and cells, got '2:"),
    (["small.map"], {"a.txt": "solution=\n0:(0,0),(1\n"}, "a.txt:2: expected a cell (x,y), got '(1'"),
    (["small.map"], {"a.txt": "hello"}, "a.txt:1: expected a plan: "),
]  # fmt: skip
"""The files that are opened before, bad ones, and a part of the message."""


@pytest.mark.slow
def test_messages_for_bad_files(editor):
    for names, files, message in BAD_FILES:
        page = editor(*names, **{name.replace(".", "__"): text for name, text in files.items()})
        assert message in page.locator("#message").inner_text()
        assert not page.locator("#play").is_visible()
        editor("small.map", a__json=lorr())  # it still works
        assert page.locator("#play").is_visible()
        assert page.locator("#playback-message").inner_text() == ""
        page.reload()
        page.wait_for_selector("body[data-ready]")


def test_corrupted_files_never_fail_without_a_message(editor, tmp_path):
    texts = []
    for extension, plan in (("json", ROTATING), ("csv", CARDINAL), ("txt", ROTATING), ("txt", CARDINAL)):
        headings = None if plan.headings is None else plan.headings[0]
        write_plan(plan, tmp_path / f"a.{extension}", Instance(GRID, INSTANCE.scenario, headings))
        texts.append((tmp_path / f"a.{extension}").read_text())
    page = editor("small.map", "small.scen")
    texts += [(tmp_path / name).read_text() for name in ("small.map", "small.scen")]
    rng = np.random.default_rng(0)
    corrupted = []
    for text in texts:
        for _ in range(150):
            start, length = int(rng.integers(len(text))), int(rng.integers(0, 6))
            other = str(rng.choice(["", "null", "-1", "[]", "{}", '"', ",", "(", "\n", "x", "999999999", "\t", "é"]))
            corrupted.append(text[:start] + other + text[start + length :])
    outcomes = page.evaluate(
        """([texts, good]) => texts.map((text) => {
            const map = parseMap(good.map, "small.map"), scenario = parseScenario(good.scen, "small.scen", map);
            try {
                if (text.startsWith("type")) parseMap(text, "a");
                else if (text.startsWith("version")) parseScenario(text, "a", map);
                else planEpisode(map, scenario, parsePlan(text, "a", scenario), "a", ["#000000"]);
                return "read";
            } catch (error) {
                return error instanceof FileError ? "message" : `${error} in ${text}`;
            }
        })""",
        [corrupted, {"map": texts[-2], "scen": texts[-1]}],
    )
    assert {"read", "message"} == set(outcomes)


def test_files_are_dropped(editor, tmp_path):
    page = editor("small.map")
    page.evaluate(
        """(text) => {
            const transfer = new DataTransfer();
            transfer.items.add(new File([text], "small.scen"));
            dispatchEvent(new DragEvent("drop", { dataTransfer: transfer, cancelable: true }));
        }""",
        (tmp_path / "small.scen").read_text(),
    )
    page.wait_for_function("editor.drawing.agents.length")
    assert page.evaluate("editor.drawing.agents.map(({ start }) => start)") == STARTS.tolist()
