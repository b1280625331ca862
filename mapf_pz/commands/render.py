"""The command `mapf-pz render`: play an episode and save it as a picture, moving or still."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from tyro.conf import Positional

from mapf_pz.config import ActionModel, CollisionSystem, EnvConfig, OnTarget
from mapf_pz.evaluate.policies import named_policy
from mapf_pz.evaluate.run import AnyEnv, Policy, play
from mapf_pz.render.gif import save_gif, save_png

Frames = Iterable[NDArray[np.uint8]]


@dataclass(frozen=True)
class EpisodeOptions:
    """Which episode, and where its picture goes."""

    output: Positional[Path]
    """The file: `.gif` shows the whole episode, `.png` its end."""
    policy: str = "random"
    """`random`, a planner, or a trained policy: its name, if it comes with the package, or the folder of a run."""
    map: str = str(EnvConfig.map)
    """A map's name or the path of a `.map` file."""
    scenario: str | None = None
    """The path of a `.scen` file; None draws starts and goals."""
    num_agents: int = EnvConfig.num_agents
    """The number of agents."""
    max_steps: int = EnvConfig.max_steps
    """The episode is truncated after this many steps."""
    action_model: ActionModel | None = None
    """Whether agents turn and drive or step in four directions; None: as the policy does."""
    collision_system: CollisionSystem = EnvConfig.collision_system
    """How conflicting moves are settled."""
    on_target: OnTarget = EnvConfig.on_target
    """What an agent does at its goal."""
    seed: int = 0
    """Decides the episode."""
    fps: float = 4
    """Steps per second."""

    def keywords(self) -> dict[str, Any]:
        """Return the keywords of `parallel_env` that are set."""
        names = ("map", "scenario", "num_agents", "max_steps", "action_model", "collision_system", "on_target")
        return {name: value for name in names if (value := getattr(self, name)) is not None}


def render(episode: EpisodeOptions) -> None:
    """Play an episode and save it as a picture, moving or still."""
    ending = episode.output.suffix.lower()
    if ending not in SAVERS:
        raise ValueError(f"{episode.output}: expected a file that ends in {' or '.join(SAVERS)}")
    env, policy = named_policy(episode.policy, episode.seed)(episode.keywords() | {"render_mode": "rgb_array"})
    save_episode(env, policy, episode.seed, episode.output, episode.fps)


def save_episode(env: AnyEnv, policy: Policy, seed: int, output: Path, fps: float) -> None:
    """Play an episode of `env`, which renders pictures, save it to `output`, and print its metrics."""
    output.parent.mkdir(parents=True, exist_ok=True)
    pictures = _with_progress(_pictures(env, policy, seed), env.config.max_steps)
    SAVERS[output.suffix.lower()](pictures, output, fps)
    metrics = ", ".join(f"{name} {value:.4g}" for name, value in env.metrics().items())
    print(f"{output}: {env.step_count} steps, {metrics}")


def _save_last(frames: Frames, path: Path, fps: float) -> None:
    save_png(deque(frames, maxlen=1).pop(), path)


SAVERS: dict[str, Callable[[Frames, Path, float], None]] = {".gif": save_gif, ".png": _save_last}
"""What writes frames to a file, by the file's ending."""


def _pictures(env: AnyEnv, policy: Policy, seed: int) -> Iterator[NDArray[np.uint8]]:
    """Yield a picture (rows, cols, 3) of the beginning of an episode, and one after each step."""
    for _ in play(env, policy, seed):
        yield cast("NDArray[np.uint8]", env.render())


def _with_progress(frames: Frames, max_steps: int) -> Frames:
    console = Console(stderr=True)
    return track(frames, "Playing", max_steps + 1, console=console, transient=True, disable=not console.is_terminal)
