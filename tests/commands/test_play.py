"""`mapf-pz play` with simulated keys."""

import re

import numpy as np
import pytest

from mapf_pz.commands.main import main
from mapf_pz.render.window import Window

pytest.importorskip("pygame")


@pytest.fixture
def keyboard(monkeypatch):
    """Return what sets the keys that are pressed, and all that is shown: pictures, and the title above."""
    shown = []

    def pressed(*keys):
        left = iter([*([key] for key in keys), ["escape"]])
        monkeypatch.setattr(Window, "wait", lambda _: next(left))
        monkeypatch.setattr(Window, "show", lambda _, picture, title: shown.append((picture, title)))
        return shown

    return pressed


def play(capsys, *words):
    status = main(["play", *words])
    return status, capsys.readouterr().out


def test_keys_are_steps(capsys, keyboard):
    shown = keyboard("up", "left", "right", "space", "x")
    status, out = play(capsys, "--num-agents", "3", "--policy", "random")
    assert status == 0
    titles = [title for _, title in shown]
    assert titles[0] == "arrows: move, space: wait, r: restart, escape: quit"
    assert [int(re.match(r"step (\d)", title)[1]) for title in titles[1:]] == [1, 2, 3, 4, 4]
    assert out.startswith("4 steps, your rewards ")
    assert not np.array_equal(shown[0][0], shown[1][0])


def test_turning_left_and_right_is_nothing_and_costs(capsys, keyboard):
    shown = keyboard("left", "right")
    play(capsys, "--num-agents", "1", "--map", "empty-8-8")
    (first, _), (turned, message), (back, _) = shown
    assert not np.array_equal(first, turned)
    np.testing.assert_array_equal(first, back)
    assert "reward -" in message or "reward +" in message


def test_a_scenario_has_its_own_map(capsys, keyboard):
    """In place of the default map."""
    shown = keyboard("space")
    status, out = play(capsys, "--scenario", "warehouse_small_10", "--num-agents", "3")
    assert status == 0
    assert out.startswith("1 steps")
    assert shown[0][0].shape[0] < shown[0][0].shape[1]


@pytest.mark.parametrize(("key", "step"), [("up", (-1, 0)), ("down", (1, 0)), ("left", (0, -1)), ("right", (0, 1))])
def test_cardinal_keys(capsys, keyboard, key, step):
    """The frame marks the position of the controlled agent."""
    shown = keyboard(key)
    play(capsys, "--num-agents", "1", "--map", "empty-16-16", "--action-model", "cardinal", "--seed", "2")
    ring = [np.argwhere((picture == (20, 22, 28)).all(axis=2)).min(axis=0) for picture, _ in shown]
    assert ((ring[1] - ring[0]) // 48).tolist() == list(step)


def test_a_new_episode(capsys, keyboard):
    shown = keyboard("up", "r", "space")
    play(capsys, "--num-agents", "2", "--policy", "random", "--max-steps", "2")
    assert shown[2][1].startswith("arrows")
    assert not np.array_equal(shown[0][0], shown[2][0])  # of the next seed
    assert shown[3][1].startswith("step 1")


def test_after_the_end_any_key_restarts(capsys, keyboard):
    shown = keyboard("space", "space", "up")
    play(capsys, "--num-agents", "2", "--policy", "random", "--max-steps", "2")
    assert "episode over" in shown[2][1]
    assert shown[3][1].startswith("arrows")
