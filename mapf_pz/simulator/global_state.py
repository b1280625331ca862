"""The global state of environments as planes, for centralized critics: PettingZoo's `state()`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapf_pz.simulator.simulator import Simulator

STATE_PLANES = ("obstacle", "agent", "heading_sine", "heading_cosine", "goal", "cost_to_go", "time")
"""What each plane shows."""


def global_state(simulator: Simulator) -> NDArray[np.float32]:
    """Return the maps of all environments as planes (B, 7, H, W) float32 in [-1, 1], named by `STATE_PLANES`.

    The cost to go is written to the agent's cell, in units of `(H + W) * mean weight`, at most 1.
    """
    height, width = simulator.shape
    envs = range(simulator.num_envs)
    planes = np.zeros((len(envs), len(STATE_PLANES), height, width), np.float32)
    flat = planes.reshape(*planes.shape[:2], -1)
    b, i = np.nonzero(simulator.agents["active"])
    agents = simulator.agents[b, i]
    cells, angles = agents["cell"], agents["heading"] * (np.pi / 2)
    scale = (height + width) * np.array([simulator.mean_weight(each) for each in envs])
    planes[:, 0] = [~simulator.grid(each).free for each in envs]
    flat[b, 1, cells] = 1
    flat[b, 2, cells] = np.sin(angles)
    flat[b, 3, cells] = np.cos(angles)
    flat[b, 4, agents["goal"]] = 1
    flat[b, 5, cells] = np.minimum(simulator.cost_to_go()[b, i] / scale[b], 1)
    flat[:, 6] = np.minimum(simulator.steps / simulator.config.max_steps, 1)[:, None]
    return planes
