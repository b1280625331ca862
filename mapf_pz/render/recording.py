"""A recorded episode or plan, which can be rendered without an environment."""

from __future__ import annotations

import html
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mapf_pz._internal.arrays import Bools, Floats, Ints
from mapf_pz.render.html import html_page
from mapf_pz.render.rgb import Canvas, Picture
from mapf_pz.simulator.config import CollisionSystem, Frame, View

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


@dataclass(frozen=True, eq=False)
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
    """Metrics of the whole episode, by name."""
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

    def __post_init__(self) -> None:
        """Check the shapes."""
        each = self.positions.shape[:2]
        shapes = dict.fromkeys(("headings", "active", "blocked", "actions", "rewards"), each)
        for name, shape in (shapes | dict.fromkeys(("positions", "goals"), (*each, 2))).items():
            value = getattr(self, name)
            if value is not None and value.shape != shape:
                raise ValueError(f"recording: expected {name} of shape {shape}, got {value.shape}")
        if self.observed is not None and self.observed.shape[::2][:2] != (each[0], len(self.planes)):
            raise ValueError(f"recording: expected {len(self.planes)} planes observed, got {self.observed.shape}")

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

    def pictures(self, cell_size: int | None = None) -> Iterator[Picture]:
        """Yield images (H * cell_size, W * cell_size, 3) uint8 of the start and of the state after each step."""
        canvas = Canvas(self.free, self.num_agents, cell_size)
        for step in range(self.num_steps + 1):
            headings = None if self.headings is None else self.headings[step]
            active = None if self.active is None else self.active[step]
            goals = self.positions[step] if self.goals is None else self.goals[step]  # hidden below the agents
            yield canvas.draw(self.positions[step], headings, goals, active)

    def _repr_html_(self) -> str:
        """Return the page of `save_html` in a frame, which notebooks show."""
        return (
            f'<iframe srcdoc="{html.escape(html_page(self))}" title="{html.escape(self.heading)}" '
            f'style="width: 100%; height: {FRAME_HEIGHT}px; border: 0" allowfullscreen></iframe>'
        )
