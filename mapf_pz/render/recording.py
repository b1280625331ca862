"""A recorded episode or plan: everything that is needed to show it, without an environment."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mapf_pz.arrays import Bools, Floats, Ints
from mapf_pz.render.rgb import Canvas, Picture


@dataclass(frozen=True, eq=False)
class Recording:
    """T steps of N agents. Raises `ValueError` unless the shapes are as said below."""

    free: Bools
    """(H, W), True where an agent can stand."""
    positions: Ints
    """(T + 1, N, 2), [row, col]: row 0 is the beginning."""
    goals: Ints | None
    """(T + 1, N, 2), [row, col]: where each agent shall go then. None: that is not known."""
    headings: Ints | None = None
    """(T + 1, N), or None for agents that look nowhere."""
    active: Bools | None = None
    """(T + 1, N): False for agents that have disappeared. None: nobody does."""
    blocked: Bools | None = None
    """(T + 1, N): whether the step that led here asked for a move that was prevented. None: it is not known."""
    weights: Floats | None = None
    """(4, H, W): what leaving each cell east, south, west and north costs, where edges do not all cost the same."""
    observed: NDArray[np.int8] | None = None
    """(T + 1, M, K, h, w): what the first M agents observed, times 127."""
    planes: tuple[str, ...] = ()
    """What the K planes of that are called."""
    title: str = ""
    """One line: what this is."""
    facts: Mapping[str, str] = field(default_factory=dict)
    """What else is to be told about it, by name."""

    def __post_init__(self) -> None:
        """Check the shapes."""
        each = self.positions.shape[:2]
        shapes = {"positions": (*each, 2), "goals": (*each, 2), "headings": each, "active": each, "blocked": each}
        for name, shape in shapes.items():
            value = getattr(self, name)
            if value is not None and value.shape != shape:
                raise ValueError(f"recording: expected {name} of shape {shape}, got {value.shape}")
        if self.observed is not None and self.observed.shape[::2][:2] != (each[0], len(self.planes)):
            raise ValueError(f"recording: expected {len(self.planes)} planes observed, got {self.observed.shape}")

    @property
    def num_steps(self) -> int:
        """T."""
        return self.positions.shape[0] - 1

    @property
    def num_agents(self) -> int:
        """N."""
        return self.positions.shape[1]

    def pictures(self, cell_size: int | None = None) -> Iterator[Picture]:
        """Draw the beginning, and the state after each step: (H * cell_size, W * cell_size, 3) uint8 each."""
        canvas = Canvas(self.free, self.num_agents, cell_size)
        for step in range(self.num_steps + 1):
            headings = None if self.headings is None else self.headings[step]
            active = None if self.active is None else self.active[step]
            goals = self.positions[step] if self.goals is None else self.goals[step]  # which are hidden by their agents
            yield canvas.draw(self.positions[step], headings, goals, active)
