import builtins

import numpy as np
import pytest

from mapf_pz.render.gif import save_gif, save_png

Image = pytest.importorskip("PIL.Image")
RED, BLUE = (200, 30, 30), (30, 30, 200)


def frame(color, size=4):
    return np.full((size, size, 3), color, np.uint8)


def files(folder):
    return sorted(path.name for path in folder.iterdir())


def test_gif_holds_all_frames_in_order(tmp_path):
    save_gif(iter([frame(RED), frame(BLUE), frame(RED)]), tmp_path / "a.gif", fps=5)
    with Image.open(tmp_path / "a.gif") as gif:
        assert gif.n_frames == 3
        assert gif.info["duration"] == 200
        assert gif.info["loop"] == 0
        for index, color in enumerate([RED, BLUE, RED]):
            gif.seek(index)
            assert gif.convert("RGB").getpixel((1, 2)) == color
    assert files(tmp_path) == ["a.gif"]


def test_png_is_exact(tmp_path):
    picture = np.random.default_rng(0).integers(0, 256, (5, 7, 3), np.uint8)
    save_png(picture, str(tmp_path / "a.png"))
    with Image.open(tmp_path / "a.png") as png:
        assert (np.asarray(png) == picture).all()
    assert files(tmp_path) == ["a.png"]


def test_no_frames_is_an_error(tmp_path):
    with pytest.raises(ValueError, match="no frames"):
        save_gif([], tmp_path / "a.gif")


@pytest.mark.parametrize("fps", [0, -1, 101, float("nan")])
def test_speed_out_of_range_is_an_error(tmp_path, fps):
    with pytest.raises(ValueError, match="fps="):
        save_gif([frame(RED)], tmp_path / "a.gif", fps=fps)


def test_a_failure_keeps_the_old_file(tmp_path):
    save_gif([frame(RED)], tmp_path / "a.gif")
    before = (tmp_path / "a.gif").read_bytes()
    with pytest.raises(ValueError, match="differ in size"):
        save_gif([frame(RED), frame(BLUE, size=5)], tmp_path / "a.gif")
    assert (tmp_path / "a.gif").read_bytes() == before
    assert files(tmp_path) == ["a.gif"]


def test_missing_pillow_names_the_extra(tmp_path, monkeypatch):
    real_import = builtins.__import__

    def without_pillow(name, *args, **kwargs):
        if name.startswith("PIL"):
            raise ImportError(name)
        return real_import(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without_pillow)
    with pytest.raises(ImportError, match=r"mapf-pz\[render\]"):
        save_png(frame(RED), tmp_path / "a.png")
