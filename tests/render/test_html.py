"""The page, operated in a browser as by its user."""

import os
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest

from mapf_pz.render.html import save_html
from mapf_pz.render.rgb import agent_colors
from tests.helpers.small_recording import OBSERVED, POSITIONS, RECORDING

FLAGS = (
    *("--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync"),
    *("--disable-background-networking", "--disable-component-update"),
)


def test_the_page_loads_nothing_and_shows_no_foreign_tags(tmp_path):
    save_html(RECORDING, tmp_path / "a.html")
    page = (tmp_path / "a.html").read_text()
    assert not re.search(r"https?://|src=|@import|url\(", page)
    assert "<b>title" not in page
    assert "a &lt;b&gt;title" in page


def test_text_that_looks_like_a_template_is_unchanged(tmp_path):
    save_html(replace(RECORDING, title="{{script}}", facts={"</script>": "{{data}}"}), tmp_path / "a.html")
    page = (tmp_path / "a.html").read_text()
    assert "<title>{{script}}</title>" in page
    assert page.count("</script>") == 2


@pytest.fixture(scope="module")
def browser():
    api = pytest.importorskip("playwright.sync_api")
    found = shutil.which("chromium")
    if found is None:
        pytest.skip("no chromium: apt-get install chromium")
    with api.sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=found, args=list(FLAGS))
        yield chromium
        chromium.close()


@pytest.fixture
def open_page(browser, tmp_path):
    """Return a function that saves and opens a recording; checks for errors and network requests at the end."""
    pages, complaints, requests = [], [], []

    def opened(recording=RECORDING, **options):
        save_html(recording, tmp_path / "a.html")
        page = browser.new_page(viewport={"width": 1000, "height": 600}, **options)
        page.on("console", lambda message: complaints.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("request", lambda request: requests.append(request.url))
        page.goto((tmp_path / "a.html").as_uri())
        page.wait_for_selector("body[data-ready]")
        pages.append(page)
        return page

    yield opened
    for page in pages:
        page.close()
    assert complaints == []
    assert all(url.startswith(("file:", "blob:", "data:")) for url in requests)


def state(page):
    return page.evaluate("player.state()")


def color_at(page, row, col):
    """Return the color at a position on the map, in cells."""
    return page.evaluate(
        """([row, col]) => {
            player.draw();
            const scale = player.ratio * player.scale;
            const x = player.ratio * player.left + col * scale, y = player.ratio * player.top + row * scale;
            return [...player.canvas.getContext("2d").getImageData(x, y, 1, 1).data].slice(0, 3);
        }""",
        [row, col],
    )


def scrub(page, step):
    page.locator("#scrub").evaluate("(slider, step) => { slider.value = step; slider.oninput(); }", step)


def test_it_scrubs_to_the_right_positions(open_page):
    page = open_page()
    for step in (2, 0, 3, 1):
        scrub(page, step)
        assert state(page)["step"] == step
        assert state(page)["positions"] == POSITIONS[step].tolist()
        for agent in (0, 2):
            row, col = POSITIONS[step, agent]
            # Next to the mark of its heading, which is in the center.
            shown = [color_at(page, row + 0.5 + r, col + 0.5 + c) for r in (-0.25, 0.25) for c in (-0.25, 0.25)]
            assert np.rint(agent_colors(3)[agent]).tolist() in shown
    assert page.locator("#step").inner_text() == "1 / 3"


def test_it_plays_to_the_end_and_stops(open_page):
    page = open_page()
    page.select_option("#speed", "1")
    page.keyboard.press(" ")
    assert state(page)["playing"]
    page.select_option("#speed", "16")
    page.wait_for_function("!player.state().playing")
    assert state(page)["step"] == 3
    page.select_option("#speed", "1")
    page.click("#play")  # starts again
    assert state(page)["step"] < 3


def test_steps(open_page):
    page = open_page()
    page.click("#forth")
    page.keyboard.press("ArrowRight")
    assert state(page)["step"] == 2
    page.click("#back")
    assert state(page)["step"] == 1
    page.keyboard.press("End")
    page.keyboard.press("ArrowRight")
    assert state(page)["step"] == 3
    page.keyboard.press("Home")
    assert state(page)["step"] == 0


def test_an_agent_is_chosen_by_a_click_and_described(open_page):
    page = open_page()
    page.mouse.click(*page.evaluate("player.onPage(1, 3)"))
    assert state(page)["chosen"] == 2
    assert "1, 3" in page.locator("#agent-facts").inner_text()
    assert page.locator("#unobserved").is_visible()  # only two agents' observations are recorded
    page.fill("#agent", "0")
    scrub(page, 1)
    facts = page.locator("#agent-facts").inner_text().split()
    assert facts[-2:] == ["blocked", "no"]
    assert "east" in facts
    assert page.locator("#planes figcaption").all_inner_texts() == ["view", "goal"]
    pixels = page.evaluate(
        "[...document.querySelectorAll('#planes canvas')[1].getContext('2d').getImageData(0, 0, 3, 1).data]"
    )
    red, white, blue = pixels[0:3], pixels[4:7], pixels[8:11]
    assert (red[0] > red[2], white, blue[2] > blue[0]) == (True, [255, 255, 255], True)
    page.fill("#agent", "")
    assert state(page)["chosen"] == -1


def test_a_followed_agent_stays_centered(open_page):
    page = open_page()
    page.fill("#agent", "0")
    page.check("#follow")
    for step in (0, 3):
        scrub(page, step)
        page.evaluate("player.draw()")
        row, col = POSITIONS[step, 0].tolist()
        box = page.locator("#view").bounding_box()
        middle = [box["x"] + box["width"] / 2, box["y"] + box["height"] / 2]
        assert page.evaluate(f"player.onPage({row}, {col})") == pytest.approx(middle)


def test_zoom_and_pan(open_page):
    page = open_page()
    scale, at = page.evaluate("player.scale"), page.evaluate("player.onPage(0, 0)")
    page.mouse.move(300, 300)
    page.mouse.wheel(0, 200)
    page.wait_for_function(f"player.scale < {scale}")
    page.keyboard.press("0")
    assert page.evaluate("player.scale") == scale
    page.mouse.move(300, 300)
    page.mouse.down()
    page.mouse.move(330, 310)
    page.mouse.up()
    assert page.evaluate("player.onPage(0, 0)") == pytest.approx([at[0] + 30, at[1] + 10])
    assert state(page)["chosen"] == -1


def test_blocked_moves_are_marked_and_counted(open_page):
    page = open_page()
    scrub(page, 1)
    blocked = page.evaluate("getComputedStyle(document.documentElement).getPropertyValue('--blocked')")
    ring = [2.5, 0.5 + 0.38]
    expected = [int(blocked.strip()[i : i + 2], 16) for i in (1, 3, 5)]
    assert color_at(page, *ring) == expected
    page.uncheck("#blocked")
    assert color_at(page, *ring) != expected
    assert "moves blocked\n1" in page.locator("#facts").inner_text()


def test_edge_weights_are_shown_as_heat(open_page):
    page = open_page()
    plain = color_at(page, 2.5, 3.5)
    page.check("#heat")
    expensive, cheap = color_at(page, 2.5, 3.5), color_at(page, 0.5, 3.5)
    assert len({tuple(plain), tuple(expensive), tuple(cheap)}) == 3
    assert not open_page(replace(RECORDING, weights=None)).locator("#heat-label").is_visible()


def test_arrows_point_in_the_cheaper_direction_of_edges(open_page):
    page = open_page()
    edges = page.evaluate("player.cheaperEdges().map((edge) => [edge.heading, edge.cell, edge.strength])")
    assert edges == [[0, 0, 0.5], [0, 1, 0.5], [0, 2, 0.5]]  # east along row 0, at half the cost
    scrub(page, 3)
    plain = color_at(page, 0.5, 1)
    page.check("#arrows")
    assert color_at(page, 0.5, 1) != plain
    assert not open_page(replace(RECORDING, weights=None)).locator("#arrows-label").is_visible()


def test_light_and_dark(open_page):
    page = open_page(color_scheme="dark")
    assert state(page)["theme"] == "dark"
    dark = color_at(page, 2.5, 3.5)
    page.click("#theme")
    assert state(page)["theme"] == "light"
    assert sum(color_at(page, 2.5, 3.5)) > sum(dark)


def test_unknown_facts_are_not_shown(open_page):
    page = open_page(replace(RECORDING, goals=None, headings=None, blocked=None, observed=None, planes=()))
    page.fill("#agent", "1")
    shown_text = page.locator("aside").inner_text()
    assert "goals\n" not in page.locator("#facts").inner_text()
    assert "heading" not in shown_text
    assert page.locator("#unobserved").is_visible()
    scrub(page, 3)


@pytest.mark.slow
def test_eight_hundred_agents(open_page, tmp_path):
    rng = np.random.default_rng(0)
    positions = np.clip(rng.integers(0, 60, (1, 800, 2)) + rng.integers(-1, 2, (513, 800, 2)).cumsum(axis=0), 0, 83)
    observed = rng.integers(-1, 2, (513, *OBSERVED.shape[1:])).astype(np.int8) * 127
    recording = replace(
        RECORDING, free=np.ones((84, 170), np.bool_), positions=positions, goals=positions[::-1], headings=None,
        active=None, blocked=None, weights=None, observed=observed,
    )  # fmt: skip
    page = open_page(recording)
    assert os.path.getsize(tmp_path / "a.html") < 5_000_000
    scrub(page, 512)
    assert state(page)["positions"] == positions[512].tolist()
