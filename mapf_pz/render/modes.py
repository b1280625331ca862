"""The render modes that this machine can show."""

from __future__ import annotations

import os
import sys
from importlib.util import find_spec

from mapf_pz.simulator.config import RenderMode

DISPLAY_VARIABLES = ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER")
"""Environment variables of which one is set where a window can be opened, on systems other than macOS and Windows."""


def render_modes() -> list[RenderMode]:
    """Return the render modes, with `human` only if there are pygame and a display."""
    has_display = sys.platform in ("darwin", "win32") or any(map(os.environ.get, DISPLAY_VARIABLES))
    window: list[RenderMode] = ["human"] if has_display and find_spec("pygame") is not None else []
    return [*window, "rgb_array", "ansi"]
