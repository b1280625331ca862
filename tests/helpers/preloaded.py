"""What the processes that tests fork have from the start: torch, and the compiled kernels of a small environment."""

from mapf_pz.rl import BatchedMapfEnv
from tests.helpers.small_run import TINY

BatchedMapfEnv(1, **TINY.task.env_keywords()).rollout(1)
