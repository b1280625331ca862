from dataclasses import replace

import numpy as np
import pytest

from mapf_pz.render import Inspection, save_recording
from mapf_pz.render.recording import episode_data
from mapf_pz.render.rgb import draw
from tests.helpers.small_recording import ACTIVE, DELAYED, FREE, GOALS, HEADINGS, POSITIONS, RECORDING, WAITS_FOR


def test_pictures_show_each_step():
    pictures = list(RECORDING.pictures(cell_size=16))
    assert len(pictures) == 4
    for step, picture in enumerate(pictures):
        expected = draw(FREE, POSITIONS[step], HEADINGS[step], GOALS[step], ACTIVE[step], cell_size=16)
        np.testing.assert_array_equal(picture, expected)


def test_pictures_show_delayed_agents():
    pictures = list(replace(RECORDING, delayed=DELAYED).pictures(cell_size=16))
    for step, (picture, plain) in enumerate(zip(pictures, RECORDING.pictures(cell_size=16), strict=True)):
        state = POSITIONS[step], HEADINGS[step], GOALS[step], ACTIVE[step], DELAYED[step]
        np.testing.assert_array_equal(picture, draw(FREE, *state, cell_size=16))
        assert np.array_equal(picture, plain) == (step != 2)


@pytest.mark.parametrize(
    ("name", "array", "values"), [("delayed", "delayed", DELAYED), ("waits_for", "waitsFor", WAITS_FOR)]
)
def test_only_recordings_with_delays_have_them(name, array, values):
    plain, delayed = (episode_data(replace(RECORDING, **{name: given})) for given in (None, values))
    assert delayed["arrays"].keys() - plain["arrays"].keys() == {array}
    del delayed["arrays"][array]
    assert delayed == plain


def test_unknown_parts_are_not_drawn():
    bare = replace(RECORDING, goals=None, headings=None, active=None)
    (first, *_) = bare.pictures(cell_size=16)
    np.testing.assert_array_equal(first, draw(FREE, POSITIONS[0], None, POSITIONS[0], cell_size=16))


@pytest.mark.parametrize("name", ["goals", "headings", "active", "blocked", "delayed", "waits_for"])
def test_wrong_shapes_are_rejected(name):
    with pytest.raises(ValueError, match=f"expected {name} of shape"):
        replace(RECORDING, **{name: getattr(replace(RECORDING, delayed=DELAYED, waits_for=WAITS_FOR), name)[1:]})


def test_a_name_is_needed_for_each_plane():
    with pytest.raises(ValueError, match="expected 1 planes observed"):
        replace(RECORDING, planes=("view",))


def test_wrong_shapes_of_decisions_are_rejected():
    allowed = np.ones((3, 2, 4), np.bool_)
    for name in ("features", "probabilities", "means", "preferred", "ignored"):
        with pytest.raises(ValueError, match=rf"inspection: expected {name} of shape \(3, 2"):
            Inspection(allowed, **{name: np.zeros((3, 3))})
    with pytest.raises(ValueError, match="inspection: expected attention of shape"):
        Inspection(allowed, attended=np.zeros((3, 2, 5)), attention=np.zeros((3, 2, 4)))
    with pytest.raises(ValueError, match="expected the decisions of 3 steps, got 2"):
        replace(RECORDING, inspection=Inspection(allowed[1:]))


@pytest.mark.parametrize(("name", "fps", "message"), [("a.bmp", 4, "a.bmp: expected"), ("a.svg", 0, "fps=0")])
def test_objects_that_cannot_be_saved(tmp_path, name, fps, message):
    with pytest.raises(ValueError, match=message):
        save_recording(RECORDING, tmp_path / name, fps)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["a.HTML", "b.svg", "c.gif", "d.mp4", "e.png"])
def test_the_extension_determines_the_format(tmp_path, name):
    needed = {"c": "PIL", "d": "imageio_ffmpeg", "e": "PIL"}
    if name[0] in needed:
        pytest.importorskip(needed[name[0]])
    save_recording(RECORDING, tmp_path / name)
    magic = {"a": b"<!doctype html>", "b": b"<svg ", "c": b"GIF89a", "d": b"\x00\x00\x00", "e": b"\x89PNG"}[name[0]]
    assert (tmp_path / name).read_bytes().startswith(magic)
    assert [file.name for file in tmp_path.iterdir()] == [name]


def test_observations_of_a_single_cell_are_not_shown(tmp_path):
    """Planners, which do not read them, have such observations."""
    pages = []
    for size in (1, 2):
        observed = np.zeros((*POSITIONS.shape[:2], 1, size, size), np.int8)
        save_recording(replace(RECORDING, observed=observed, planes=("view",)), tmp_path / "a.html")
        pages.append((tmp_path / "a.html").read_text("utf-8"))
    assert ['"observed"' in page for page in pages] == [False, True]
