"""Training with TorchRL: the batched environment, networks, algorithms and the loop. Needs the extra `train`.

Configurations and presets can be imported without loading torch.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mapf_pz._internal.lazy import lazy_attributes

if TYPE_CHECKING:
    from mapf_pz.rl.environments.batched_env import BatchedMapfEnv
    from mapf_pz.rl.policies.policy import LearnedPolicy, load_policy, policy_names
    from mapf_pz.rl.training.train import resume, train

_HOMES = {
    "BatchedMapfEnv": "batched_env",
    "LearnedPolicy": "policy",
    "load_policy": "policy",
    "policy_names": "policy",
    "resume": "training",
    "train": "training",
}

__all__ = ["BatchedMapfEnv", "LearnedPolicy", "load_policy", "policy_names", "resume", "train"]

__getattr__ = lazy_attributes(__name__, _HOMES)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
