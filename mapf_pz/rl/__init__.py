"""Training with TorchRL: the batched environment, networks, algorithms, the training loop and trained policies.

It imports neither the environment nor the wrappers. Read `training/train.py` first. Needs the extra `train`;
configurations and presets can be imported without loading torch.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mapf_pz._internal.lazy import lazy_attributes

if TYPE_CHECKING:
    from mapf_pz.rl.environments.batched_env import BatchedMapfEnv
    from mapf_pz.rl.policies.folder import policy_names
    from mapf_pz.rl.policies.load import load_policy
    from mapf_pz.rl.policies.policy import LearnedPolicy
    from mapf_pz.rl.training.train import resume, train

_HOMES = {
    "BatchedMapfEnv": "environments.batched_env",
    "LearnedPolicy": "policies.policy",
    "load_policy": "policies.load",
    "policy_names": "policies.folder",
    "resume": "training.train",
    "train": "training.train",
}

__all__ = ["BatchedMapfEnv", "LearnedPolicy", "load_policy", "policy_names", "resume", "train"]

__getattr__ = lazy_attributes(__name__, _HOMES)


def __dir__() -> list[str]:
    return sorted(__all__)
