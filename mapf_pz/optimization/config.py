"""The configuration of an optimization of a guidance graph."""

from __future__ import annotations

from dataclasses import dataclass, field

from mapf_pz._internal.machine import usable_cores
from mapf_pz.optimization.task import GuidanceTask


@dataclass(frozen=True, kw_only=True)
class OptimizeConfig:
    """An optimization. Raises `ValueError` for a time budget that is not positive."""

    task: GuidanceTask = field(default_factory=GuidanceTask)
    """The planner or policy, and its episodes."""
    minutes: float = 10.0
    """Time budget in minutes, the final selection included."""
    seed: int = 0
    """Random seed. The result also depends on the speed of the machine."""
    jobs: int | str = field(default_factory=usable_cores)
    """Number of processes; `ray`: run on a Ray cluster. Default: one for each core."""

    def __post_init__(self) -> None:
        """Check the fields."""
        if self.minutes <= 0:
            raise ValueError(f"minutes={self.minutes}: expected more than 0")
