"""Copies of observations and batches to the device of the networks."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase


def to_device(tensors: TensorDictBase, device: torch.device) -> TensorDictBase:
    """Return tensors on a device; to a GPU, they are copied from pinned memory, and this process does not wait for it.

    Work that is started afterward on the GPU waits for the copy. Tensors that are on the device already are not copied.
    """
    if device.type != "cuda" or tensors.device is None or tensors.device.type != "cpu":
        return tensors.to(device)
    return tensors.pin_memory(num_threads=0).to(device, non_blocking=True)
