"""Pictures as an MP4 film. Needs imageio-ffmpeg, which brings ffmpeg along: the extra `mapf-pz[render]`."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import closing
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapf_pz.io.atomic import replacing
from mapf_pz.render.frames import alike, check_fps


def save_mp4(frames: Iterable[NDArray[np.uint8]], path: str | Path, fps: float = 4) -> None:
    """Write a film in H.264, which every browser and player knows.

    Args:
        frames: Each (rows, cols, 3), all of one size.
        path: The file; it is replaced as a whole, or not at all.
        fps: Frames a second.

    Raises:
        ValueError: If there are no frames, they differ in size, or `fps` is not in 0 to 100 (0 excluded).
        ImportError: If imageio-ffmpeg is missing.
    """
    check_fps(fps)
    try:
        from imageio_ffmpeg import write_frames
    except ImportError as error:
        raise ImportError("saving films needs imageio-ffmpeg: pip install 'mapf-pz[render]'") from error
    pictures = alike(frames)
    first = next(pictures)
    rows, cols = (side + side % 2 for side in first.shape[:2])  # H.264 stores colours for two by two pixels
    rate: Any = fps  # annotated for whole numbers, and takes others
    wider = ((0, rows - first.shape[0]), (0, cols - first.shape[1]), (0, 0))
    with (
        replacing(Path(path)) as file,
        closing(
            write_frames(str(file), (cols, rows), fps=rate, quality=8, macro_block_size=2, ffmpeg_log_level="error")
        ) as writer,
    ):
        writer.send(None)
        for picture in chain([first], pictures):
            writer.send(np.ascontiguousarray(np.pad(picture, wider, mode="edge")))
