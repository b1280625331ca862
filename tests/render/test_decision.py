"""The decision of the selected agent on the page, operated in a browser."""

from dataclasses import replace

import numpy as np
import pytest

from mapf_pz.render import Inspection
from mapf_pz.render.recording import save_html
from tests.helpers.small_recording import RECORDING

# Three agents that turn, in three steps; decisions of the first two are recorded.
PROBABILITIES = np.zeros((3, 2, 4), np.float32)
PROBABILITIES[...] = [0.5, 0.25, 0.125, 0.125]
PROBABILITIES[1, 0] = [0.1, 0.2, 0.3, 0.4]
ALLOWED = np.ones((3, 2, 4), np.bool_)
ALLOWED[1, 0, 0] = False
FEATURES = np.zeros((3, 2, 2), np.float32)
FEATURES[1, 0] = [-0.5, 3 / 32768]
PREFERRED = np.array([[2, 0], [3, 0], [0, 0]])
ATTENDED = np.full((3, 2, 3), -1)
ATTENDED[1, 0] = [0, 2, 1]
ATTENTION = np.zeros((3, 2, 3), np.float32)
ATTENTION[1, 0] = [0.6, 0.3, 0.1]
INSPECTION = Inspection(
    ALLOWED, FEATURES, ("nearness", "height"), PROBABILITIES, None, PREFERRED, np.zeros((3, 2), np.bool_), ATTENDED,
    ATTENTION,
)  # fmt: skip
ACTIONS = np.array([[-1, -1, -1], [2, 0, 0], [0, 0, 3], [0, 0, 3]])
INSPECTED = replace(RECORDING, inspection=INSPECTION, actions=ACTIONS, collision_system="soft")


@pytest.fixture
def open_page(new_page, tmp_path):
    """Return a function that saves and opens recordings."""

    def opened(recordings=INSPECTED, address="", width=1000):
        save_html(recordings, tmp_path / "a.html")
        page = new_page((tmp_path / "a.html").as_uri() + address, viewport={"width": width, "height": 700})
        page.wait_for_selector("body[data-ready]")
        return page

    return opened


def table(page, number=0):
    """Return the rows of a table with bars."""
    return (
        page.locator("#decisions .bars")
        .nth(number)
        .locator("tr")
        .evaluate_all("rows => rows.map((row) => [...row.cells].map((cell) => cell.textContent))")
    )


def test_a_decision_has_the_numbers_of_the_recording(open_page):
    page = open_page(address="#t=1&agent=0")
    assert table(page) == [
        ["forward", "0.100", "taken, not allowed"],
        ["turn left", "0.200", ""],
        ["turn right", "0.300", ""],
        ["wait", "0.400", "preferred"],
    ]
    widths = page.locator("#decisions .bars").first.locator("i").evaluate_all("bars => bars.map((b) => b.style.width)")
    assert [round(float(width[:-1])) for width in widths] == [10, 20, 30, 40]
    page.locator("#decisions summary").click()
    assert page.locator("#decisions summary").inner_text() == "Features (2)"
    assert page.locator("#decisions details td").all_inner_texts() == ["-0.500", "0.000"]
    page.keyboard.press("ArrowLeft")
    page.wait_for_function("player.state().step === 0")
    assert [row[1] for row in table(page)] == ["0.500", "0.250", "0.125", "0.125"]
    assert table(page)[2][2] == "preferred, taken"
    assert page.locator("#decisions .refused").count() == 0
    assert page.locator("#decisions details").get_attribute("open") is not None  # remains open


def test_other_agents_and_the_end(open_page):
    page = open_page(address="#t=2&agent=1")
    assert table(page)[0] == ["forward", "0.500", "preferred, taken"]
    page.keyboard.press("ArrowRight")
    assert "None in the last step" in page.locator("#decisions").inner_text()
    page.keyboard.press("]")
    assert "not recorded" in page.locator("#decisions").inner_text()
    page.keyboard.press("Escape")
    assert page.locator("#decisions").inner_text() == ""


def test_an_agent_that_has_disappeared(open_page):
    active = np.ones((4, 3), np.bool_)
    active[1:, 1] = False
    page = open_page(replace(INSPECTED, active=active), "#t=1&agent=1")
    assert "has disappeared" in page.locator("#decisions").inner_text()


def test_nothing_is_shown_of_an_episode_that_was_not_inspected(open_page):
    page = open_page(RECORDING, "#t=1&agent=0")
    assert page.locator("#decisions").inner_text() == ""
    page.locator("#options summary").click()
    assert not page.locator("#attention").is_visible()


def test_a_planner_beside_a_policy(open_page):
    planner = replace(INSPECTED, inspection=Inspection(ALLOWED), name="B")
    page = open_page([replace(INSPECTED, name="A"), planner], "#t=1&agent=0")
    assert page.locator("#decisions h3").all_inner_texts() == ["Decision", "Attention", "Decision"]
    assert table(page, 2) == [
        ["forward", "", "taken, not allowed"], ["turn left", "", ""], ["turn right", "", ""], ["wait", "", ""],
    ]  # fmt: skip
    assert page.locator("#decisions .refused").count() == 1  # of the policy


def test_means_and_an_action_mode_that_samples(open_page):
    inspection = replace(INSPECTION, probabilities=None, means=PROBABILITIES - 0.5, ignored=None)
    page = open_page(replace(INSPECTED, inspection=inspection), "#t=1&agent=0")
    assert table(page)[3] == ["wait", "-0.100", "preferred"]
    text = page.locator("#decisions").inner_text()
    assert "means of the preferences" in text
    assert "The action mode sampled forward instead of wait." in text


# Attention.


def test_attention_is_listed_and_drawn(open_page):
    page = open_page(address="#t=1&agent=0")
    assert table(page, 1) == [["itself", "0.60", ""], ["agent 2", "0.30", ""], ["agent 1", "0.10", ""]]
    drawn = """() => {
        player.draw();
        const { camera, views: [view] } = player, ends = [[1.5, 2.5], [2.5, 0.5]];
        const { left, top, scale } = camera;
        return ends.map(([row, col]) => {
            const x = left + ((0.5 + col) / 2 + 0.05) * scale, y = top + ((0.5 + row) / 2) * scale;
            return [...view.canvas.getContext("2d").getImageData(x - 8, y - 8, 16, 16).data];
        });
    }"""
    with_lines = page.evaluate(drawn)
    page.locator("#options summary").click()
    page.set_checked("#attention", False)
    page.locator("#options summary").click()
    without = page.evaluate(drawn)
    difference = np.abs(np.array(with_lines) - np.array(without)).max(axis=1)
    assert difference[0] > difference[1] > 0  # the weights are 0.3 and 0.1
    page.locator("#decisions a").first.click()
    page.wait_for_function("player.state().chosen === 2")
    page.fill("#agent", "0")
    page.keyboard.press("Escape")
    page.evaluate("player.show(0, 0)")
    assert page.locator("#decisions .bars").count() == 1  # without attention in this step


@pytest.mark.parametrize("width", [1000, 400])
def test_the_panel_is_not_wider_than_the_page(open_page, width):
    page = open_page(address="#t=1&agent=0", width=width)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    aside = page.locator("aside")
    assert aside.evaluate("panel => panel.scrollWidth <= panel.clientWidth")


# Why the safety layer took another action.

FLOOR = np.ones((3, 4), np.bool_)
FLOOR[0, 0] = False
WAIT, UP, DOWN, LEFT, RIGHT = range(5)


@pytest.mark.parametrize(
    ("before", "after", "preferred", "ignored", "cause"),
    [
        ([[1, 0], [1, 1]], [[1, 0], [1, 1]], RIGHT, False, "agent 1 stays on that cell"),
        ([[1, 0], [1, 2]], [[1, 0], [1, 1]], RIGHT, False, "agent 1 takes that cell"),
        ([[1, 0], [1, 1]], [[2, 0], [1, 0]], RIGHT, False, "swap with agent 1, which takes its cell"),
        ([[1, 0], [1, 1]], [[2, 0], [1, 0]], WAIT, False, "agent 1 takes its cell"),
        ([[1, 0], [1, 1]], [[2, 0], [1, 1]], UP, False, "obstacle"),
        ([[1, 0], [1, 1]], [[2, 0], [1, 1]], LEFT, False, "edge of the map"),
        ([[1, 0], [1, 1]], [[2, 0], [1, 1]], RIGHT, True, "the agent made no progress and follows PIBT"),
        ([[1, 0], [2, 3]], [[2, 0], [2, 3]], RIGHT, False, "to make room for another agent"),
    ],
)
def test_why_the_safety_layer_took_another_action(open_page, before, after, preferred, ignored, cause):
    steps = np.array(after[0]) - before[0]
    taken = {(0, 0): WAIT, (1, 0): DOWN}[tuple(steps.tolist())]
    inspection = Inspection(
        np.ones((1, 2, 5), np.bool_), preferred=np.array([[preferred, 0]]), ignored=np.array([[ignored, False]])
    )
    recording = replace(
        RECORDING, free=FLOOR, positions=np.array([before, after]), goals=None, headings=None, active=None,
        blocked=None, observed=None, planes=(), weights=None, actions=np.array([[-1, -1], [taken, 0]]),
        inspection=inspection,
    )  # fmt: skip
    page = open_page(recording, "#t=0&agent=0")
    names = ("wait", "up", "down", "left", "right")
    expected = f"The safety layer took {names[taken]} instead of {names[preferred]}: {cause}."
    assert page.locator("#decisions .refused").inner_text() == expected
