import builtins

import numpy as np
import pytest

from mapf_pz.render.video import save_mp4

ffmpeg = pytest.importorskip("imageio_ffmpeg")
RED, BLUE = (200, 30, 30), (30, 30, 200)


def frame(color, rows=33, cols=40):
    return np.full((rows, cols, 3), color, np.uint8)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # the reader's open files
def test_a_video_has_all_frames_in_order(tmp_path):
    save_mp4(iter([frame(RED), frame(BLUE), frame(RED)]), tmp_path / "a.mp4", fps=5)
    reader = ffmpeg.read_frames(str(tmp_path / "a.mp4"))
    metadata = next(reader)
    assert metadata["fps"] == 5
    assert metadata["size"] == (40, 34)  # even numbers, as H.264 needs them
    frames = [np.frombuffer(data, np.uint8).reshape(34, 40, 3) for data in reader]
    assert len(frames) == 3
    for got, color in zip(frames, [RED, BLUE, RED], strict=True):
        assert np.abs(got.astype(int) - color).max() < 12


def test_frames_of_other_sizes_leave_no_file(tmp_path):
    with pytest.raises(ValueError, match="differ in size"):
        save_mp4([frame(RED), frame(RED, rows=35)], tmp_path / "a.mp4")
    assert not list(tmp_path.iterdir())


def test_no_frames_is_an_error(tmp_path):
    with pytest.raises(ValueError, match="no frames"):
        save_mp4([], tmp_path / "a.mp4")


def test_missing_ffmpeg_names_the_extra(tmp_path, monkeypatch):
    real_import = builtins.__import__

    def without(name, *args, **kwargs):
        if name.startswith("imageio_ffmpeg"):
            raise ImportError(name)
        return real_import(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(ImportError, match=r"mapf-pz\[render\]"):
        save_mp4([frame(RED)], tmp_path / "a.mp4")
