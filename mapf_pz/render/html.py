"""A recording as a self-contained web page, with playback, zoom, and the observations of a selected agent."""

from __future__ import annotations

import base64
import html
import json
import zlib
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapf_pz.io.atomic import write_whole
from mapf_pz.render.recording import Recording
from mapf_pz.render.rgb import color_codes

ACTIVE, BLOCKED = 1, 2
"""Bits of an agent's flags in a step."""
SPEEDS = (1, 2, 4, 8, 16, 32, 64)
"""The playback speeds of the page, in steps per second."""


def save_html(recording: Recording, path: str | Path, fps: float = 4) -> None:
    """Write a page that shows the recording. It loads nothing and works offline.

    Args:
        recording: the recording.
        path: the file, which is replaced atomically.
        fps: initial playback speed in steps per second, rounded to one of `SPEEDS`.
    """
    folder = resources.files("mapf_pz.render") / "player"
    page, style, script = ((folder / f"player.{kind}").read_text("utf-8") for kind in ("html", "css", "js"))
    parts = {"title": html.escape(recording.title), "style": style, "script": script, "data": _data(recording, fps)}
    # Split first, so that inserted text is not searched for placeholders.
    first, *others = page.split("{{")
    filled = [parts[name] + rest for name, rest in (other.split("}}", 1) for other in others)]
    write_whole(Path(path), "".join([first, *filled]).encode())


def _data(recording: Recording, fps: float) -> str:
    """Return the data of the page, as JSON that can be embedded in HTML."""
    (height, width), steps, agents = recording.free.shape, recording.num_steps, recording.num_agents
    observed = recording.observed
    data: dict[str, Any] = {
        "width": width,
        "height": height,
        "steps": steps,
        "agents": agents,
        "speed": min(SPEEDS, key=lambda speed: abs(speed - fps)),
        "colors": color_codes(agents),
        "facts": dict(recording.facts),
        "hasBlocked": recording.blocked is not None,
        "planes": list(recording.planes),
        "observers": 0 if observed is None else observed.shape[1],
        "viewSize": [0, 0] if observed is None else list(observed.shape[-2:]),
        "arrays": {name: _packed(array) for name, array in _arrays(recording).items()},
    }
    return json.dumps(data).replace("<", "\\u003c")


def _arrays(recording: Recording) -> dict[str, NDArray[Any]]:
    """Return the arrays that the page reads, with the steps of each agent in consecutive order."""
    width = recording.free.shape[1]
    all_true = np.ones(recording.positions.shape[:2], np.bool_)
    flags = ACTIVE * (all_true if recording.active is None else recording.active)
    flags = flags + BLOCKED * (~all_true if recording.blocked is None else recording.blocked)
    arrays: dict[str, NDArray[Any]] = {
        "free": recording.free.astype(np.uint8),
        "cells": _differences(recording.positions @ (width, 1)),
        "flags": flags.T.astype(np.uint8),
    }
    if recording.goals is not None:
        arrays["goals"] = _differences(recording.goals @ (width, 1))
    if recording.headings is not None:
        arrays["headings"] = recording.headings.T.astype(np.uint8)
    if recording.weights is not None:
        arrays["weights"] = recording.weights.astype("<f4")
    if recording.observed is not None:
        arrays["observed"] = recording.observed
    return arrays


def _differences(cells: NDArray[Any]) -> NDArray[Any]:
    """Return (N, T + 1): each agent's first cell, then the differences between steps, which compress well."""
    return np.diff(cells.T, axis=1, prepend=0).astype("<i4")


def _packed(array: NDArray[Any]) -> str:
    return base64.b64encode(zlib.compress(np.ascontiguousarray(array).tobytes(), 9)).decode()
