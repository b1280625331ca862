from .environments.batched_env import BatchedMapfEnv as BatchedMapfEnv
from .policies.folder import policy_names as policy_names
from .policies.load import load_policy as load_policy
from .policies.policy import LearnedPolicy as LearnedPolicy
from .training.train import resume as resume
from .training.train import train as train
