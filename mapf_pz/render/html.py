"""The self-contained web page that plays recordings, or files that its user drops on it."""

from __future__ import annotations

import html
import json
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Any

from mapf_pz._internal.atomic import write_whole
from mapf_pz.render.rgb import color_codes

PLAYER = (
    *("episode", "actions", "colors", "camera", "svgpen", "ground", "directions", "agents", "chosen", "attention"),
    *("view", "tables", "planes", "override", "decision", "violations", "address", "legend", "export", "hint"),
    *("controls", "keys", "pointer", "player"),
)
"""The files of the folder `player` that play episodes: they are joined into the page's script, in this order."""
OF_RECORDINGS = (*PLAYER, "unpack", "start")
"""The files of the script of a page with recordings."""
OF_VIEWER = (*PLAYER, "textfile", "mapfile", "planfile", "lorrplan", "trackerplan", "textplan", "legality", "viewer")
"""The files of the script of a page that reads files."""
VIEWER_COLORS = 1000
"""Number of different colors of agents on a page that reads files."""


def save_viewer(path: str | Path) -> None:
    """Write a page that shows a map, a scenario and a plan file, which its user drops on it.

    It is the page of `save_html` without an episode. It reads the files in the browser and sends nothing. Files: `.map`
    and `.scen` of the MovingAI benchmark, and the plan files that `mapf_pz.planners.plans.files.read_plan` reads,
    except for paths in ticks.

    Args:
        path: the file, which is replaced atomically.
    """
    write_whole(Path(path), viewer_page().encode())


def viewer_page() -> str:
    """Return the text of the page that `save_viewer` writes."""
    return filled_page("Plan viewer", {"colors": color_codes(VIEWER_COLORS)}, OF_VIEWER, "files.html")


def filled_page(title: str, data: dict[str, Any], scripts: Sequence[str], files: str | None = None) -> str:
    """Return the page with its title, style, script and data, and the part of the panel in the file `files`."""
    folder = resources.files("mapf_pz.render") / "player"
    parts = {
        "title": html.escape(title),
        "files": "" if files is None else (folder / files).read_text("utf-8"),
        "style": (folder / "page.css").read_text("utf-8"),
        "script": "\n".join(['"use strict";', *((folder / f"{name}.js").read_text("utf-8") for name in scripts)]),
        "data": json.dumps(data).replace("<", "\\u003c"),
    }
    # Split first, so that inserted text is not searched for placeholders.
    first, *others = (folder / "page.html").read_text("utf-8").split("{{")
    return "".join([first, *(parts[name] + rest for name, rest in (other.split("}}", 1) for other in others))])
