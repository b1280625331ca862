"""Means over training episodes."""

from __future__ import annotations

import math
from collections import defaultdict

from tensordict import NestedKey, TensorDictBase, cat

from mapf_pz.rl.config import TaskConfig, TrainConfig
from mapf_pz.simulator.config import OnTarget

MEANS: dict[OnTarget, tuple[str, ...]] = {
    "nothing": ("CSR", "ISR", "return"),
    "finish": ("CSR", "ISR", "return"),
    "restart": ("throughput", "return"),
}
"""The reported means of episodes. Lifelong episodes are never solved, so their throughput is reported instead."""

_AGENTS: tuple[NestedKey, ...] = tuple(("agents", name) for name in ("at_goal", "arrivals", "episode_reward"))
LAST_STEP: tuple[NestedKey, ...] = ("terminated", *_AGENTS)
"""Entries of the last step of an episode that `episode_means` needs."""


def episode_means(task: TaskConfig, last: TensorDictBase) -> dict[str, float]:
    """Return the number of episodes and the means in `MEANS`, which are NaN without episodes.

    Throughput is the number of goals that all agents together reach per step.

    Args:
        task: the training task.
        last: the `next` entries of the last steps of E episodes, (E,).
    """
    at_goal, arrivals, rewards = (last.get(key).float() for key in _AGENTS)
    means = {
        "CSR": last.get("terminated").float().mean(),
        "ISR": (arrivals > 0 if task.env.on_target == "finish" else at_goal).float().mean(),
        "throughput": arrivals.sum(-2).mean() / task.env.max_steps,
        "return": rewards.mean(),
    }
    return {"episodes": float(len(last))} | {name: float(means[name]) for name in MEANS[task.env.on_target]}


class EpisodesByStart:
    """The means over the training episodes that started in the same update, once all of them have ended.

    The episodes that end in the same update do not represent all episodes: short ones, in which all agents arrive
    early, end first, and more of them end.
    """

    def __init__(self, config: TrainConfig) -> None:
        """Start without episodes."""
        self._task, self._steps = config.task, config.optimization.steps_per_batch
        self._delay = math.ceil(config.task.env.max_steps / self._steps)
        self._ended: defaultdict[int, list[TensorDictBase]] = defaultdict(list)

    def after(self, update: int, batch: TensorDictBase) -> dict[str, float]:
        """Return the means over the episodes that started `max_steps` environment steps before, or earlier.

        The result is empty for data without episodes.

        Args:
            update: the number of the update.
            batch: its data (..., T, 1), with the entry `step_count`.
        """
        steps = batch.get("next", None)
        if steps is None:
            return {}
        over = steps.get("done").squeeze(-1)
        length = steps.get("step_count")[over].squeeze(-1)
        last = steps.select(*LAST_STEP)[over]
        first_step = update * self._steps + over.nonzero()[:, -1] + 1 - length
        started = first_step.div(self._steps, rounding_mode="floor")
        for number in started.unique().tolist():
            self._ended[number].append(last[started == number])
        found = self._ended.pop(update - self._delay, [])
        return episode_means(self._task, cat(found) if found else last[:0])
