"""Self-contained web pages: the player of recordings, and the viewer of files that its user drops on it."""

from __future__ import annotations

import html
import json
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

from mapf_pz._internal.atomic import write_whole
from mapf_pz.render.rgb import color_codes

PLAYER = (
    *("episode", "actions", "colors", "camera", "svgpen", "ground", "directions", "agents", "chosen", "attention"),
    *("view", "tables", "planes", "override", "decision", "violations", "throughput", "address", "legend", "export"),
    *("hint", "controls", "keys", "pointer", "player"),
)
"""The files of the folder `player` that play episodes: they are joined into the page's script, in this order."""
UNPACKING = "unpack"
"""The file that reads the arrays of recordings."""
PLAN_FILES = ("textfile", "mapfile", "planfile", "lorrplan", "trackerplan", "textplan", "legality", "planepisode")
"""The files that read maps, scenarios and plans."""
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
    title, scripts = "Plan viewer", (*PLAYER, *PLAN_FILES, "viewer")
    return filled_page(
        title,
        {"colors": color_codes(VIEWER_COLORS)},
        style=player_text("page.css"),
        body=player_body(title, player_text("files.html")),
        scripts=player_scripts(scripts),
    )


def recordings_page(title: str, data: Mapping[str, Any]) -> str:
    """Return the page that plays the recordings in `data`."""
    return filled_page(
        title,
        data,
        style=player_text("page.css"),
        body=player_body(title),
        scripts=player_scripts((*PLAYER, UNPACKING, "start")),
    )


def filled_page(title: str, data: Mapping[str, Any], *, style: str, body: str, scripts: Sequence[str]) -> str:
    """Return a page with its title, style, body, the texts of its scripts, and its data."""
    parts = {
        "title": html.escape(title),
        "style": style,
        "body": body,
        "script": "\n".join(['"use strict";', *scripts]),
        "data": json.dumps(data).replace("<", "\\u003c"),
    }
    return _filled(player_text("page.html"), parts)


def player_body(title: str, files: str = "") -> str:
    """Return the body of the player, with `files` as the first part of its panel."""
    return _filled(player_text("player.html"), {"title": html.escape(title), "files": files})


def player_scripts(names: Sequence[str]) -> list[str]:
    """Return the texts of scripts in the folder `player`."""
    return [player_text(f"{name}.js") for name in names]


def player_text(name: str) -> str:
    """Return the text of a file in the folder `player`."""
    return (resources.files("mapf_pz.render") / "player" / name).read_text("utf-8")


def _filled(template: str, parts: Mapping[str, str]) -> str:
    """Return the template with each `{{name}}` replaced by that part."""
    # Split first, so that inserted text is not searched for placeholders.
    first, *others = template.split("{{")
    return "".join([first, *(parts[name] + rest for name, rest in (other.split("}}", 1) for other in others))])
