"""A recording as an animated SVG, for slides and web pages."""

from __future__ import annotations

import html
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np

from mapf_pz._internal.arrays import Bools, Ints
from mapf_pz._internal.atomic import write_whole
from mapf_pz._internal.printable import printable
from mapf_pz.render.frames import check_fps
from mapf_pz.render.recording import Recording
from mapf_pz.render.rgb import BAR_BOTTOM, BAR_SIDE, BAR_TOP, color_codes

CELL = 20
"""Side length of a cell, in SVG units."""
PAUSE = 2
"""Pause at the end before the animation repeats, in seconds."""
STYLE = """
.free{fill:#fbfaf7}.obstacle{fill:#464d5c}.mark{fill:#fff}
@media (prefers-color-scheme:dark){.free{fill:#23272e}.obstacle{fill:#5d6675}.mark{fill:#15181d}}
"""
DELAY_STYLE = """.delayed{fill:#14161c}
@media (prefers-color-scheme:dark){.delayed{fill:#fff}}
"""


def save_svg(recording: Recording, path: str | Path, fps: float = 4) -> None:
    """Write an animation that repeats forever; the file is replaced atomically.

    Args:
        recording: the recording.
        path: the file.
        fps: steps per second.

    Raises `ValueError` unless `fps` is in 0 to 100 (0 excluded).
    """
    check_fps(fps)
    write_whole(Path(path), "\n".join(_lines(recording, fps)).encode())


def _lines(recording: Recording, fps: float) -> Iterator[str]:
    height, width = (CELL * side for side in recording.free.shape)
    yield f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}">'
    style = STYLE if recording.delayed is None else STYLE + DELAY_STYLE
    yield f"<title>{html.escape(printable(recording.heading))}</title><style>{style}</style>"
    yield f'<rect class="free" width="{width}" height="{height}"/>'
    yield f'<path class="obstacle" d="{"".join(_obstacles(recording.free))}"/>'
    timeline = _Timeline(recording.num_steps, fps)
    colors = color_codes(recording.num_agents)
    if recording.goals is not None:
        for agent, color in enumerate(colors):
            yield _goal(recording, recording.goals[:, agent], agent, color, timeline)
    for agent, color in enumerate(colors):
        yield from _agent(recording, agent, color, timeline)
    yield "</svg>\n"


def _obstacles(free: Bools) -> Iterator[str]:
    """Yield a rectangle for each run of obstacles in a row."""
    for row, cells in enumerate(free):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], ~cells, [0]]).astype(np.int8)))
        for first, end in edges.reshape(-1, 2).tolist():
            yield f"M{CELL * first} {CELL * row}h{CELL * (end - first)}v{CELL}h-{CELL * (end - first)}z"


class _Timeline:
    """The timing of T steps and a pause, as fractions of the total time."""

    def __init__(self, num_steps: int, fps: float) -> None:
        self.seconds = num_steps / fps + PAUSE
        self.step = 1 / (fps * self.seconds)

    def animate(self, kind: str, changes: Sequence[int], values: Iterable[str], smooth: bool = True) -> str:
        """Return an animation that starts at the first value and reaches the next one at each step in `changes`."""
        times, keys = ["0"], []
        first, *others = values
        keys.append(first)
        before = 0
        for step, value in zip(changes, others, strict=True):
            if smooth and step - 1 > before:  # nothing moves until the step starts
                times.append(f"{(step - 1) * self.step:.5f}")
                keys.append(keys[-1])
            times.append(f"{step * self.step:.5f}")
            keys.append(value)
            before = step
        if smooth:
            times.append("1")
            keys.append(keys[-1])
        mode = "" if smooth else ' calcMode="discrete"'
        tag = "animateTransform" if kind in ("translate", "rotate") else "animate"
        name = "transform" if tag == "animateTransform" else kind
        end = f' type="{kind}"/>' if tag == "animateTransform" else "/>"
        return (
            f'<{tag} attributeName="{name}" dur="{self.seconds:.3f}s" repeatCount="indefinite"{mode} '
            f'keyTimes="{";".join(times)}" values="{";".join(keys)}"{end}'
        )


def _changes(values: Ints | Bools) -> list[int]:
    """Return the steps in which `values`, (T + 1,) or (T + 1, 2), change."""
    changed = values[1:] != values[:-1]
    return (np.flatnonzero(changed.any(axis=1) if changed.ndim > 1 else changed) + 1).tolist()


def _goal(recording: Recording, goals: Ints, agent: int, color: str, timeline: _Timeline) -> str:
    changes = _changes(goals)
    corners = [_corner(goals[step]) for step in [0, *changes]]
    moving = timeline.animate("translate", changes, corners, smooth=False) if changes else ""
    side = CELL - 4
    square = f'<rect x="2" y="2" width="{side}" height="{side}" fill="{color}" fill-opacity=".16" stroke="{color}"/>'
    return f'<g transform="translate({corners[0]})">{moving}{square}{_fading(recording, agent, timeline)}</g>'


def _agent(recording: Recording, agent: int, color: str, timeline: _Timeline) -> Iterator[str]:
    positions = recording.positions[:, agent]
    changes = _changes(positions)
    corners = [_corner(positions[step]) for step in [0, *changes]]
    yield f'<g transform="translate({corners[0]})">'
    if changes:
        yield timeline.animate("translate", changes, corners)
    yield _fading(recording, agent, timeline)
    half = CELL / 2
    yield f'<circle cx="{half:g}" cy="{half:g}" r="{0.38 * CELL:g}" fill="{color}"/>'
    if recording.delayed is not None and recording.delayed[:, agent].any():
        yield _delay_bar(recording.delayed[:, agent], timeline)
    if recording.headings is not None:
        yield from _heading(recording.headings[:, agent], timeline)
    yield "</g>"


def _delay_bar(delayed: Bools, timeline: _Timeline) -> str:
    """Return a bar that is visible during the steps in which an agent is delayed, and stays after the last step."""
    during = np.append(delayed[1:], delayed[-1])  # the step t + 1 takes place after the state t
    changes = _changes(during)
    shown = [str(int(during[step])) for step in [0, *changes]]
    place = f'x="{(0.5 - BAR_SIDE) * CELL:g}" y="{(0.5 + BAR_TOP) * CELL:g}"'
    size = f'width="{2 * BAR_SIDE * CELL:g}" height="{(BAR_BOTTOM - BAR_TOP) * CELL:g}"'
    fading = timeline.animate("opacity", changes, shown, smooth=False) if changes else ""
    return f'<rect class="delayed" {place} {size} opacity="{shown[0]}">{fading}</rect>'


def _heading(headings: Ints, timeline: _Timeline) -> Iterator[str]:
    """Yield a triangle that turns in the shorter direction."""
    quarters = np.concatenate([headings[:1], (np.diff(headings.astype(np.int64)) + 1) % 4 - 1]).cumsum()
    changes, half = _changes(quarters), CELL // 2
    angles = [f"{90 * quarters[step]} {half} {half}" for step in [0, *changes]]
    turning = timeline.animate("rotate", changes, angles) if changes else ""
    tip, side = half + 0.34 * CELL, 0.23 * CELL
    points = f"{tip:g},{half} {half - 0.06 * CELL:g},{half - side:g} {half - 0.06 * CELL:g},{half + side:g}"
    yield f'<polygon class="mark" points="{points}" transform="rotate({angles[0]})">{turning}</polygon>'


def _fading(recording: Recording, agent: int, timeline: _Timeline) -> str:
    """Return an animation that hides an agent after it has disappeared, if it does."""
    if recording.active is None or recording.active[:, agent].all():
        return ""
    active = recording.active[:, agent]
    changes = _changes(active)
    return timeline.animate("opacity", changes, [str(int(active[step])) for step in [0, *changes]], smooth=False)


def _corner(cell: Ints) -> str:
    return f"{CELL * cell[1]} {CELL * cell[0]}"
