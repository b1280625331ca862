"""Demonstrations of planners: datasets for imitation learning and offline reinforcement learning."""

from mapf_pz.rl.demonstrations.config import DatasetConfig
from mapf_pz.rl.demonstrations.dataset import Batch, Dataset, load_dataset
from mapf_pz.rl.demonstrations.demonstration import Demonstration, demonstrate
from mapf_pz.rl.demonstrations.make import make_dataset

__all__ = ["Batch", "Dataset", "DatasetConfig", "Demonstration", "demonstrate", "load_dataset", "make_dataset"]
