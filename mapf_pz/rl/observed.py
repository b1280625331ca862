"""What the policy of a task observes: the shapes that its networks are built for."""

from __future__ import annotations

from dataclasses import dataclass

from mapf_pz.config import EnvConfig
from mapf_pz.observation import ObservationLayout
from mapf_pz.rl.config import TaskConfig


@dataclass(frozen=True)
class Observed:
    """Shapes of what one agent observes and does."""

    image: tuple[int, int, int]
    """(K, h, w)."""
    features: int
    """F, numbers beside the image; 0: the observation is the image alone."""
    actions: int
    """A."""

    @classmethod
    def by_policy_of(cls, task: TaskConfig) -> Observed:
        """Return the shapes for a task; raises `ValueError` for unknown channels or features."""
        layout = ObservationLayout(EnvConfig.from_keywords(**task.observation_keywords()), task.view_size)
        return cls(layout.image_shape, layout.num_features, layout.num_actions)

    def stacked(self, number: int) -> Observed:
        """Return the shapes of `number` observations as one: planes and features one after the other."""
        planes, height, width = self.image
        return Observed((number * planes, height, width), number * self.features, self.actions)
