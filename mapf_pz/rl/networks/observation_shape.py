"""Shapes of a task's observations and actions, from which networks are built."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mapf_pz.rl.config import TaskConfig
from mapf_pz.simulator.observation import ObservationLayout


@dataclass(frozen=True)
class ObservationShape:
    """Shapes of one agent's observation and the number of its actions."""

    image: tuple[int, int, int]
    """Shape (K, h, w) of the image."""
    features: int
    """F, the number of features; with 0 the observation is the image alone."""
    actions: int
    """A, the number of actions."""
    pose: slice | None = None
    """Which features are the agent's pose, if it is observed."""

    @classmethod
    def of_task(cls, task: TaskConfig) -> ObservationShape:
        """Return the shapes for a task."""
        layout = ObservationLayout(task.env)
        return cls(layout.image_shape, layout.num_features, layout.num_actions, layout.own_feature("pose"))

    def stacked(self, number: int) -> ObservationShape:
        """Return the shapes of `number` concatenated observations."""
        channels, height, width = self.image
        return ObservationShape((number * channels, height, width), number * self.features, self.actions)


def shapes_of(observation: Any) -> Any:
    """Return the shape of an observation, or the shapes of its entries by name."""
    if isinstance(observation, dict):
        return {name: np.shape(part) for name, part in observation.items()}
    return np.shape(observation)


def described(shapes: Any) -> str:
    """Return shapes as text for messages."""
    if isinstance(shapes, dict):
        return "a Dict of " + ", ".join(f"{name} {shape}" for name, shape in shapes.items())
    return f"an image {shapes}"
