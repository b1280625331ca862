"""The training loop, shared by all algorithms: collect or replay a batch, learn, report."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Generator, Iterator
from contextlib import contextmanager

from tensordict import TensorDictBase
from torch import nn

from mapf_pz.rl.algorithms.algorithm import Algorithm
from mapf_pz.rl.algorithms.learner import Learner
from mapf_pz.rl.config import TrainConfig
from mapf_pz.rl.training.episodes import EpisodesByStart
from mapf_pz.rl.training.validation import Validation


def updates(
    config: TrainConfig,
    algorithm: Algorithm,
    learner: Learner,
    batches: Iterator[TensorDictBase],
    done: int,
    seconds_before: float = 0.0,
) -> Iterator[dict[str, float]]:
    """Run the training loop from update `done` on, and yield a row of progress of all ranks after each update."""
    ranks, watch = learner.ranks, Stopwatch()
    episodes, validation = EpisodesByStart(config), Validation(algorithm, config, ranks)
    began = time.perf_counter() - seconds_before
    for update in range(done, config.num_updates):
        with watch.time("collecting"), watch.calls(algorithm.actor, "acting"):
            batch = next(batches)
        with watch.time("learning"):
            losses = learner.learn(batch, update / config.num_updates)
        agent_steps, seconds = (update + 1) * config.steps_per_update, time.perf_counter() - began
        yield {
            "agent_steps": agent_steps,
            "seconds": seconds,
            "agent_steps_per_second": agent_steps / seconds,
            **ranks.mean(_shares(watch.lap())),
            **ranks.mean(episodes.after(update, batch), weight="episodes"),
            **ranks.mean(losses),
            **validation.after(agent_steps, last=update + 1 == config.num_updates),
        }


def _shares(seconds: dict[str, float]) -> dict[str, float]:
    """Return the fractions of an update's time: environments and collector, the policy during collection, and learning.

    Waiting for workers counts as collecting.
    """
    total, acting = seconds["collecting"] + seconds["learning"], seconds.get("acting", 0.0)
    return {
        "collecting_share": (seconds["collecting"] - acting) / total,
        "acting_share": acting / total,
        "learning_share": seconds["learning"] / total,
    }


class Stopwatch:
    """Accumulates seconds by name."""

    def __init__(self) -> None:
        """Start at zero."""
        self._seconds: defaultdict[str, float] = defaultdict(float)

    @contextmanager
    def time(self, name: str) -> Generator[None]:
        """Add the duration of a `with` block to `name`."""
        began = time.perf_counter()
        try:
            yield
        finally:
            self._count(name, began)

    @contextmanager
    def calls(self, module: nn.Module, name: str) -> Generator[None]:
        """Add the duration of all calls of a module within a `with` block to `name`."""
        began: list[float] = []
        hooks = (
            module.register_forward_pre_hook(lambda *_: began.append(time.perf_counter())),
            module.register_forward_hook(lambda *_: self._count(name, began.pop())),
        )
        try:
            yield
        finally:
            for hook in hooks:
                hook.remove()

    def lap(self) -> dict[str, float]:
        """Return the seconds by name since the previous lap."""
        seconds = dict(self._seconds)
        self._seconds.clear()
        return seconds

    def _count(self, name: str, began: float) -> None:
        self._seconds[name] += time.perf_counter() - began
