"""`SimulatorVectorEnv`: what the Gymnasium vector environments of this package share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import ArrayLike, NDArray

from mapf_pz._internal.arrays import Bools, Floats, Ints
from mapf_pz.render.rgb import Canvas, Picture
from mapf_pz.simulator.config import BatchConfig, EnvConfig, check_whole
from mapf_pz.simulator.seeds import MAX_SEED
from mapf_pz.simulator.simulator import Simulator

VectorInfos = dict[str, Any]
VectorObservation = NDArray[np.float32] | dict[str, NDArray[np.float32]]


class SimulatorVectorEnv(VectorEnv[VectorObservation, ArrayLike, NDArray[Any]]):
    """The B environments of one simulator: their seeds, resets and metrics.

    Environment `b` of a batch with the seed `s` equals a single environment with the seed `s + b`.
    """

    def __init__(self, config: BatchConfig, autoreset_mode: AutoresetMode) -> None:
        """Create the simulator; raises as it does, and `ValueError` for a render mode other than `rgb_array`."""
        if config.render_mode not in (None, "rgb_array"):
            raise ValueError(
                f"render_mode={config.render_mode!r}: expected None or 'rgb_array' for several environments"
            )
        self.render_mode = config.render_mode
        self.simulator = Simulator(EnvConfig(**config.keywords()), config.num_envs, config.num_threads)
        self.metadata = {"autoreset_mode": autoreset_mode, "render_modes": ["rgb_array"], "render_fps": 4}
        self._canvases: dict[int, Canvas] = {}
        self._over = np.zeros(config.num_envs, np.bool_)
        self._metric_names: tuple[str, ...] = ()  # empty before the first reset

    def render(self) -> tuple[Picture, ...] | None:
        """Return an image (rows, cols, 3) uint8 of each of the B environments; None without a render mode."""
        if self.render_mode is None:
            return None
        return tuple(map(self._image, range(self.simulator.num_envs)))

    def _image(self, b: int) -> Picture:
        simulator = self.simulator
        free, agents = simulator.grid(b).free, simulator.agents[b]
        if b not in self._canvases or self._canvases[b].free is not free:
            self._canvases[b] = Canvas(free, simulator.num_agents)
        headings = agents["heading"] if simulator.config.action_model == "rotate" else None
        return self._canvases[b].draw(simulator.positions(b), headings, simulator.goals(b), agents["active"])

    def _start(self, seed: int | Sequence[int | None] | None, options: dict[str, Any] | None) -> dict[int, int]:
        """Start new episodes in all environments, and return the seeds that were given, by environment.

        Args:
            seed: the seed of the first environment, which increases by one per environment; or one seed per
                environment, None for those that keep their generators.
            options: not supported.

        Raises `ValueError` for any options, or for a wrong number of seeds.
        """
        if options:
            raise ValueError(f"options={options!r}: expected none")
        given = _by_environment(seed, self.simulator.num_envs)
        self.simulator.reset(seeds=given)
        self._over = self.simulator.over
        self._metric_names = self.simulator.metric_names
        return given

    def _require_reset(self) -> None:
        if not self._metric_names:
            raise RuntimeError("call reset() before step()")

    def _step(self, actions: Ints) -> None:
        """Take one step with actions (B, N); environments whose episode was over are reset instead.

        After it, their agents have neither a reward nor an end. `_over` (B,) tells which episodes are over now.
        """
        simulator, was_over = self.simulator, self._over
        simulator.step(actions)
        if was_over.any():
            simulator.reset(np.flatnonzero(was_over).tolist())
        self._over = simulator.over

    def _metrics(self, over: Bools) -> dict[str, Floats]:
        """Return the metrics of the environments `over` (B,) by name, (B,) float64; 0 in the others."""
        metrics: dict[str, Floats] = {name: np.zeros(len(over)) for name in self._metric_names}
        for b in np.flatnonzero(over).tolist():
            for name, value in self.simulator.metrics(b).items():
                metrics[name][b] = value
        return metrics


def _by_environment(seed: Any, num_envs: int) -> dict[int, int]:
    """Return the seeds that are given, by environment; raises `ValueError` for anything but a number or B of them."""
    if seed is None:
        return {}
    if isinstance(seed, (int, np.integer)):
        check_whole("seed", seed, 0, MAX_SEED)
        return {b: int(seed) + b for b in range(num_envs)}
    if isinstance(seed, str) or not hasattr(seed, "__len__"):
        raise ValueError(f"seed={seed!r}: expected a whole number, 0 or more, or {num_envs} of them")
    if len(seed) != num_envs:
        raise ValueError(f"seed: expected {num_envs} seeds, got {len(seed)}")
    return {b: one for b, one in enumerate(seed) if one is not None}
