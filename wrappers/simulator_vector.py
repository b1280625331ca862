"""`SimulatorVectorEnv`: what the Gymnasium vector environments of this package share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import ArrayLike, NDArray

from mapf_pz._internal.arrays import Bools, Floats, Ints
from mapf_pz._internal.config import UNCHECKED, checked
from mapf_pz.render.rgb import Canvas, Picture
from mapf_pz.render.state import RenderState
from mapf_pz.simulator.config import BatchConfig, EnvConfig, check_whole
from mapf_pz.simulator.seeds import MAX_SEED
from mapf_pz.simulator.simulator import Simulator

VectorInfos = dict[str, Any]
VectorObservation = NDArray[np.float32] | dict[str, NDArray[np.float32]]
_AUTORESET_MODES = {mode.value: mode for mode in (AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP)}


@checked
@dataclass(frozen=True)
class VectorConfig(BatchConfig):
    """The keywords that all vector environments have."""

    autoreset_mode: Annotated[AutoresetMode | Literal["NextStep", "SameStep"], UNCHECKED] = AutoresetMode.NEXT_STEP
    """When an episode that is over is reset: by the next step, which ignores the actions, or by the same one."""


class SimulatorVectorEnv(VectorEnv[VectorObservation, ArrayLike, NDArray[Any]]):
    """The B environments of one simulator: their seeds, resets and metrics.

    Environment `b` of a batch with the seed `s` equals a single environment with the seed `s + b`.
    """

    def __init__(self, config: VectorConfig) -> None:
        """Create the simulator.

        Raises as it does, and `ValueError` for a render mode other than `rgb_array` or another autoreset mode.
        """
        if config.render_mode not in (None, "rgb_array"):
            raise ValueError(
                f"render_mode={config.render_mode!r}: expected None or 'rgb_array' for several environments"
            )
        self.render_mode = config.render_mode
        self.simulator = Simulator(EnvConfig(**config.keywords()), config.num_envs, config.num_threads)
        mode = _autoreset_mode(config.autoreset_mode)
        self._same_step = mode is AutoresetMode.SAME_STEP
        self.metadata = {"autoreset_mode": mode, "render_modes": ["rgb_array"], "render_fps": 4}
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
        state = RenderState(simulator.positions(b), headings, simulator.goals(b), agents["active"], agents["delayed"])
        return self._canvases[b].draw(*state)

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

    def _checked(self, actions: ArrayLike, shape: tuple[int, ...]) -> Ints:
        """Return the actions as (B, N) int64; raises `ValueError` for wrong ones, or another shape."""
        numbers, last = np.asarray(actions), self.simulator.num_actions - 1
        if numbers.shape != shape or numbers.dtype.kind not in "iu":
            got = f"{numbers.dtype} of shape {numbers.shape}"
            raise ValueError(f"actions: expected integers of shape {shape}, got {got}")
        numbers = np.ascontiguousarray(numbers, np.int64)
        if numbers.view(np.uint64).max() > last:  # negative numbers are large ones then
            raise ValueError(f"actions: expected numbers from 0 to {last}, got {numbers.min()} to {numbers.max()}")
        return numbers.reshape(self.simulator.agents.shape)

    def _reset_over(self) -> None:
        """Reset the environments whose episodes are over, in the same step."""
        self.simulator.reset(np.flatnonzero(self._over).tolist())
        self._over = np.zeros_like(self._over)

    def _metrics(self, over: Bools) -> dict[str, Floats]:
        """Return the metrics of the environments `over` (B,) by name, (B,) float64; 0 in the others."""
        metrics: dict[str, Floats] = {name: np.zeros(len(over)) for name in self._metric_names}
        for b in np.flatnonzero(over).tolist():
            for name, value in self.simulator.metrics(b).items():
                metrics[name][b] = value
        return metrics


def final_infos(rows: VectorObservation, ended: Bools, infos: VectorInfos) -> VectorInfos:
    """Return the last observations and infos of the environments that have `ended`, each with a mask."""
    final = np.full(len(ended), None, dtype=object)
    for i in np.flatnonzero(ended).tolist():
        final[i] = _row(rows, i)
    return {"final_obs": final, "_final_obs": ended, "final_info": infos, "_final_info": ended}


def _row(rows: VectorObservation, i: int) -> VectorObservation:
    """Return a copy of one environment's observation."""
    return {name: part[i].copy() for name, part in rows.items()} if isinstance(rows, dict) else rows[i].copy()


def _autoreset_mode(given: Any) -> AutoresetMode:
    """Return the mode that is meant; raises `ValueError` for another one."""
    mode = _AUTORESET_MODES.get(given.value if isinstance(given, AutoresetMode) else given)
    if mode is None:
        raise ValueError(f"autoreset_mode={given!r}: expected one of {', '.join(map(repr, _AUTORESET_MODES))}")
    return mode


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
