"""Shapes of a task's observations and actions, from which networks are built."""

from __future__ import annotations

from dataclasses import dataclass

from tensordict import NestedKey
from torchrl.envs import CatFrames, Transform

from mapf_pz.observation import ObservationLayout
from mapf_pz.rl.config import TaskConfig
from mapf_pz.rl.share import Share


@dataclass(frozen=True)
class ObservationShape:
    """Shapes of one agent's observation and the number of its actions."""

    image: tuple[int, int, int]
    """Shape (K, h, w) of the image."""
    features: int
    """F, the number of features; with 0 the observation is the image alone."""
    actions: int
    """A, the number of actions."""

    @classmethod
    def of_task(cls, task: TaskConfig) -> ObservationShape:
        """Return the shapes for a task, with its stacked frames and shared observations."""
        layout = ObservationLayout(task.env, task.env.view_size)
        single = cls(layout.image_shape, layout.num_features, layout.num_actions)
        return single.stacked(task.num_frames * (1 + task.neighbors))

    def stacked(self, number: int) -> ObservationShape:
        """Return the shapes of `number` concatenated observations."""
        channels, height, width = self.image
        return ObservationShape((number * channels, height, width), number * self.features, self.actions)


def observation_transforms(task: TaskConfig) -> list[Transform]:
    """Return the transforms that give the batched environment's observations their shape, `of_task(task)`.

    Neighbors' observations are appended first, and frames are stacked afterwards, as with `task.env_wrappers()`.
    """
    transforms: list[Transform] = []
    if task.neighbors:
        transforms.append(Share(task.neighbors, task.neighbor_radius))
    if task.num_frames > 1:
        observation: NestedKey = ("agents", "observation")
        image: NestedKey = (*observation, "image") if task.env.features else observation
        transforms.append(CatFrames(task.num_frames, dim=-3, in_keys=[image]))
        if task.env.features:
            transforms.append(CatFrames(task.num_frames, dim=-1, in_keys=[(*observation, "features")]))
    return transforms
