"""The editor's page with its server, operated in a browser as by its user."""

import numpy as np
import pytest

from mapf_pz.commands.main import main
from mapf_pz.guidance import GuidanceGraph, load_guidance
from mapf_pz.instances import load_map, read_map, read_scenario
from mapf_pz.planners.plans.files import read_plan
from tests.helpers.drawing_page import stroke
from tests.helpers.editor_server import TOKEN

pytestmark = pytest.mark.usefixtures("forked_solvers")


@pytest.fixture
def files(tmp_path):
    """The folder that the server reads and writes."""
    return tmp_path / "files"


@pytest.fixture
def editor(server, new_page):
    page = new_page(f"http://127.0.0.1:{server.port}/?token={TOKEN}", viewport={"width": 1000, "height": 700})
    page.wait_for_selector("body[data-ready]")
    return page


def draw(page):
    """Draw two rooms with a door, and four agents that go through it, two from each side."""
    page.fill("#rows", "7")
    page.fill("#cols", "9")
    page.click("#new")
    stroke(page, (0, 4), (6, 4))
    page.keyboard.press("e")
    stroke(page, (3, 4))
    page.keyboard.press("a")
    for start, goal in (((1, 1), (5, 7)), ((5, 1), (1, 7)), ((1, 6), (3, 0)), ((6, 8), (0, 0))):
        stroke(page, start, goal)
    page.fill("#name", "door")
    page.keyboard.press("Tab")


def click_and_wait(page, button, text):
    page.click(button)
    page.wait_for_selector(f"#message:has-text('{text}')")


def solve(page, *solvers, played):
    """Solve with one or two solvers, and wait until the episodes play, for the `played`-th time."""
    for field, name in zip(("#solver-a", "#solver-b"), (*solvers, ""), strict=False):
        page.fill(field, name)
    page.click("#solve")
    page.wait_for_selector(f"body[data-played='{played}'], #message:not(:empty), #progress:has-text('failed')")
    assert page.locator("#message").inner_text() == ""


def positions(page, episode=0):
    """Return the positions (T + 1, N, 2) of an episode that is played."""
    return page.evaluate(
        """(k) => {
            const episode = player.episodes[k], agents = [...Array(episode.agents).keys()];
            return [...Array(episode.steps + 1).keys()].map((step) => agents.map((agent) => episode.cell(agent, step)));
        }""",
        episode,
    )


def test_an_instance_is_drawn_saved_and_solved_as_on_the_command_line(editor, files, tmp_path):
    draw(editor)
    click_and_wait(editor, "#save-scenario", "saved: door.map, door.scen")
    grid = read_map(files / "door.map")
    assert (~grid.free).sum() == 6
    assert read_scenario(files / "door.scen", grid).starts.tolist() == [[1, 1], [5, 1], [1, 6], [6, 8]]
    solvers = ("lacam:anytime=False", "pibt", "oneshot+pibt")
    for played, name in enumerate(solvers, 1):
        solve(editor, name, played=played)
        plan = tmp_path / f"{played}.json"
        instance = ["--map", str(files / "door.map"), "--scenario", str(files / "door.scen"), "--num-agents", "4"]
        assert main(["solve", str(plan), "--planner", name, *instance]) == 0
        assert positions(editor) == read_plan(plan).plan.positions.tolist()
        assert editor.locator("#title").inner_text().startswith(name)
        editor.click("#back-to-drawing")


@pytest.mark.slow
def test_two_solvers_side_by_side_and_an_agent_by_hand(editor):
    draw(editor)
    editor.uncheck("#turning")
    solve(editor, "pibt", "oneshot-cardinal+pibt", played=1)
    assert editor.evaluate("player.episodes.map(({ caption }) => caption)") == ["pibt", "oneshot-cardinal+pibt"]
    before = positions(editor, 1)
    editor.select_option("#by-hand-episode", index=1)
    editor.fill("#agent", "0")
    editor.locator("#by-hand-actions button", has_text="up").click()
    editor.wait_for_selector("body[data-played='2']")
    assert editor.evaluate("player.state().step") == 1
    assert editor.evaluate("player.state().chosen") == 0
    assert editor.evaluate("player.episodes[1].steps") == 1
    mine, pibt = positions(editor, 1), positions(editor, 0)
    assert mine[0] == before[0]
    assert mine[1][0] == [0, 1]
    editor.keyboard.press("l")
    editor.wait_for_selector("body[data-played='3']")
    further = positions(editor, 1)
    assert further[:2] == mine
    assert further[2][0] == [0, 2]
    assert positions(editor, 0) == pibt


def test_decisions_are_shown(editor):
    draw(editor)
    solve(editor, "oneshot+pibt", played=1)
    editor.fill("#agent", "2")
    assert "forward" in editor.locator("#decisions").inner_text()
    assert "preferred" in editor.locator("#decisions").inner_text()


def test_lifelong_episodes_have_a_throughput(editor):
    draw(editor)
    editor.check("#lifelong")
    editor.fill("#max-steps", "60")
    editor.locator("#toolbar button", has_text="more goals").click()
    editor.locator("#agent-list button").first.click()
    stroke(editor, (2, 2))
    solve(editor, "pibt", played=1)
    assert editor.locator("#throughput").is_visible()
    assert editor.evaluate("player.episodes[0].steps") == 60


@pytest.mark.slow
def test_delayed_agents_are_drawn(editor):
    draw(editor)
    editor.fill("#delays", "often")
    editor.click("#solve")
    editor.wait_for_selector("#message:has-text('delays')")
    assert "PROBABILITY:SMALLEST-LARGEST" in editor.locator("#message").inner_text()
    editor.fill("#delays", " 1:1-1 ")
    click_and_wait(editor, "#copy-command", "expected no delays")
    editor.fill("#delays", "1:1-1")
    editor.fill("#max-steps", "3")
    solve(editor, "pibt", played=1)
    assert editor.evaluate("[...player.episodes[0].numDelayed]") == [0, 4, 4, 4]


def is_in_sight(page, selector):
    """Return whether an element is within the window and nothing is on top of it."""
    return page.locator(selector).evaluate(
        """(element) => {
        const { left, right, top, bottom } = element.getBoundingClientRect();
        return element.contains(document.elementFromPoint((left + right) / 2, (top + bottom) / 2));
        }"""
    )


def test_what_the_solver_refuses_is_one_line_in_sight(editor):
    draw(editor)
    assert is_in_sight(editor, "#solve")
    editor.fill("#solver-a", "lacan")
    editor.click("#solve")
    editor.wait_for_selector("#message:has-text('lacan')")
    assert "\n" not in editor.locator("#message").inner_text()
    assert editor.locator("#board").is_visible()
    assert is_in_sight(editor, "#message")
    editor.locator("#editor-keys").scroll_into_view_if_needed()
    assert is_in_sight(editor, "#message")  # also from the end of the panel


@pytest.mark.slow
def test_the_failure_of_one_of_two_solvers_is_shown_beside_the_episode(editor):
    draw(editor)
    editor.fill("#max-steps", "6")
    editor.fill("#solver-a", "pibt")
    editor.fill("#solver-b", "lacam:anytime=False")
    editor.click("#solve")
    editor.wait_for_selector("body[data-played='1']")
    assert "lacam:anytime=False found no plan" in editor.locator("#playback-message").inner_text()
    assert is_in_sight(editor, "#playback-message")
    assert "pibt: " not in editor.locator("#playback-message").inner_text()


@pytest.mark.slow
@pytest.mark.parametrize("turning", [True, False])
def test_the_copied_command_finds_the_plan_of_the_page(editor, files, monkeypatch, turning):
    """Also of agents that do not face east, and under the limits of the page."""
    draw(editor)
    for quarters in (1, 2):
        editor.locator("#agent-list button").nth(quarters).click()
        for _ in range(quarters):
            editor.click("#turn-left")
    if not turning:
        editor.uncheck("#turning")
    editor.fill("#solve-seed", "5")
    editor.fill("#max-steps", "90")
    click_and_wait(editor, "#save-scenario", "saved")
    solve(editor, "pibt", played=1)
    command = editor.evaluate("solveCommand(editor.drawing, 'pibt', solveLimits())").split()
    assert ("--initial-heading" in command) == turning
    monkeypatch.chdir(files)
    assert command[0] == "mapf-pz"
    assert main(command[1:]) == 0
    assert read_plan(files / "plan.json").plan.positions.tolist() == positions(editor)


def test_the_command_of_a_lifelong_instance_is_refused(editor):
    draw(editor)
    editor.fill("#random-goals", "2")
    editor.click("#add-agents")
    click_and_wait(editor, "#copy-command", "expected one goal of agent 4, got 2")


def test_a_file_is_replaced_after_a_question(editor, files):
    answers, questions = [False, True], []

    def answer(dialog):
        questions.append(dialog.message)
        if answers.pop(0):
            dialog.accept()
        else:
            dialog.dismiss()

    editor.on("dialog", answer)
    (files / "drawing.map").write_text("before")
    editor.click("#save-map")
    while not questions:
        editor.wait_for_timeout(10)
    assert (files / "drawing.map").read_text() == "before"
    click_and_wait(editor, "#save-map", "saved: drawing.map")
    assert read_map(files / "drawing.map").shape == (16, 16)
    assert len(questions) == 2


def test_what_the_server_offers_by_name(editor, files):
    editor.fill("#open-name", "random-32-32-20")
    editor.fill("#open-scenario", "random-32-32-20-random-1")
    editor.click("#open")
    editor.wait_for_selector("#size:text-matches('^32 . 32$')")
    assert editor.evaluate("[...editor.drawing.free]") == load_map("random-32-32-20").free.ravel().astype(int).tolist()
    assert editor.evaluate("editor.drawing.agents.length") > 0
    editor.select_option("#graph", "crisscross")
    editor.click("#use-graph")
    editor.wait_for_selector("#status:has-text('cost east')")
    click_and_wait(editor, "#save-graph", "saved: random-32-32-20.json")
    grid = load_map("random-32-32-20")
    assert np.array_equal(
        load_guidance(files / "random-32-32-20.json", grid).move, GuidanceGraph.crisscross(grid.free).move
    )
    editor.select_option("#family", "maze")
    editor.fill("#option-height", "11")
    editor.fill("#option-width", "13")
    editor.click("#generate")
    editor.wait_for_selector("#size:text-matches('^11 . 13$')")
    editor.fill("#open-name", "warehouse_small_10")
    editor.fill("#open-scenario", "")
    editor.click("#open")
    editor.wait_for_selector("#agent-count:has-text('10')")
    assert editor.evaluate("editor.lifelong")
