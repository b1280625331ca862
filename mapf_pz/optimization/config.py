"""The configuration of an optimization of a guidance graph."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, get_args

from mapf_pz._internal.machine import usable_cores
from mapf_pz.optimization.task import GuidanceTask

Method = Literal["evolution", "piu"]
"""The methods of optimization."""


@dataclass(frozen=True, kw_only=True)
class OptimizeConfig:
    """An optimization. Raises `ValueError` for an unknown method or a number that is too small."""

    task: GuidanceTask = field(default_factory=GuidanceTask)
    """The planner or policy, and its episodes."""
    method: Method = "evolution"
    """`evolution`: a population of graphs; `piu`: a small model that updates weights, which transfers to other maps."""
    minutes: float = 10.0
    """Time budget in minutes, the final selection included."""
    seed: int = 0
    """Random seed. The result also depends on the speed of the machine."""
    jobs: int | str = field(default_factory=usable_cores)
    """Number of processes; `ray`: run on a Ray cluster. Default: one for each core."""
    model: Path | None = None
    """With `piu`: a trained model to start from, `model.npz` of another optimization."""

    def __post_init__(self) -> None:
        """Check the fields."""
        if self.minutes <= 0:
            raise ValueError(f"minutes={self.minutes}: expected more than 0")
        if self.method not in get_args(Method):
            raise ValueError(f"method {self.method!r}: expected {' or '.join(get_args(Method))}")
        if self.model is not None and self.method != "piu":
            raise ValueError("model: expected only with the method 'piu'")
