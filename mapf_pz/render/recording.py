"""A recorded episode or plan, which can be rendered without an environment."""

from __future__ import annotations

import base64
import html
import math
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapf_pz._internal.arrays import Bools, Floats, Ints
from mapf_pz._internal.atomic import write_whole
from mapf_pz.render.html import recordings_page
from mapf_pz.render.inspection import Inspection
from mapf_pz.render.rgb import Canvas, Picture, color_codes
from mapf_pz.simulator.config import CollisionSystem, Frame, View

ACTIVE, BLOCKED = 1, 2
"""Bits of an agent's flags in a step."""
SPEEDS = (1, 2, 4, 8, 16, 32, 64)
"""The playback speeds of the page, in steps per second."""
FRAME_HEIGHT = 640
"""Height of the page in a notebook, in pixels."""


@dataclass(frozen=True)
class RecordedViolation:
    """A violation of the rules in a plan."""

    step: int
    """The step after which it is visible, 0 to T."""
    agents: tuple[int, ...]
    """The agents involved."""
    text: str
    """A one-line description."""


@dataclass(frozen=True, eq=False, repr=False)
class Recording:
    """A recording of T steps of N agents. Raises `ValueError` if the shapes differ from those below."""

    free: Bools
    """(H, W), True for free cells."""
    positions: Ints
    """(T + 1, N, 2), [row, col] after each step; `positions[0]` holds the starts."""
    goals: Ints | None
    """(T + 1, N, 2), [row, col] of each agent's goal. None: unknown."""
    headings: Ints | None = None
    """(T + 1, N), or None for agents without headings."""
    active: Bools | None = None
    """(T + 1, N), False for agents that have disappeared. None: no agent disappears."""
    blocked: Bools | None = None
    """(T + 1, N): whether the agent's move was blocked in the step before. None: unknown."""
    weights: Floats | None = None
    """(4, H, W): cost of moving east, south, west and north from each cell, if the costs are not all equal."""
    observed: NDArray[np.int8] | None = None
    """(T + 1, M, K, h, w): the observations of the first M agents, times 127."""
    planes: tuple[str, ...] = ()
    """Names of the K planes of the observations."""
    title: str = ""
    """One-line title: the map and the number of agents."""
    facts: Mapping[str, str] = field(default_factory=dict)
    """Settings to display, by name."""
    name: str = ""
    """What acted, such as the name of a policy. It tells recordings apart that are shown side by side."""
    metrics: Mapping[str, float] = field(default_factory=dict)
    """Metrics of the whole episode, by name; the page shows the finite ones."""
    violations: tuple[RecordedViolation, ...] | None = None
    """Violations of the rules, in chronological order. None: not checked."""
    actions: Ints | None = None
    """(T + 1, N): each agent's action in the step before; -1 if it took none. None: unknown."""
    rewards: Floats | None = None
    """(T + 1, N): each agent's reward for the step before. None: unknown."""
    collision_system: CollisionSystem | None = None
    """How conflicts were resolved; with the actions, the page derives why a move was blocked. None: unknown."""
    lifelong: bool = False
    """Whether an agent receives its next goal when it reaches one."""
    view: View | None = None
    """The observing agent's place in the observations, as in `EnvConfig.view`. None: unknown."""
    frame: Frame | None = None
    """The orientation of the observations, as in `EnvConfig.frame`. None: unknown."""
    inspection: Inspection | None = None
    """The policy's decisions in T steps. None: not recorded."""
    delayed: Bools | None = None
    """(T + 1, N): whether the agent was delayed in the step before. None: the environment has no delays."""
    waits_for: Ints | None = None
    """(T + 1, N): the agent that each agent waited for in the step before; -1: none. None: unknown."""

    def __post_init__(self) -> None:
        """Check the shapes."""
        each = self.positions.shape[:2]
        shapes = dict.fromkeys(("headings", "active", "blocked", "actions", "rewards", "delayed", "waits_for"), each)
        for name, shape in (shapes | dict.fromkeys(("positions", "goals"), (*each, 2))).items():
            value = getattr(self, name)
            if value is not None and value.shape != shape:
                raise ValueError(f"recording: expected {name} of shape {shape}, got {value.shape}")
        if self.observed is not None and self.observed.shape[::2][:2] != (each[0], len(self.planes)):
            raise ValueError(f"recording: expected {len(self.planes)} planes observed, got {self.observed.shape}")
        if self.inspection is not None and self.inspection.num_steps != self.num_steps:
            got = self.inspection.num_steps
            raise ValueError(f"recording: expected the decisions of {self.num_steps} steps, got {got}")

    @property
    def num_steps(self) -> int:
        """Number of steps T."""
        return self.positions.shape[0] - 1

    @property
    def num_agents(self) -> int:
        """Number of agents N."""
        return self.positions.shape[1]

    @property
    def heading(self) -> str:
        """The name, if there is one, and the title."""
        return f"{self.name}: {self.title}" if self.name else self.title

    def __repr__(self) -> str:
        """Return what is recorded, in one line without the arrays."""
        return f"Recording({self.heading!r}, num_steps={self.num_steps})"

    def pictures(self, cell_size: int | None = None) -> Iterator[Picture]:
        """Yield images (H * cell_size, W * cell_size, 3) uint8 of the start and of the state after each step."""
        canvas = Canvas(self.free, self.num_agents, cell_size)
        for step in range(self.num_steps + 1):
            headings = None if self.headings is None else self.headings[step]
            active = None if self.active is None else self.active[step]
            goals = self.positions[step] if self.goals is None else self.goals[step]  # hidden below the agents
            delayed = None if self.delayed is None else self.delayed[step]
            yield canvas.draw(self.positions[step], headings, goals, active, delayed)

    def _repr_html_(self) -> str:
        """Return the page of `save_html` in a frame, which notebooks show."""
        return (
            f'<iframe srcdoc="{html.escape(html_page(self))}" title="{html.escape(self.heading)}" '
            f'style="width: 100%; height: {FRAME_HEIGHT}px; border: 0" allowfullscreen></iframe>'
        )


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


def html_page(recordings: Recording | Sequence[Recording], fps: float = 4) -> str:
    """Return the text of the page that `save_html` writes; the arguments and errors are the same."""
    several = list(recordings) if isinstance(recordings, Sequence) else [recordings]
    if not several:
        raise ValueError("expected at least one recording")
    speed = min(SPEEDS, key=lambda speed: abs(speed - fps))
    return recordings_page(_title(several), {"speed": speed, "episodes": [episode_data(each) for each in several]})


def _title(recordings: Sequence[Recording]) -> str:
    """Return the names of the recordings and what they show, such as `pibt and mappo: random-16-16-20, 8 agents`."""
    names = dict.fromkeys(recording.name for recording in recordings if recording.name)
    titles = dict.fromkeys(recording.title for recording in recordings)
    return ": ".join(filter(None, (" and ".join(names), " and ".join(titles))))


def episode_data(recording: Recording) -> dict[str, Any]:
    """Return an episode as the page's script reads it: a JSON object."""
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
        # JSON has no infinity.
        "metrics": {name: value for name, value in recording.metrics.items() if math.isfinite(value)},
        "hasBlocked": recording.blocked is not None,
        "lifelong": recording.lifelong,
        "collisionSystem": recording.collision_system,
        "planes": list(recording.planes),
        "observers": 0 if observed is None else observed.shape[1],
        "viewSize": [0, 0] if observed is None else list(observed.shape[-2:]),
        "view": recording.view,
        "frame": recording.frame,
        "inspection": None if recording.inspection is None else recording.inspection.sizes(),
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
    if recording.delayed is not None:
        arrays["delayed"] = recording.delayed.T.astype(np.uint8)
    if recording.waits_for is not None:
        arrays["waitsFor"] = recording.waits_for.T.astype("<i4")
    if recording.weights is not None:
        arrays["weights"] = recording.weights.astype("<f4")
    observed = _shown_observations(recording)
    if observed is not None:
        arrays["observed"] = observed
    if recording.inspection is not None:
        arrays |= recording.inspection.arrays()
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
