"""The player of recordings: a self-contained web page."""

from __future__ import annotations

import html
import json
from collections.abc import Mapping, Sequence
from importlib import resources
from typing import Any

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


def player_body(title: str, first: str = "") -> str:
    """Return the body of the player, with `first` as the first part of its panel."""
    return _filled(player_text("player.html"), {"title": html.escape(title), "first": first})


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
