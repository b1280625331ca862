"""Recordings as a self-contained web page, with playback, zoom, and the observations of a selected agent."""

from __future__ import annotations

import base64
import html
import json
import zlib
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mapf_pz._internal.atomic import write_whole
from mapf_pz.render.rgb import color_codes

if TYPE_CHECKING:
    from mapf_pz.render.recording import Recording

ACTIVE, BLOCKED = 1, 2
"""Bits of an agent's flags in a step."""
SPEEDS = (1, 2, 4, 8, 16, 32, 64)
"""The playback speeds of the page, in steps per second."""
PLAYER = (
    *("episode", "actions", "colors", "camera", "svgpen", "ground", "directions", "agents", "chosen", "view", "tables"),
    *("planes", "violations", "address", "legend", "export", "hint", "controls", "keys", "pointer", "player"),
)
"""The files of the folder `player` that play episodes: they are joined into the page's script, in this order."""
OF_RECORDINGS = (*PLAYER, "unpack", "start")
"""The files of the script of a page with recordings."""
OF_VIEWER = (*PLAYER, "textfile", "mapfile", "planfile", "lorrplan", "trackerplan", "textplan", "legality", "viewer")
"""The files of the script of a page that reads files."""
VIEWER_COLORS = 1000
"""Number of different colors of agents on a page that reads files."""


def save_html(recordings: Recording | Sequence[Recording], path: str | Path, fps: float = 4) -> None:
    """Write a page that shows recordings. It loads nothing and works offline.

    Args:
        recordings: a recording, or several that are shown side by side and played at the same time.
        path: the file, which is replaced atomically.
        fps: initial playback speed in steps per second, rounded to one of `SPEEDS`.

    Raises:
        ValueError: there is no recording.
    """
    write_whole(Path(path), html_page(recordings, fps).encode())


def save_viewer(path: str | Path) -> None:
    """Write a page that shows a map, a scenario and a plan file, which its user drops on it.

    It is the page of `save_html` without an episode. It reads the files in the browser and sends nothing. Files: `.map`
    and `.scen` of the MovingAI benchmark, and the plan files that `mapf_pz.planners.plans.files.read_plan` reads,
    except for paths in ticks.

    Args:
        path: the file, which is replaced atomically.
    """
    write_whole(Path(path), viewer_page().encode())


def html_page(recordings: Recording | Sequence[Recording], fps: float = 4) -> str:
    """Return the text of the page that `save_html` writes; the arguments and errors are the same."""
    several = list(recordings) if isinstance(recordings, Sequence) else [recordings]
    if not several:
        raise ValueError("expected at least one recording")
    speed = min(SPEEDS, key=lambda speed: abs(speed - fps))
    return _filled(_title(several), {"speed": speed, "episodes": [_episode(each) for each in several]}, OF_RECORDINGS)


def viewer_page() -> str:
    """Return the text of the page that `save_viewer` writes."""
    return _filled("Plan viewer", {"colors": color_codes(VIEWER_COLORS)}, OF_VIEWER, "files.html")


def _title(recordings: Sequence[Recording]) -> str:
    """Return the names of the recordings and what they show, such as `pibt and mappo: random-16-16-20, 8 agents`."""
    names = dict.fromkeys(recording.name for recording in recordings if recording.name)
    titles = dict.fromkeys(recording.title for recording in recordings)
    return ": ".join(filter(None, (" and ".join(names), " and ".join(titles))))


def _filled(title: str, data: dict[str, Any], scripts: Sequence[str], files: str | None = None) -> str:
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


def _episode(recording: Recording) -> dict[str, Any]:
    """Return an episode as the page's script reads it."""
    (height, width), observed, violations = recording.free.shape, _shown_observations(recording), recording.violations
    return {
        "title": recording.heading,
        "caption": recording.name or recording.title,
        "width": width,
        "height": height,
        "steps": recording.num_steps,
        "agents": recording.num_agents,
        "colors": color_codes(recording.num_agents),
        "facts": dict(recording.facts),
        "metrics": dict(recording.metrics),
        "hasBlocked": recording.blocked is not None,
        "lifelong": recording.lifelong,
        "collisionSystem": recording.collision_system,
        "planes": list(recording.planes),
        "observers": 0 if observed is None else observed.shape[1],
        "viewSize": [0, 0] if observed is None else list(observed.shape[-2:]),
        "view": recording.view,
        "frame": recording.frame,
        "violations": None
        if violations is None
        else [{"step": each.step, "agents": list(each.agents), "text": each.text} for each in violations],
        "arrays": {name: _packed(array) for name, array in _arrays(recording).items()},
    }


def _arrays(recording: Recording) -> dict[str, NDArray[Any]]:
    """Return the arrays that the page reads, with the steps of each agent in consecutive order."""
    all_true = np.ones(recording.positions.shape[:2], np.bool_)
    flags = ACTIVE * (all_true if recording.active is None else recording.active)
    flags = flags + BLOCKED * (~all_true if recording.blocked is None else recording.blocked)
    arrays: dict[str, NDArray[Any]] = {
        "free": recording.free.astype(np.uint8),
        "rows": _differences(recording.positions[..., 0]),
        "cols": _differences(recording.positions[..., 1]),
        "flags": flags.T.astype(np.uint8),
    }
    if recording.goals is not None:
        arrays["goalRows"] = _differences(recording.goals[..., 0])
        arrays["goalCols"] = _differences(recording.goals[..., 1])
    if recording.headings is not None:
        arrays["headings"] = recording.headings.T.astype(np.uint8)
    if recording.actions is not None:
        arrays["actions"] = recording.actions.T.astype(np.int8)
    if recording.rewards is not None:
        arrays["rewards"] = recording.rewards.T.astype("<f4")
    if recording.weights is not None:
        arrays["weights"] = recording.weights.astype("<f4")
    observed = _shown_observations(recording)
    if observed is not None:
        arrays["observed"] = observed
    return arrays


def _shown_observations(recording: Recording) -> NDArray[np.int8] | None:
    """Return the observations, unless they are of a single cell: planners do not read them."""
    observed = recording.observed
    return None if observed is None or observed.shape[-2:] == (1, 1) else observed


def _differences(values: NDArray[Any]) -> NDArray[Any]:
    """Return (N, T + 1): each agent's first value, then the differences between steps, which compress well."""
    return np.diff(values.T, axis=1, prepend=0).astype("<i4")


def _packed(array: NDArray[Any]) -> str:
    return base64.b64encode(zlib.compress(np.ascontiguousarray(array).tobytes(), 9)).decode()
