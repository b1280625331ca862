"""The global state of an environment as planes, for centralized critics: PettingZoo's `state()`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapf_pz.simulator import Simulator

STATE_PLANES = ("obstacle", "agent", "heading_sine", "heading_cosine", "goal", "cost_to_go", "time")
"""What each plane shows."""


def global_state(simulator: Simulator, b: int) -> NDArray[np.float32]:
    """Return the map of environment `b` as planes (7, H, W) float32 in [-1, 1], named by `STATE_PLANES`.

    The cost to go is written to the agent's cell, in units of `(H + W) * mean weight`, at most 1.
    """
    height, width = simulator.shape
    planes = np.zeros((len(STATE_PLANES), height, width), np.float32)
    flat = planes.reshape(len(STATE_PLANES), -1)
    active = simulator.agents["active"][b]
    agents = simulator.agents[b][active]
    cells, angles = agents["cell"], agents["heading"] * (np.pi / 2)
    scale = (height + width) * simulator.mean_weight(b)
    planes[0] = ~simulator.grid(b).free
    flat[1, cells] = 1
    flat[2, cells] = np.sin(angles)
    flat[3, cells] = np.cos(angles)
    flat[4, agents["goal"]] = 1
    flat[5, cells] = np.minimum(simulator.cost_to_go(b)[active] / scale, 1)
    flat[6] = min(simulator.steps[b] / simulator.config.max_steps, 1)
    return planes
