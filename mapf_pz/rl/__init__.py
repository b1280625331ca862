"""TorchRL on the kernels: the batched environment, models, algorithms, training. Needs the extra `train`."""

from mapf_pz.rl.batched_env import BatchedMapfEnv
from mapf_pz.rl.policy import LearnedPolicy, load_policy, policy_names
from mapf_pz.rl.train import resume, train

__all__ = ["BatchedMapfEnv", "LearnedPolicy", "load_policy", "policy_names", "resume", "train"]
