"""Pictures as files: one PNG, or many in a GIF. Needs Pillow, the extra `mapf-pz[render]`."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mapf_pz.io.atomic import replacing
from mapf_pz.render.frames import alike, check_fps

if TYPE_CHECKING:
    from PIL import Image

COLOURS = 256  # of one GIF frame


def save_gif(frames: Iterable[NDArray[np.uint8]], path: str | Path, fps: float = 4) -> None:
    """Write an animation that repeats for ever.

    Args:
        frames: Each (rows, cols, 3), all of one size.
        path: The file; it is replaced as a whole, or not at all.
        fps: Frames per second; GIF knows hundredths of a second, and viewers rarely show more than 50 a second.

    Raises:
        ValueError: If there are no frames, they differ in size, or `fps` is not in 0 to 100 (0 excluded).
        ImportError: If Pillow is missing.
    """
    check_fps(fps)
    images = (_palette_image(frame) for frame in alike(frames))
    first = next(images)
    with replacing(Path(path)) as file:
        first.save(file, format="GIF", save_all=True, append_images=images, duration=round(1000 / fps), loop=0)


def save_png(frame: NDArray[np.uint8], path: str | Path) -> None:
    """Write one picture (rows, cols, 3); `path` is replaced as a whole, or not at all.

    Raises:
        ImportError: If Pillow is missing.
    """
    image = _image(frame)
    with replacing(Path(path)) as file:
        image.save(file, format="PNG")


def _palette_image(frame: NDArray[np.uint8]) -> Image.Image:
    """Give a frame its own best colours: Pillow's default would dither, and speckle even areas."""
    return _image(frame).quantize(COLOURS)


def _image(frame: NDArray[np.uint8]) -> Image.Image:
    try:
        from PIL import Image
    except ImportError as error:
        raise ImportError("saving pictures needs Pillow: pip install 'mapf-pz[render]'") from error
    return Image.fromarray(frame)
