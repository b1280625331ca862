"""Training with TorchRL: the batched environment, networks, algorithms and the loop. Needs the extra `train`."""

from mapf_pz.rl.batched_env import BatchedMapfEnv
from mapf_pz.rl.policy import LearnedPolicy, load_policy, policy_names
from mapf_pz.rl.train import resume, train

__all__ = ["BatchedMapfEnv", "LearnedPolicy", "load_policy", "policy_names", "resume", "train"]
