"""The configuration of a batch of environments."""

from __future__ import annotations

from dataclasses import dataclass

from mapf_pz.simulator.config import EnvConfig


@dataclass(frozen=True)
class BatchConfig(EnvConfig):
    """Keywords of all environments that step a batch: the fields of `EnvConfig`, and the size of the batch."""

    num_envs: int = 1
    """Number of environments B."""
    num_threads: int = 1
    """Number of threads of the kernels."""
