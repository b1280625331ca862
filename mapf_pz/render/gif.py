"""Images as PNG or animated GIF files. Requires Pillow: `mapf-pz[render]`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mapf_pz._internal.atomic import replacing
from mapf_pz.render.frames import check_fps, check_frames

if TYPE_CHECKING:
    from PIL import Image

COLORS = 256  # per GIF frame
SAMPLES = 3  # per pixel and axis, for antialiasing


def save_gif(frames: Iterable[NDArray[np.uint8]], path: str | Path, fps: float = 4) -> None:
    """Write an animation that repeats forever.

    Args:
        frames: images (rows, cols, 3) of equal size.
        path: the file, which is replaced atomically.
        fps: frames per second. GIF has a resolution of 1/100 s, and viewers rarely show more than 50 frames per second.

    Raises:
        ValueError: if there are no frames, they differ in size, or `fps` is not in 0 to 100 (0 excluded).
        ImportError: if Pillow is missing.
    """
    check_fps(fps)
    images = (_palette_image(frame) for frame in check_frames(frames))
    first = next(images)
    with replacing(Path(path)) as file:
        first.save(file, format="GIF", save_all=True, append_images=images, duration=round(1000 / fps), loop=0)


def save_png(frame: NDArray[np.uint8], path: str | Path) -> None:
    """Write an image (rows, cols, 3); the file is replaced atomically.

    Raises:
        ImportError: if Pillow is missing.
    """
    image = _image(frame)
    with replacing(Path(path)) as file:
        image.save(file, format="PNG")


def draw_polygons(
    background: NDArray[np.uint8], polygons: Sequence[tuple[NDArray[np.floating], tuple[int, int, int, int]]]
) -> NDArray[np.uint8]:
    """Return an image (rows, cols, 3) with polygons on it, antialiased.

    Args:
        background: (rows, cols, 3).
        polygons: corners (K, 2), [x, y] in pixels, and color of each: red, green, blue, opacity, 0 to 255.

    Raises:
        ImportError: if Pillow is missing.
    """
    image = _image(background)
    from PIL import Image, ImageDraw

    size = image.width * SAMPLES, image.height * SAMPLES
    layer = Image.new("RGBA", size)
    draw = ImageDraw.Draw(layer)
    for corners, color in polygons:
        draw.polygon([(x, y) for x, y in (corners * SAMPLES).tolist()], fill=color)
    layer = layer.resize(image.size, Image.Resampling.BOX)
    return np.asarray(Image.alpha_composite(image.convert("RGBA"), layer).convert("RGB"))


def _palette_image(frame: NDArray[np.uint8]) -> Image.Image:
    """Convert a frame to its own palette: Pillow's default would dither, with visible noise in uniform areas."""
    return _image(frame).quantize(COLORS)


def _image(frame: NDArray[np.uint8]) -> Image.Image:
    try:
        from PIL import Image
    except ImportError as error:
        raise ImportError("saving images requires Pillow: pip install 'mapf-pz[render]'") from error
    return Image.fromarray(frame)
