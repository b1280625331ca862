"""Images as an MP4 video. Requires imageio-ffmpeg, which includes ffmpeg: `mapf-pz[render]`."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import closing
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapf_pz._internal.atomic import replacing
from mapf_pz.render.frames import check_fps, check_frames


def save_mp4(frames: Iterable[NDArray[np.uint8]], path: str | Path, fps: float = 4) -> None:
    """Write a video in H.264, which all browsers and players support.

    Args:
        frames: images (rows, cols, 3) of equal size.
        path: the file, which is replaced atomically.
        fps: frames per second.

    Raises:
        ValueError: if there are no frames, they differ in size, or `fps` is not in 0 to 100 (0 excluded).
        ImportError: if imageio-ffmpeg is missing.
    """
    check_fps(fps)
    try:
        from imageio_ffmpeg import write_frames
    except ImportError as error:
        raise ImportError("saving videos requires imageio-ffmpeg: pip install 'mapf-pz[render]'") from error
    pictures = check_frames(frames)
    first = next(pictures)
    rows, cols = (side + side % 2 for side in first.shape[:2])  # H.264 stores colors for blocks of 2 x 2 pixels
    rate: Any = fps  # annotated as int, but accepts float
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
