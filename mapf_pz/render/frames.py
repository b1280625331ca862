"""Checks of frame sequences, for GIF and video."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from mapf_pz.render.rgb import Picture


def check_fps(fps: float) -> None:
    """Raise `ValueError` unless `fps`, in frames or steps per second, is in range."""
    if not 0 < fps <= 100:
        raise ValueError(f"fps={fps}: expected more than 0 and at most 100")


def check_frames(frames: Iterable[Picture]) -> Iterator[Picture]:
    """Yield the frames, each (rows, cols, 3); raises `ValueError` if there are none or if they differ in size."""
    shape = None
    for frame in frames:
        shape = shape or frame.shape
        if frame.shape != shape:
            raise ValueError(f"frames differ in size: {frame.shape} after {shape} (rows, columns, channels)")
        yield frame
    if shape is None:
        raise ValueError("no frames to save")
