"""The configuration of an optimization of a guidance graph."""

from __future__ import annotations

from dataclasses import dataclass, field

from mapf_pz._internal.config import Natural, Positive, checked
from mapf_pz._internal.machine import usable_cores
from mapf_pz.optimization.task import GuidanceTask


@checked
@dataclass(frozen=True, kw_only=True)
class OptimizeConfig:
    """An optimization."""

    task: GuidanceTask = field(default_factory=GuidanceTask)
    """The planner or policy, and its episodes."""
    minutes: Positive = 10.0
    """Time budget in minutes, the final selection included."""
    seed: Natural = 0
    """Random seed. The result also depends on the speed of the machine."""
    jobs: int | str = field(default_factory=usable_cores)
    """Number of processes; `ray`: run on a Ray cluster. Default: one for each core."""
