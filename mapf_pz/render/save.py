"""Recordings as files of all kinds."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from pathlib import Path

from mapf_pz.render.frames import check_fps
from mapf_pz.render.gif import save_gif, save_png
from mapf_pz.render.html import save_html
from mapf_pz.render.recording import Recording
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
"""What writes a recording to a file, by the file's ending; a `.png` shows how it ends."""


def check_output(path: str | Path, fps: float) -> None:
    """Raise `ValueError` where `save_recording` would, whatever is recorded."""
    if Path(path).suffix.lower() not in SAVERS:
        raise ValueError(f"{path}: expected a file that ends in {', '.join(SAVERS)}")
    check_fps(fps)


def save_recording(recording: Recording, path: str | Path, fps: float = 4) -> None:
    """Write a recording to a file, which is replaced as a whole, or not at all; its ending decides what it becomes.

    Args:
        recording: what to show.
        path: ends in `.html` (a page to play, step and look closely), `.svg` (an animated drawing), `.gif`, `.mp4`, or
            `.png` (how it ends).
        fps: steps a second.

    Raises:
        ValueError: another ending, or `fps` out of range.
        ImportError: Pillow (GIF, PNG) or imageio-ffmpeg (MP4) is missing.
    """
    check_output(path, fps)
    SAVERS[Path(path).suffix.lower()](recording, Path(path), fps)
