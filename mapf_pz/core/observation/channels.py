"""The channels of the image: each declares its planes and bounds, and where they come from.

Some are origins of the layers (`core/observation/layers.py`); the others are drawn by a kernel each (`core/observation/draw.py`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mapf_pz.config import ChannelName
from mapf_pz.core.observation.layers import EDGES, HEADING, OCCUPANCY
from mapf_pz.core.state import Array


@dataclass(frozen=True)
class Channel:
    """What one channel adds to the image."""

    planes: int = 1
    shows: tuple[int, ...] = ()
    """The planes of the layers that it shows, if it is a window."""
    low: float = 0
    high: float = 1
    needs_distances: bool = False
    looks_up: bool = False
    """Whether cells in view are looked up one by one."""


CHANNELS: dict[ChannelName, Channel] = {
    # 0 free, 0.5 another agent, 1 obstacle or outside, -1 unseen
    "view": Channel(shows=(OCCUPANCY,), low=-1),
    # 1 on the agent's own goal
    "goal": Channel(),
    # on each agent in view, the observer among them, (1 + k) / 4 with k its heading
    "orientation": Channel(shows=(HEADING,)),
    # weight of leaving each cell in four directions over the largest; blocked -1, outside 0
    "edge_weights": Channel(planes=4, shows=EDGES, low=-1),
    # how much nearer to the goal each cell is
    "cost_to_go": Channel(low=-1, needs_distances=True, looks_up=True),
    # 1 where leaving the cell in each of four directions leads nearer to the goal
    "heuristic": Channel(planes=4, needs_distances=True, looks_up=True),
    # 1 on goals of the other agents in view
    "other_goals": Channel(looks_up=True),
    # 1 on cells that the other agents in view would draw_agents next along their own cheapest paths
    "others_next": Channel(needs_distances=True, looks_up=True),
    # on each other agent in view 1 if it is on its goal, else -1
    "others_at_goal": Channel(low=-1, looks_up=True),
}


class ChannelLayout(NamedTuple):
    """Where the channels are in the image: the number of each one's first plane; -1: it is not drawn."""

    shown: Array  # (W,) int64: the planes of the layers that channels show
    drawn: Array  # (W,) int64: the planes of the image that they are shown in
    look_up: bool  # whether there is any channel for which cells in view are looked up
    view_at: int = -1
    goal_at: int = -1
    orientation_at: int = -1
    edge_weights_at: int = -1
    cost_to_go_at: int = -1
    heuristic_at: int = -1
    other_goals_at: int = -1
    others_next_at: int = -1
    others_at_goal_at: int = -1


def channel_layout(names: Sequence[ChannelName]) -> ChannelLayout:
    """Return where these channels are in the image, one after the other."""
    at, shown, drawn = 0, [], []
    first: dict[str, int] = {}
    for name in names:
        channel = CHANNELS[name]
        first[f"{name}_at"] = at
        shown += channel.shows
        drawn += range(at, at + len(channel.shows))
        at += channel.planes
    look_up = any(CHANNELS[name].looks_up for name in names)
    return ChannelLayout(np.array(shown, np.int64), np.array(drawn, np.int64), look_up, **first)
