"""Pictures one after the other, as GIF and film need them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from mapf_pz.render.rgb import Picture


def check_fps(fps: float) -> None:
    """Raise `ValueError` unless so many frames, or steps, a second can be shown."""
    if not 0 < fps <= 100:
        raise ValueError(f"fps={fps}: expected more than 0, and 100 at most")


def alike(frames: Iterable[Picture]) -> Iterator[Picture]:
    """Pass on frames, each (rows, cols, 3); raises `ValueError` where there are none, or they differ in size."""
    shape = None
    for frame in frames:
        shape = shape or frame.shape
        if frame.shape != shape:
            raise ValueError(f"frames differ in size: {frame.shape} after {shape} (rows, columns, colours)")
        yield frame
    if shape is None:
        raise ValueError("no frames to save")
