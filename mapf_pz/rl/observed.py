"""What the policy of a task observes: the shapes that its networks are built for."""

from __future__ import annotations

from dataclasses import dataclass

from tensordict import NestedKey
from torchrl.envs import CatFrames, Transform

from mapf_pz.observation import ObservationLayout
from mapf_pz.rl.config import TaskConfig
from mapf_pz.rl.share import Share


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
        """Return the shapes for a task."""
        layout = ObservationLayout(task.env, task.env.view_size)
        own = cls(layout.image_shape, layout.num_features, layout.num_actions)
        return own.stacked(task.num_frames * (1 + task.neighbors))

    def stacked(self, number: int) -> Observed:
        """Return the shapes of `number` observations as one: planes and features one after the other."""
        planes, height, width = self.image
        return Observed((number * planes, height, width), number * self.features, self.actions)


def observation_transforms(task: TaskConfig) -> list[Transform]:
    """Return what makes the batched environment show what `Observed.by_policy_of(task)` describes.

    First come the neighbors' observations, then the earlier ones of all of these: as `task.env_wrappers()` does it.
    """
    transforms: list[Transform] = []
    if task.neighbors:
        transforms.append(Share(task.neighbors, task.neighbor_radius))
    if task.num_frames > 1:
        seen: NestedKey = ("agents", "observation")
        image: NestedKey = (*seen, "image") if task.env.features else seen
        transforms.append(CatFrames(task.num_frames, dim=-3, in_keys=[image]))
        if task.env.features:
            transforms.append(CatFrames(task.num_frames, dim=-1, in_keys=[(*seen, "features")]))
    return transforms
