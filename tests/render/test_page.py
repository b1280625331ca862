"""The page, operated in a browser as by its user."""

import os
import re
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

import mapf_pz
from mapf_pz.instances.instance import Scenario
from mapf_pz.render.recording import RecordedViolation, save_html
from mapf_pz.render.rgb import agent_colors
from mapf_pz.simulator.actions import CardinalAction
from mapf_pz.wrappers import RecordEpisode
from tests.helpers.small_recording import DELAYED, OBSERVED, POSITIONS, RECORDING, WAITS_FOR


@pytest.fixture
def open_page(new_page, tmp_path):
    """Return a function that saves and opens recordings."""

    def opened(recordings=RECORDING, address="", width=1000, height=600, **options):
        save_html(recordings, tmp_path / "a.html")
        page = new_page(
            (tmp_path / "a.html").as_uri() + address, viewport={"width": width, "height": height}, **options
        )
        page.wait_for_selector("body[data-ready]")
        return page

    return opened


def state(page):
    return page.evaluate("player.state()")


def color_at(page, row, col):
    """Return the color at a position on the map, in cells."""
    return page.evaluate(
        """([row, col]) => {
            player.draw();
            const { camera, views: [view] } = player, scale = view.ratio * camera.scale;
            const x = view.ratio * camera.left + col * scale, y = view.ratio * camera.top + row * scale;
            return [...view.canvas.getContext("2d").getImageData(x, y, 1, 1).data].slice(0, 3);
        }""",
        [float(row), float(col)],
    )


def ink(page, name):
    """Return a color of the theme, 0 to 255."""
    code = page.evaluate(f"player.options.ink.{name}")
    return [int(code[i : i + 2], 16) for i in (1, 3, 5)]


@contextmanager
def options(page):
    """Open the options of the map."""
    page.locator("#options summary").click()
    yield
    page.locator("#options summary").click()


def choose(page, **shown):
    """Set checkboxes of the map's options, and the colors of cells, `ground`."""
    with options(page):
        for name, value in shown.items():
            if name == "ground":
                page.select_option("#ground", value)
            else:
                page.set_checked(f"#{name}", value)


def scrub(page, step):
    page.locator("#scrub").evaluate("(slider, step) => { slider.value = step; slider.oninput(); }", step)


def table(page, name):
    """Return a table of the panel: the values by name."""
    rows = page.locator(f"#{name} tr").evaluate_all(
        "rows => rows.map((row) => [...row.cells].map((c) => c.textContent))"
    )
    return {first: rest[0] if len(rest) == 1 else rest for first, *rest in rows}


# Playback.


def test_it_scrubs_to_the_right_positions(open_page):
    page = open_page()
    for step in (2, 0, 3, 1):
        scrub(page, step)
        assert state(page)["step"] == step
        assert state(page)["positions"] == POSITIONS[step].tolist()
        for agent in (0, 2):
            row, col = POSITIONS[step, agent]
            # Next to its number, which is in the center.
            shown = [color_at(page, row + 0.5 + r, col + 0.5 + c) for r in (-0.25, 0.25) for c in (-0.25, 0.25)]
            assert np.rint(agent_colors(3)[agent]).tolist() in shown
    assert page.locator("#step").inner_text() == "1 / 3"


def test_it_plays_to_the_end_and_stops(open_page):
    page = open_page()
    page.select_option("#speed", "1")
    page.keyboard.press("Escape")  # no effect on playback
    page.locator("canvas").first.focus()
    page.keyboard.press(" ")
    assert state(page)["playing"]
    page.select_option("#speed", "16")
    page.wait_for_function("!player.state().playing")
    assert state(page)["step"] == 3
    page.select_option("#speed", "1")
    page.click("#play")  # starts again
    assert state(page)["step"] < 3


def test_steps_by_buttons_and_keys(open_page):
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


def test_a_focused_control_keeps_its_keys(open_page):
    page = open_page()
    with options(page):
        page.focus("#goals")
        page.keyboard.press(" ")
    assert not page.is_checked("#goals")
    assert not state(page)["playing"]
    page.focus("#agent")
    page.keyboard.press("f")
    assert not page.is_checked("#follow")
    page.focus("#scrub")
    page.keyboard.press("ArrowRight")
    assert state(page)["step"] == 1


def test_agents_are_selected_by_keys(open_page):
    page = open_page()
    chosen = []
    for key in "]]]][[":
        page.keyboard.press(key)
        chosen.append(state(page)["chosen"])
    page.keyboard.press("Escape")
    assert chosen == [0, 1, 2, 0, 2, 1]
    assert state(page)["chosen"] == -1


# The map.


@pytest.mark.parametrize(("width", "height"), [(1000, 600), (700, 500), (400, 700)])
def test_nothing_is_stretched(open_page, width, height):
    page = open_page(width=width, height=height, device_scale_factor=2)
    canvas = page.locator("canvas").first
    page.fill("#agent", "0")  # the panel grows
    box = canvas.bounding_box()
    assert canvas.evaluate("canvas => [canvas.width, canvas.height]") == [2 * box["width"], 2 * box["height"]]
    assert page.locator("#scrub").bounding_box()["width"] >= 0.3 * width
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    for control in ("#play", "#speed", "#theme", "#step"):
        box = page.locator(control).bounding_box()
        assert box["x"] >= 0
        assert box["x"] + box["width"] <= width
        assert box["y"] + box["height"] <= height


def test_obstacles_have_no_grid_lines(open_page):
    page = open_page(replace(RECORDING, free=np.array([[True, False, False, True]] * 3)))
    obstacle = ink(page, "obstacle")
    assert [color_at(page, 1, col) for col in (1.5, 2, 2.5)] == [obstacle] * 3
    assert color_at(page, 2, 3.05) != obstacle  # free cells have some


def test_numbers_are_drawn_when_there_is_room(open_page):
    page = open_page()
    center = [POSITIONS[0, 0, 0] + 0.5, POSITIONS[0, 0, 1] + 0.5]
    area = """([row, col]) => {
        player.draw();
        const { camera, views: [view] } = player, size = Math.ceil(camera.scale * 0.4);
        const x = camera.left + col * camera.scale - size / 2, y = camera.top + row * camera.scale - size / 2;
        return new Set(new Uint32Array(view.canvas.getContext("2d").getImageData(x, y, size, size).data.buffer)).size;
    }"""
    assert page.evaluate(area, center) > 1
    choose(page, numbers=False)
    with_mark = page.evaluate("player.views[0].episode.headings = undefined; player.redraw()")
    assert with_mark is None
    assert page.evaluate(area, center) == 1  # a plain disc


def test_the_pointer_shows_the_agent_and_the_cell(open_page):
    page = open_page()
    page.mouse.move(*page.evaluate("player.onPage(0, 0)"))
    assert page.locator("#hint").inner_text() == "agent 0 · row 0, column 0 · goal row 0, column 2"
    page.mouse.move(*page.evaluate("player.onPage(2, 3)"))
    assert page.locator("#hint").inner_text() == "row 2, column 3"
    page.mouse.move(*page.evaluate("player.onPage(1, 1)"))  # an obstacle
    assert not page.locator("#hint").is_visible()


def test_zoom_and_pan(open_page):
    page = open_page()
    scale, at = page.evaluate("player.camera.scale"), page.evaluate("player.onPage(0, 0)")
    page.mouse.move(300, 300)
    page.mouse.wheel(0, 200)
    page.wait_for_function(f"player.camera.scale < {scale}")
    page.keyboard.press("0")
    assert page.evaluate("player.camera.scale") == scale
    page.click("#larger")
    assert page.evaluate("player.camera.scale") > 0.99 * scale
    page.click("#smaller")
    page.click("#smaller")
    assert page.evaluate("player.camera.scale") < 0.9 * scale
    page.click("#whole")
    assert page.evaluate("player.camera.scale") == scale
    page.mouse.move(300, 300)
    page.mouse.down()
    page.mouse.move(330, 310)
    page.mouse.up()
    assert page.evaluate("player.onPage(0, 0)") == pytest.approx([at[0] + 30, at[1] + 10])
    assert state(page)["chosen"] == -1
    page.keyboard.press("Shift+ArrowLeft")
    assert page.evaluate("player.onPage(0, 0)") == pytest.approx([at[0] + 90, at[1] + 10])


def test_touch(open_page):
    page = open_page(width=400, height=700, has_touch=True)
    page.locator("#options summary").tap()
    assert page.locator("#goals").is_visible()
    page.touchscreen.tap(*page.evaluate("player.onPage(0, 0)"))
    assert state(page)["chosen"] == 0
    assert not page.locator("#goals").is_visible()  # the map closes the options
    session = page.context.new_cdp_session(page)

    def touch(kind, *points):
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": [{"x": x, "y": y} for x, y in points]})

    scale = page.evaluate("player.camera.scale")
    at = page.evaluate("player.camera.at(200, 150)")
    touch("touchStart", (180, 150), (220, 150))
    touch("touchMove", (190, 150), (210, 150))
    touch("touchEnd")
    assert page.evaluate("player.camera.scale") == pytest.approx(scale / 2, rel=0.05)
    assert page.evaluate("player.camera.at(200, 150)") == pytest.approx(at, abs=0.05)
    before = page.evaluate("player.onPage(0, 0)")
    touch("touchStart", (180, 150))
    touch("touchMove", (200, 190))
    touch("touchEnd")
    assert page.evaluate("player.onPage(0, 0)") == pytest.approx([before[0] + 20, before[1] + 40])
    assert state(page)["chosen"] == 0


def test_a_followed_agent_stays_centered(open_page):
    page = open_page()
    page.fill("#agent", "0")
    choose(page, follow=True)
    for step in (0, 3):
        scrub(page, step)
        page.evaluate("player.draw()")
        row, col = POSITIONS[step, 0].tolist()
        box = page.locator("canvas").first.bounding_box()
        middle = [box["x"] + box["width"] / 2, box["y"] + box["height"] / 2]
        assert page.evaluate(f"player.onPage({row}, {col})") == pytest.approx(middle)


def test_light_and_dark(open_page):
    page = open_page(color_scheme="dark")
    assert state(page)["theme"] == "dark"
    dark = color_at(page, 2.5, 3.5)
    page.click("#theme")
    assert state(page)["theme"] == "light"
    assert sum(color_at(page, 2.5, 3.5)) > sum(dark)


def test_blocked_moves_are_marked_and_counted(open_page):
    page = open_page()
    scrub(page, 1)
    ring = [2.5, 0.5 - 0.38]  # behind the agent, which faces east
    assert color_at(page, *ring) == ink(page, "blocked")
    choose(page, blocked=False)
    assert color_at(page, *ring) != ink(page, "blocked")
    assert table(page, "present")["moves blocked"] == "1"


def test_delayed_agents_are_marked_named_and_counted(open_page):
    page = open_page(replace(RECORDING, delayed=DELAYED, metrics={"delay_share": 0.125}))
    page.fill("#agent", "2")
    bar = [1.5 + 0.27, 2.5 + 0.2]  # below the number
    for step, delayed in enumerate(DELAYED[:, 2].tolist()):
        scrub(page, step)
        page.mouse.move(*page.evaluate("player.onPage(0, 3)"))
        page.mouse.move(*page.evaluate("player.onPage(1, 2)"))
        assert ("delayed" in page.locator("#hint").inner_text()) == (delayed and step > 0)
        assert table(page, "present")["agents delayed"] == str(int(delayed))
        assert table(page, "agent-facts").get("delayed") == (None if step == 0 else "yes" if delayed else "no")
        if step > 0:  # the agent is elsewhere before
            assert (color_at(page, *bar) == ink(page, "delayed")) == delayed
    page.evaluate("player.seek(1.5)")  # during the delay
    assert color_at(page, *bar) == ink(page, "delayed")
    assert page.locator("#final th", has_text="delay_share").get_attribute("title")


def test_arrows_lead_to_the_agents_that_are_waited_for(open_page):
    page = open_page(replace(RECORDING, waits_for=WAITS_FOR))
    for step, leaders in enumerate(WAITS_FOR.tolist()):
        scrub(page, step)
        for agent, leader in enumerate(leaders):
            if not RECORDING.active[step, agent]:
                continue
            page.fill("#agent", str(agent))
            assert table(page, "agent-facts").get("waits for") == (None if leader < 0 else f"agent {leader}")
            page.mouse.move(*page.evaluate("player.onPage(0, 3)"))
            page.mouse.move(*page.evaluate("([row, col]) => player.onPage(row, col)", POSITIONS[step, agent].tolist()))
            hint = page.locator("#hint").inner_text()
            assert (" · waits for agent " in hint) == (leader >= 0)
            assert leader < 0 or hint.endswith(f" · waits for agent {leader}")
        page.fill("#agent", "")
        for agent, leader in [(0, 2), (1, 0), (1, 2)]:
            middle = POSITIONS[step, [agent, leader]].mean(axis=0) + 0.5
            assert (color_at(page, *middle) == ink(page, "delayed")) == (leaders[agent] == leader)
    page.evaluate("player.seek(0.5)")  # during the step in which agent 1 waits
    assert color_at(page, 2, 1.75) == ink(page, "delayed")


# The selected agent.


def test_an_agent_is_selected_by_a_click_and_described(open_page):
    page = open_page()
    page.mouse.click(*page.evaluate("player.onPage(1, 3)"))
    assert state(page)["chosen"] == 2
    assert table(page, "agent-facts")["row, column"] == "1, 3"
    assert "not recorded" in page.locator("#planes").inner_text()  # only two agents' observations are
    page.fill("#agent", "0")
    scrub(page, 1)
    assert table(page, "agent-facts") == {"row, column": "0, 0", "heading": "east", "goal": "0, 2", "at its goal": "no"}
    assert page.locator("#planes figcaption").all_inner_texts() == ["view", "goal"]
    page.fill("#agent", "")
    assert state(page)["chosen"] == -1
    assert page.locator("#planes canvas").count() == 0


def test_planes_have_the_colors_of_the_documentation_and_values_at_the_pointer(open_page):
    page = open_page()
    page.fill("#agent", "0")
    scrub(page, 1)
    goal = page.locator("#planes canvas").nth(1)
    pixels = goal.evaluate("canvas => [...canvas.getContext('2d').getImageData(0, 0, 3, 1).data]")
    assert [pixels[0:3], pixels[4:7], pixels[8:11]] == [[5, 48, 97], [247, 247, 247], [103, 0, 31]]
    box = goal.bounding_box()
    page.mouse.move(box["x"] + box["width"] * 5 / 6, box["y"] + box["height"] / 2)
    # The view is centered and north is up: its third cell is one column to the right of the agent.
    assert page.locator("#planes p").inner_text() == "goal at row 0, column 1: 1.00"
    assert color_at(page, 0.5, 1) == ink(page, "blocked")  # the frame of that cell
    page.mouse.move(300, 300)
    assert page.locator("#planes p").inner_text() == ""


def test_values_of_planes_without_a_known_view(open_page):
    page = open_page(replace(RECORDING, view=None))
    page.fill("#agent", "0")
    scrub(page, 1)
    page.locator("#planes canvas").nth(1).hover(position={"x": 5, "y": 5})
    assert page.locator("#planes p").inner_text() == "goal: -1.00"
    with options(page):
        assert not page.locator("#field").is_visible()


@pytest.mark.parametrize(
    ("view", "frame", "heading", "corners"),
    [
        ("centered", "map", 1, [[0, 0], [2, 4]]),
        ("front", "egocentric", 0, [[-1, 2], [3, 4]]),  # east: the five columns are rows
        ("front", "egocentric", 1, [[1, 0], [3, 4]]),
        ("front", "egocentric", 2, [[-1, 0], [3, 2]]),
        ("front", "egocentric", 3, [[-1, 0], [1, 4]]),
    ],
)
def test_the_field_of_view_is_framed(open_page, view, frame, heading, corners):
    positions = np.array([[[1, 2]]])
    recording = replace(
        RECORDING, free=np.ones((4, 5), np.bool_), positions=positions, goals=None, headings=np.array([[heading]]),
        active=None, blocked=None, weights=None, observed=np.zeros((1, 1, 1, 3, 5), np.int8), planes=("view",),
        view=view, frame=frame,
    )  # fmt: skip
    page = open_page(recording)
    page.fill("#agent", "0")
    cells = page.evaluate("[[0, 0], [2, 4]].map((place) => fieldCell(player.episodes[0], 0, 0, ...place))")
    (top, left), (bottom, right) = np.min(cells, axis=0), np.max(cells, axis=0)
    assert [[top, left], [bottom, right]] == corners
    page.evaluate("player.zoom(0.6)")
    frame_color = ink(page, "chosen")
    for row, col in ((top + 0.6, left), (top + 0.6, right + 1), (top, left + 0.6), (bottom + 1, left + 0.6)):
        assert color_at(page, row, col) == frame_color
    choose(page, field=False)
    assert color_at(page, top + 0.6, left) != frame_color


@pytest.mark.parametrize(
    "options", [{}, {"view": "centered"}, {"view": "centered", "frame": "map"}, {"action_model": "cardinal"}]
)
def test_the_field_of_view_is_that_of_the_environment(open_page, options):
    env = RecordEpisode(
        mapf_pz.parallel_env(
            map="random-16-16-20", num_agents=20, max_steps=30, channels=("goal",), view_size=(6, 4), **options
        )
    )
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    while env.agents:
        env.step({agent: int(rng.integers(env.action_space(agent).n)) for agent in env.agents})
    page = open_page(env.recording)
    seen = np.argwhere(env.recording.observed[:, :, 0] == 127)
    assert len(seen) > 20
    cells = page.evaluate(
        "places => places.map(([step, agent, row, col]) => fieldCell(player.episodes[0], agent, step, row, col))",
        seen.tolist(),
    )
    assert cells == env.recording.goals[seen[:, 0], seen[:, 1]].tolist()


def played(collision_system, map, cells, actions):
    """Return the recording of one step of cardinal agents."""
    env = RecordEpisode(
        mapf_pz.parallel_env(
            map=map, num_agents=len(cells), action_model="cardinal", collision_system=collision_system, view_size=(1, 1)
        )
    )
    goals = np.argwhere(env.unwrapped.simulator.source.grid.free)[-len(cells) :]
    env.reset(options={"instance": Scenario(np.array(cells), goals[::-1])})
    env.step({f"agent_{k}": CardinalAction[action] for k, action in enumerate(actions)})
    return env.recording


FLOOR = "....\n.@..\n....\n"


@pytest.mark.parametrize(
    ("system", "cells", "actions", "reasons"),
    [
        ("soft", [(0, 0), (0, 1)], ["UP", "DOWN"], ["edge of the map", "obstacle"]),
        ("soft", [(0, 0), (0, 1)], ["RIGHT", "LEFT"], ["swap with agent 1", "swap with agent 0"]),
        (
            "soft", [(0, 0), (0, 2)], ["RIGHT", "LEFT"],
            [None, "vertex conflict with agent 0, which has the lower index"],
        ),
        ("soft", [(0, 0), (0, 1)], ["RIGHT", "WAIT"], ["agent 1 stayed on the cell", None]),
        (
            "soft", [(0, 0), (0, 1), (0, 2)], ["RIGHT", "RIGHT", "WAIT"],
            ["agent 1 stayed on the cell, blocked itself", "agent 2 stayed on the cell", None],
        ),
        ("priority", [(0, 0), (0, 1)], ["RIGHT", "RIGHT"], ["agent 1 left the cell later in this step", None]),
        ("priority", [(0, 0), (0, 2)], ["RIGHT", "LEFT"], [None, "vertex conflict with agent 0, which moved first"]),
        ("block_both", [(0, 0), (0, 1)], ["RIGHT", "RIGHT"], ["agent 1 was on the cell", None]),
        (
            "block_both", [(0, 0), (0, 2)], ["RIGHT", "LEFT"],
            ["vertex conflict with agent 1", "vertex conflict with agent 0"],
        ),
    ],
)  # fmt: skip
def test_why_a_move_was_blocked(open_page, system, cells, actions, reasons):
    page = open_page(played(system, FLOOR, cells, actions))
    scrub(page, 1)
    shown = []
    for agent, action in enumerate(actions):
        page.fill("#agent", str(agent))
        facts = table(page, "agent-facts")
        assert facts["last action"] == action.lower()
        assert "reward" in facts
        shown.append(facts.get("blocked by"))
    assert shown == reasons


@pytest.mark.parametrize("action_model", ["cardinal", "rotate"])
@pytest.mark.parametrize(
    ("system", "delays"), [("soft", None), ("priority", None), ("block_both", None), ("soft", "0.3:1-3")]
)
def test_every_blocked_move_has_a_cause(open_page, system, delays, action_model):
    env = RecordEpisode(
        mapf_pz.parallel_env(
            map="random-12-12-15", num_agents=50, max_steps=40, collision_system=system, action_model=action_model,
            on_target="finish", delays=delays, view_size=(1, 1),
        )
    )  # fmt: skip
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    while env.agents:
        env.step({agent: int(rng.integers(env.action_space(agent).n)) for agent in env.agents})
    recording = env.recording
    blocked = np.argwhere(recording.blocked).tolist()
    assert len(blocked) > 50
    page = open_page(recording)
    causes = page.evaluate(
        "moves => moves.map(([step, agent]) => blockedBecause(player.episodes[0], agent, step))", blocked
    )
    for (step, agent), cause in zip(blocked, causes, strict=True):
        kind, *others = re.split(r" ?agents? (?=\d)", cause)
        numbers = [int(number) for other in others for number in re.findall(r"\d+", other)]
        assert agent not in numbers
        assert all(recording.active[step - 1, numbers])
        assert ("delayed" in cause) == (kind == "" and delays is not None and recording.delayed[step, numbers[0]])
        cells, before = recording.positions[step], recording.positions[step - 1]
        if kind in ("obstacle", "edge of the map"):
            assert numbers == []
        elif kind == "":  # another agent was on the cell
            assert np.abs(before[numbers[0]] - before[agent]).sum() == 1
            assert (cells[numbers[0]] == before[numbers[0]]).all() == ("stayed" in cause) or "was on" in cause
        elif kind == "swap with":
            assert recording.blocked[step, numbers].all()
        else:
            assert kind == "vertex conflict with"
            assert all(np.abs(before[numbers] - before[agent]).sum(axis=1) <= 2)
            assert system == "block_both" or np.abs(cells[numbers[0]] - before[agent]).sum() == 1  # it moved there


def test_unknown_facts_are_not_shown(open_page):
    page = open_page(
        replace(RECORDING, goals=None, headings=None, blocked=None, observed=None, planes=(), weights=None)
    )
    page.fill("#agent", "1")
    scrub(page, 3)
    assert table(page, "agent-facts") == {"row, column": "2, 2"}
    assert table(page, "present") == {"agents on the map": "2"}
    with options(page):
        for control in ("goals", "blocked", "field", "directions"):
            assert not page.locator(f"#{control}").is_visible()
        assert page.locator("#numbers").is_visible()


# Metrics, guidance graphs, and traffic.


def test_present_and_final_values_are_apart(open_page):
    page = open_page(replace(RECORDING, metrics={"ISR": 2 / 3, "SoC": 12.0}))
    scrub(page, 3)
    assert table(page, "present") == {"at their goals": "2 of 3", "moves blocked": "0", "agents on the map": "2"}
    assert table(page, "final") == {"agents": "3", "steps": "3", "ISR": "0.6667", "SoC": "12"}
    assert table(page, "facts") == {"who": "me"}


def test_reached_goals_are_counted_in_lifelong_episodes(open_page):
    page = open_page(replace(RECORDING, lifelong=True))
    reached = []
    for step in range(4):
        scrub(page, step)
        reached.append(table(page, "present")["goals reached so far"])
    assert reached == ["0", "1", "1", "3"]  # agent 2 in step 1; agents 0 and 1 in step 3
    assert page.locator("#throughput polyline").get_attribute("points") == "0,70 90,0 180,35 270,0"
    assert page.locator("#throughput p").inner_text() == "mean of 25 steps, 0 to 1"
    assert page.locator("#throughput .now").get_attribute("x1") == "270"
    assert not open_page().locator("#throughput").is_visible()


def test_cells_are_colored_by_edge_weights_and_traffic(open_page):
    page = open_page()
    plain = color_at(page, 2.5, 3.5)
    choose(page, ground="weights")
    expensive, cheap = color_at(page, 2.5, 3.5), color_at(page, 0.5, 3.5)
    assert expensive == ink(page, "hot")
    assert cheap == plain
    assert page.locator("#legend").inner_text().split("\n") == ["mean cost of leaving the cell", "0.875", "1"]
    choose(page, ground="traffic")
    assert page.evaluate("[...player.episodes[0].traffic()]") == [0, 1, 1, 0, 0, 0, 1, 0, 0, 1, 1, 0]
    assert color_at(page, 0.5, 1.5) == ink(page, "hot")
    choose(page, ground="waits")
    assert page.evaluate("[...player.episodes[0].waits()]") == [0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0]
    choose(page, ground="plain")
    assert color_at(page, 2.5, 3.5) == plain
    assert not page.locator("#legend").is_visible()
    without = open_page(replace(RECORDING, weights=None))
    assert without.locator("#ground option").all_text_contents() == ["nothing", "traffic", "waiting"]


def test_arrows_point_in_the_cheaper_direction_of_edges(open_page):
    page = open_page()
    edges = page.evaluate("cheaperEdges(player.episodes[0]).map((edge) => [edge.heading, edge.cell, edge.strength])")
    assert edges == [[0, 0, 0.5], [0, 1, 0.5], [0, 2, 0.5]]  # east along row 0, at half the cost
    scrub(page, 3)
    plain = color_at(page, 0.5, 1)
    choose(page, directions=True)
    assert color_at(page, 0.5, 1) != plain
    assert "cheaper direction" in page.locator("#legend").inner_text()


def test_the_path_ahead(open_page):
    page = open_page(replace(RECORDING, observed=None, planes=()))
    page.fill("#agent", "0")
    choose(page, goals=False)
    ahead = [color_at(page, 0.5, 1 + part) for part in np.linspace(0, 1, 30)]
    color = np.rint(agent_colors(3)[0])
    near = [np.abs(np.array(each) - color).max() < 40 for each in ahead]
    assert any(near)
    assert not all(near)  # dashed
    choose(page, ahead=False)  # the line to the goal is black
    without = [color_at(page, 0.5, 1 + part) for part in np.linspace(0, 1, 30)]
    assert not any(np.abs(np.array(each) - color).max() < 40 for each in without)


# Violations, links, and files.

VIOLATIONS = (
    RecordedViolation(1, (0, 2), "step 1: agents 0 and 2 collide"),
    RecordedViolation(3, (1,), "step 3: agent 1 jumps"),
)


def test_every_violation_is_a_link_to_its_step(open_page):
    page = open_page(replace(RECORDING, violations=VIOLATIONS))
    assert page.locator("#violations h2").inner_text() == "Violations: 2"
    links = page.locator("#violations a")
    assert links.all_inner_texts() == [violation.text for violation in VIOLATIONS]
    links.nth(1).click()
    page.wait_for_function("player.state().step === 3")
    assert state(page)["chosen"] == 1
    assert links.nth(1).get_attribute("aria-current") == "step"
    page.keyboard.press("Home")
    links.nth(0).click()
    page.wait_for_function("player.state().step === 1")
    for agent in (0, 2):
        row, col = POSITIONS[1, agent]
        assert color_at(page, row + 0.04, col + 0.02) == ink(page, "blocked")


@pytest.mark.parametrize(("violations", "heading"), [((), "No violations of the rules"), (None, None)])
def test_plans_without_violations(open_page, violations, heading):
    page = open_page(replace(RECORDING, violations=violations))
    section = page.locator("#violations h2")
    assert (section.inner_text() if section.is_visible() else None) == heading


def test_an_address_names_a_step_and_an_agent(open_page):
    page = open_page(address="#t=2&agent=1")
    assert (state(page)["step"], state(page)["chosen"]) == (2, 1)
    page.keyboard.press("ArrowLeft")
    page.wait_for_function("location.hash === '#t=1&agent=1'")
    page.keyboard.press("Escape")
    page.wait_for_function("location.hash === '#t=1'")
    page.evaluate("location.hash = '#t=900&agent=7'")
    page.wait_for_function("player.state().step === 3")  # the last
    assert state(page)["chosen"] == -1
    strange = open_page(address="#t=-1&agent=x&<b>")
    assert (state(strange)["step"], state(strange)["chosen"]) == (0, -1)


def test_a_step_is_saved_as_images(open_page, tmp_path):
    page = open_page(address="#t=1&agent=0", color_scheme="light")
    choose(page, ground="weights")
    choose(page, directions=True)
    page.locator("#options summary").click()
    with page.expect_download() as svg:
        page.click("#svg")
    assert svg.value.suggested_filename == "a-b-title-b-step-1.svg"
    svg.value.save_as(tmp_path / "a.svg")
    with page.expect_download() as png:
        page.click("#png")
    png.value.save_as(tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    size = page.locator("canvas").first.evaluate("canvas => [canvas.clientWidth, canvas.clientHeight]")
    difference = page.evaluate(
        """async (text) => {
            player.draw();
            const image = new Image();
            image.src = URL.createObjectURL(new Blob([text], { type: "image/svg+xml" }));
            await image.decode();
            const { canvas, pen } = player.views[0], copy = new OffscreenCanvas(canvas.width, canvas.height);
            copy.getContext("2d").drawImage(image, 0, 0);
            const read = (pen) => pen.getImageData(0, 0, canvas.width, canvas.height).data;
            const [a, b] = [read(pen), read(copy.getContext("2d"))];
            let different = 0;
            for (let i = 0; i < a.length; i += 4)
                different += Math.abs(a[i] - b[i]) + Math.abs(a[i + 1] - b[i + 1]) > 60;
            return [image.width, image.height, different / (a.length / 4)];
        }""",
        (tmp_path / "a.svg").read_text(),
    )
    assert difference[:2] == size
    assert difference[2] < 0.01  # the same picture, except for edges and letters


# Several episodes.


def test_two_episodes_side_by_side(open_page):
    short = replace(
        RECORDING, positions=POSITIONS[:2], goals=None, headings=None, active=None, blocked=None, observed=None,
        planes=(), name="B", metrics={"ISR": 0.5}, facts={"policy": "B"}, title="other",
    )  # fmt: skip
    page = open_page([replace(RECORDING, name="A", metrics={"ISR": 1.0}, facts={"policy": "A"}), short])
    assert page.locator("h1").inner_text() == "A and B: a <b>title</b> and other"
    assert page.locator("#views figcaption").all_inner_texts() == ["A", "B"]
    assert table(page, "final") == {"": ["A", "B"], "agents": ["3", "3"], "steps": ["3", "1"], "ISR": ["1", "0.5"]}
    first, second = (page.locator("canvas").nth(k).bounding_box() for k in (0, 1))
    assert first["width"] == pytest.approx(second["width"], abs=1)
    assert first["x"] + first["width"] <= second["x"]
    page.fill("#agent", "0")
    scrub(page, 3)  # the second episode shows its last step
    assert table(page, "agent-facts")["row, column"] == ["0, 2", "0, 0"]
    choose(page, ground="traffic")  # one range of colors for both
    assert page.evaluate("player.views.map((view) => view.ground.range('traffic').largest)") == [1, 1]
    assert color_at(page, 2.5, 1.7) == ink(page, "hot")
    page.mouse.move(second["x"] + 50, second["y"] + 50)
    page.mouse.down()
    page.mouse.move(second["x"] + 80, second["y"] + 60)
    page.mouse.up()
    assert page.evaluate("player.views[0].camera === player.views[1].camera")


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


def test_a_notebook_plays_the_recording(new_page, tmp_path):
    frame = replace(RECORDING, violations=VIOLATIONS)._repr_html_()
    (tmp_path / "notebook.html").write_text(f"<!doctype html><title>notebook</title>{frame}")
    page = new_page((tmp_path / "notebook.html").as_uri())
    player = page.frame_locator("iframe")
    player.locator("body[data-ready]").wait_for()
    player.locator("#violations a").nth(1).click()
    player.locator("#step", has_text="3 / 3").wait_for()
    player.locator("#back").click()
    assert player.locator("#step").inner_text() == "2 / 3"
