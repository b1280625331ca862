from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from mapf_pz.render.svg import CELL, PAUSE, save_svg
from tests.helpers.small_recording import DELAYED, POSITIONS, RECORDING

SVG = "{http://www.w3.org/2000/svg}"


def saved(tmp_path, recording=RECORDING, fps=2):
    save_svg(recording, tmp_path / "a.svg", fps)
    return ElementTree.parse(tmp_path / "a.svg").getroot()


def groups(root, shape):
    """Return the groups of goals, which contain a `rect`, or of agents, which contain a `circle`."""
    return [group for group in root.findall(f"{SVG}g") if group.find(f"{SVG}{shape}") is not None]


def place(animation, seconds):
    """Return the value of a translation at a time, in cells: [row, col]."""
    at = seconds / float(animation.get("dur").removesuffix("s"))
    times = [float(time) for time in animation.get("keyTimes").split(";")]
    values = np.array([[float(number) for number in value.split()] for value in animation.get("values").split(";")])
    return [np.interp(at, times, values[:, axis]) / CELL for axis in (1, 0)]


def test_the_map(tmp_path):
    root = saved(tmp_path)
    assert root.get("viewBox") == f"0 0 {4 * CELL} {3 * CELL}"
    assert root.find(f"{SVG}path").get("d") == f"M{CELL} {CELL}h{CELL}v{CELL}h-{CELL}z"
    assert root.find(f"{SVG}title").text == "a <b>title</b>"


def test_control_characters_in_names_leave_the_file_valid(tmp_path):
    root = saved(tmp_path, replace(RECORDING, title="bell\x07 \ud800 tab\t"))
    assert "bell? ? tab" in root.find(f"{SVG}title").text


def test_agents_are_where_they_were_recorded(tmp_path):
    root = saved(tmp_path)
    for agent, group in enumerate(groups(root, "circle")):
        animation = group.find(f"{SVG}animateTransform[@type='translate']")
        for step in range(4):
            assert place(animation, step / 2) == pytest.approx(POSITIONS[step, agent], abs=1e-3)
        assert place(animation, 3 / 2 + PAUSE) == pytest.approx(POSITIONS[3, agent], abs=1e-3)


def test_drawn_agents_move_only_during_a_step(tmp_path):
    animation = groups(saved(tmp_path), "circle")[0].find(f"{SVG}animateTransform[@type='translate']")
    assert place(animation, 0.4) == pytest.approx([0, 0], abs=1e-3)
    assert place(animation, 0.75) == pytest.approx([0, 0.5], abs=1e-3)


def test_headings_turn_in_the_shorter_direction(tmp_path):
    angles = [
        [float(value.split()[0]) for value in turn.get("values").split(";")]
        for group in groups(saved(tmp_path), "circle")
        if (turn := group.find(f"{SVG}polygon/{SVG}animateTransform")) is not None
    ]
    assert angles[0][0] == 270
    assert angles[0][-1] == 360  # from north to east, a quarter to the right
    assert angles[1][0] == 180
    assert angles[1][-1] == 0


def test_goals_change_and_agents_disappear(tmp_path):
    root = saved(tmp_path)
    goal = groups(root, "rect")[2].find(f"{SVG}animateTransform")
    assert goal.get("calcMode") == "discrete"
    assert goal.get("values") == f"{2 * CELL} {CELL};{3 * CELL} {2 * CELL}"
    fading = groups(root, "circle")[1].find(f"{SVG}animate")
    assert (fading.get("attributeName"), fading.get("values")) == ("opacity", "1;0")


def test_a_bar_marks_an_agent_during_its_delay(tmp_path):
    agents = groups(saved(tmp_path, replace(RECORDING, delayed=DELAYED)), "circle")
    bars = [group.find(f"{SVG}rect[@class='delayed']") for group in agents]
    assert [bar is not None for bar in bars] == [False, False, True]
    fading = bars[2].find(f"{SVG}animate")
    times = [float(time) * float(fading.get("dur").removesuffix("s")) for time in fading.get("keyTimes").split(";")]
    assert times == pytest.approx([0, 1 / 2, 2 / 2], abs=1e-3)  # the second step, at 2 steps per second
    assert (fading.get("attributeName"), fading.get("values"), fading.get("calcMode")) == (
        "opacity",
        "0;1;0",
        "discrete",
    )


def test_the_bar_of_the_last_step_stays(tmp_path):
    delayed = np.zeros_like(DELAYED)
    delayed[3, 0] = True
    [bar] = saved(tmp_path, replace(RECORDING, delayed=delayed)).findall(f"{SVG}g/{SVG}rect[@class='delayed']")
    assert bar.find(f"{SVG}animate").get("values") == "0;1"


def test_files_without_delays_are_as_before(tmp_path):
    saved(tmp_path)
    assert "delayed" not in (tmp_path / "a.svg").read_text()


def test_unknown_parts_are_not_drawn(tmp_path):
    root = saved(tmp_path, replace(RECORDING, goals=None, headings=None))
    assert not groups(root, "rect")
    assert not root.findall(f"{SVG}g/{SVG}polygon")


def test_nothing_moves_without_steps(tmp_path):
    first = {name: getattr(RECORDING, name)[:1] for name in ("positions", "goals", "headings", "active", "blocked")}
    root = saved(tmp_path, replace(RECORDING, **first, observed=None))
    assert not list(root.iter(f"{SVG}animateTransform"))
