"""A recording as an animated SVG: one picture for papers, slides and web pages, in which everything moves by itself."""

from __future__ import annotations

import html
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np

from mapf_pz.arrays import Bools, Ints
from mapf_pz.io.atomic import write_whole
from mapf_pz.render.frames import check_fps
from mapf_pz.render.recording import Recording
from mapf_pz.render.rgb import colour_codes

CELL = 20
"""Units of a cell's side."""
PAUSE = 2
"""Seconds at the end, before it begins anew."""
STYLE = """
.free{fill:#fbfaf7}.obstacle{fill:#464d5c}.mark{fill:#fff}
@media (prefers-color-scheme:dark){.free{fill:#23272e}.obstacle{fill:#5d6675}.mark{fill:#15181d}}
"""


def save_svg(recording: Recording, path: str | Path, fps: float = 4) -> None:
    """Write an animation that repeats for ever; `path` is replaced as a whole, or not at all.

    Args:
        recording: What to show.
        path: The file.
        fps: Steps a second.

    Raises `ValueError` unless `fps` is in 0 to 100 (0 excluded).
    """
    check_fps(fps)
    write_whole(Path(path), "\n".join(_lines(recording, fps)).encode())


def _lines(recording: Recording, fps: float) -> Iterator[str]:
    height, width = (CELL * side for side in recording.free.shape)
    yield f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}">'
    yield f"<title>{html.escape(recording.title)}</title><style>{STYLE}</style>"
    yield f'<rect class="free" width="{width}" height="{height}"/>'
    yield f'<path class="obstacle" d="{"".join(_obstacles(recording.free))}"/>'
    clock = _Clock(recording.num_steps, fps)
    colours = colour_codes(recording.num_agents)
    if recording.goals is not None:
        for agent, colour in enumerate(colours):
            yield _goal(recording, recording.goals[:, agent], agent, colour, clock)
    for agent, colour in enumerate(colours):
        yield from _agent(recording, agent, colour, clock)
    yield "</svg>\n"


def _obstacles(free: Bools) -> Iterator[str]:
    """Yield a rectangle for each run of obstacles in a row."""
    for row, cells in enumerate(free):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], ~cells, [0]]).astype(np.int8)))
        for first, end in edges.reshape(-1, 2).tolist():
            yield f"M{CELL * first} {CELL * row}h{CELL * (end - first)}v{CELL}h-{CELL * (end - first)}z"


class _Clock:
    """When what is: T steps and a pause, as shares of the whole time."""

    def __init__(self, num_steps: int, fps: float) -> None:
        self.seconds = num_steps / fps + PAUSE
        self.step = 1 / (fps * self.seconds)

    def animate(self, kind: str, changes: Sequence[int], values: Iterable[str], smooth: bool = True) -> str:
        """Return an animation: at first the first value, at each of the steps `changes` the next one is reached."""
        times, said = ["0"], []
        first, *others = values
        said.append(first)
        before = 0
        for step, value in zip(changes, others, strict=True):
            if smooth and step - 1 > before:  # until the step begins, nothing moves
                times.append(f"{(step - 1) * self.step:.5f}")
                said.append(said[-1])
            times.append(f"{step * self.step:.5f}")
            said.append(value)
            before = step
        if smooth:
            times.append("1")
            said.append(said[-1])
        mode = "" if smooth else ' calcMode="discrete"'
        tag = "animateTransform" if kind in ("translate", "rotate") else "animate"
        name = "transform" if tag == "animateTransform" else kind
        end = f' type="{kind}"/>' if tag == "animateTransform" else "/>"
        return (
            f'<{tag} attributeName="{name}" dur="{self.seconds:.3f}s" repeatCount="indefinite"{mode} '
            f'keyTimes="{";".join(times)}" values="{";".join(said)}"{end}'
        )


def _changes(values: Ints | Bools) -> list[int]:
    """Return the steps that lead to something else than was before: `values` (T + 1,) or (T + 1, 2)."""
    changed = values[1:] != values[:-1]
    return (np.flatnonzero(changed.any(axis=1) if changed.ndim > 1 else changed) + 1).tolist()


def _goal(recording: Recording, goals: Ints, agent: int, colour: str, clock: _Clock) -> str:
    changes = _changes(goals)
    places = [_corner(goals[step]) for step in [0, *changes]]
    moving = clock.animate("translate", changes, places, smooth=False) if changes else ""
    side = CELL - 4
    square = f'<rect x="2" y="2" width="{side}" height="{side}" fill="{colour}" fill-opacity=".16" stroke="{colour}"/>'
    return f'<g transform="translate({places[0]})">{moving}{square}{_fading(recording, agent, clock)}</g>'


def _agent(recording: Recording, agent: int, colour: str, clock: _Clock) -> Iterator[str]:
    positions = recording.positions[:, agent]
    changes = _changes(positions)
    places = [_corner(positions[step]) for step in [0, *changes]]
    yield f'<g transform="translate({places[0]})">'
    if changes:
        yield clock.animate("translate", changes, places)
    yield _fading(recording, agent, clock)
    half = CELL / 2
    yield f'<circle cx="{half:g}" cy="{half:g}" r="{0.38 * CELL:g}" fill="{colour}"/>'
    if recording.headings is not None:
        yield from _heading(recording.headings[:, agent], clock)
    yield "</g>"


def _heading(headings: Ints, clock: _Clock) -> Iterator[str]:
    """Yield a triangle that turns the short way round."""
    quarters = np.concatenate([headings[:1], (np.diff(headings.astype(np.int64)) + 1) % 4 - 1]).cumsum()
    changes, half = _changes(quarters), CELL // 2
    angles = [f"{90 * quarters[step]} {half} {half}" for step in [0, *changes]]
    turning = clock.animate("rotate", changes, angles) if changes else ""
    tip, side = half + 0.34 * CELL, 0.23 * CELL
    points = f"{tip:g},{half} {half - 0.06 * CELL:g},{half - side:g} {half - 0.06 * CELL:g},{half + side:g}"
    yield f'<polygon class="mark" points="{points}" transform="rotate({angles[0]})">{turning}</polygon>'


def _fading(recording: Recording, agent: int, clock: _Clock) -> str:
    """Hide an agent that has disappeared."""
    if recording.active is None or recording.active[:, agent].all():
        return ""
    active = recording.active[:, agent]
    changes = _changes(active)
    return clock.animate("opacity", changes, [str(int(active[step])) for step in [0, *changes]], smooth=False)


def _corner(cell: Ints) -> str:
    return f"{CELL * cell[1]} {CELL * cell[0]}"
