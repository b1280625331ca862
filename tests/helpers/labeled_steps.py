"""Batches that algorithms of imitation learn from."""

import torch
from tensordict import TensorDict


def labeled_steps(labels, image, features):
    """A batch of S environment steps of N agents, with the expert's actions (S, N)."""
    size = labels.shape
    agents = {
        "observation": TensorDict({"image": image, "features": features}, batch_size=size),
        "expert_action": labels,
        "at_goal": torch.zeros(*size, 1, dtype=torch.bool),
        "active": torch.ones(*size, 1, dtype=torch.bool),
        "logits": torch.zeros(*size, 4),
    }
    return TensorDict({"agents": TensorDict(agents, batch_size=size)}, batch_size=size[:1])
