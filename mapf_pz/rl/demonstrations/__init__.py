"""Demonstrations of planners: datasets for imitation learning and offline reinforcement learning."""

from mapf_pz.rl.demonstrations.config import DatasetConfig
from mapf_pz.rl.demonstrations.dataset import Dataset, load_dataset
from mapf_pz.rl.demonstrations.demonstration import Demonstration, demonstrate
from mapf_pz.rl.demonstrations.make import make_dataset
from mapf_pz.rl.demonstrations.replay import Batch

__all__ = ["Batch", "Dataset", "DatasetConfig", "Demonstration", "demonstrate", "load_dataset", "make_dataset"]
