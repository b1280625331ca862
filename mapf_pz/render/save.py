"""Save recordings in any of the file formats."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from pathlib import Path

from mapf_pz.render.frames import check_fps
from mapf_pz.render.gif import save_gif, save_png
from mapf_pz.render.recording import Recording, save_html
from mapf_pz.render.svg import save_svg
from mapf_pz.render.video import save_mp4


def _save_gif(recording: Recording, path: Path, fps: float) -> None:
    save_gif(recording.pictures(), path, fps)


def _save_mp4(recording: Recording, path: Path, fps: float) -> None:
    save_mp4(recording.pictures(), path, fps)


def _save_last(recording: Recording, path: Path, fps: float) -> None:
    save_png(deque(recording.pictures(), maxlen=1).pop(), path)


SAVERS: dict[str, Callable[[Recording, Path, float], None]] = {
    ".html": save_html,
    ".svg": save_svg,
    ".gif": _save_gif,
    ".mp4": _save_mp4,
    ".png": _save_last,
}
"""The functions that save a recording, by file extension; a `.png` shows the last state."""


def check_output(path: str | Path, fps: float) -> None:
    """Raise `ValueError` if `save_recording` would, before anything is recorded."""
    if Path(path).suffix.lower() not in SAVERS:
        raise ValueError(f"{path}: expected a file name that ends in {', '.join(SAVERS)}")
    check_fps(fps)


def save_recording(recording: Recording, path: str | Path, fps: float = 4) -> None:
    """Write a recording to a file, which is replaced atomically. The extension determines the format.

    Args:
        recording: the recording.
        path: a file name that ends in `.html` (an interactive page), `.svg` (an animated drawing), `.gif`, `.mp4`, or
            `.png` (the last state).
        fps: steps per second.

    Raises:
        ValueError: if the extension is another one, or `fps` is out of range.
        ImportError: if Pillow (GIF, PNG) or imageio-ffmpeg (MP4) is missing.
    """
    check_output(path, fps)
    SAVERS[Path(path).suffix.lower()](recording, Path(path), fps)
