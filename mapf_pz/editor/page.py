"""The page of the editor. It draws instances by itself; planners and policies need the server."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

from mapf_pz._internal.atomic import write_whole
from mapf_pz.render.html import (
    PLAN_FILES,
    PLAYER,
    UNPACKING,
    filled_page,
    player_body,
    player_scripts,
    player_text,
)
from mapf_pz.render.rgb import color_codes

EDITOR = (
    *("drawing", "history", "cells", "faults", "random", "tools", "octile", "movingai", "problemfile", "graphfile"),
    *("code", "board", "editor", "drawingpointer", "shortcuts", "panel", "server", "files", "catalog", "runs"),
    *("playback", "starteditor"),
)
"""The scripts of the folder `page`: they are joined after those of the player, in this order."""


NUM_COLORS = 1000
"""Number of different colors of agents."""


def save_editor(path: str | Path, start: Mapping[str, Any] | None = None) -> None:
    """Write the editor as a page that works by itself. It reads, checks and writes files, and sends nothing.

    The page draws instances, and plays plans. Drop files on it: `.map` and `.scen` of the MovingAI benchmark, problems
    of the League of Robot Runners, guidance graphs, and the plan files that `mapf_pz.planners.plans.files.read_plan`
    reads, except for paths in ticks.

    Args:
        path: the file, which is replaced atomically.
        start: the files that the page opens at first: under `map` and `scenario` each `name` and `text`, or None.
    """
    write_whole(Path(path), editor_page({"start": start}).encode())


def editor_page(data: Mapping[str, Any] | None = None) -> str:
    """Return the text of the page.

    Args:
        data: `start` as in `save_editor`, and `token`, with which the page calls its server; None: neither.
    """
    playback = f"{_text('editor.html')}{player_body('', _text('playback.html'))}</div>\n"
    return filled_page(
        "Instance editor",
        {"colors": color_codes(NUM_COLORS)} | dict(data or {}),
        style=player_text("page.css") + _text("editor.css"),
        body=playback,
        scripts=[*player_scripts((*PLAYER, UNPACKING, *PLAN_FILES)), *(_text(f"{name}.js") for name in EDITOR)],
    )


def _text(name: str) -> str:
    return (resources.files("mapf_pz.editor") / "page" / name).read_text("utf-8")
