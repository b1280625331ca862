"""The channels of the image: each declares its planes and bounds, and the function that draws it.

Channels that show the map and the agents on it are copied from the map's layers (`layers.py`); the other built-in ones
are looked up (`draw.py`). A user's channel is a `Channel` with a function that draws it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import NamedTuple

import numpy as np

from mapf_pz.core.observation.draw import LookupPlanes
from mapf_pz.core.observation.inputs import ObservationInputs
from mapf_pz.core.observation.layers import EDGES, GOAL, HEADING, OCCUPANCY
from mapf_pz.core.state import Array
from mapf_pz.plugins import resolve

DrawChannel = Callable[[ObservationInputs, Array, int], None]


@dataclass(frozen=True)
class Channel:
    """One channel of the image."""

    draw: DrawChannel | None = None
    """`draw(inputs, image, plane)` writes to all agents' `image` (B, N, K, h, w) float32 from plane number `plane` on.

    It writes every cell of its planes: they are not cleared before. None: the channel is built in.
    """
    planes: int = 1
    """How many planes of the image it takes."""
    low: float = 0
    """The least value."""
    high: float = 1
    """The largest value."""
    needs_cost_to_go: bool = False
    """Whether `draw` reads the cost to go, which is then computed before."""
    layers: tuple[int, ...] = ()
    """The layers of the map that it shows, for built-in channels that show layers."""
    lookup: str = ""
    """Its field of `LookupPlanes`, for built-in channels that are looked up."""


CHANNELS: dict[str, Channel] = {
    # 0 free, 0.5 another agent, 1 obstacle or outside, -1 hidden
    "view": Channel(layers=(OCCUPANCY,), low=-1),
    # 1 on the agent's own goal
    "goal": Channel(layers=(GOAL,)),
    # on each agent in view, including the observer, (1 + k) / 4 with k its heading
    "orientation": Channel(layers=(HEADING,)),
    # weight of leaving each cell in four directions, divided by the largest; blocked -1, outside 0
    "edge_weights": Channel(layers=EDGES, planes=4, low=-1),
    # how much closer to the goal each cell is
    "cost_to_go": Channel(lookup="cost_to_go", low=-1, needs_cost_to_go=True),
    # 1 where leaving the cell in each of four directions leads closer to the goal
    "heuristic": Channel(lookup="heuristic", planes=4, needs_cost_to_go=True),
    # 1 on the goals of the other agents in view
    "other_goals": Channel(lookup="other_goals"),
    # 1 on the cells that the other agents in view would enter next on their own cheapest paths
    "others_next": Channel(lookup="others_next", needs_cost_to_go=True),
    # on each other agent in view, 1 where a move in each of four directions leads closer to that agent's goal
    "others_heuristic": Channel(lookup="others_heuristic", planes=4, needs_cost_to_go=True),
    # on each other agent in view 1 if it is on its goal, otherwise -1
    "others_at_goal": Channel(lookup="others_at_goal", low=-1),
}
"""The built-in channels by name."""


def channel_of(channel: str | Channel) -> Channel:
    """Return a channel that is given by name, as `package.module:name`, or as an object; raises `ValueError`."""
    return resolve("channels", channel, CHANNELS, Channel)


class LayerPlanes(NamedTuple):
    """Which layers are shown, and where in the image."""

    shown: Array  # (W,) int64: layers of the map
    drawn: Array  # (W,) int64: planes of the image
    view_at: int  # the plane of the channel `view`; -1: not drawn
    goal_at: int
    orientation_at: int


class ImagePlanes(NamedTuple):
    """Which planes of the image are drawn by what."""

    layers: LayerPlanes
    lookups: LookupPlanes
    users: tuple[tuple[DrawChannel, int], ...]  # functions and their first planes


def image_planes(channels: Sequence[Channel]) -> ImagePlanes:
    """Return what draws an image of all `channels`."""
    ends = list(accumulate(channel.planes for channel in channels))
    placed = [(channel, end - channel.planes) for channel, end in zip(channels, ends, strict=True)]
    users = tuple((channel.draw, at) for channel, at in placed if channel.draw is not None)
    first = {channel.lookup: at for channel, at in placed}
    lookups = LookupPlanes(*(first.get(name, -1) for name in LookupPlanes._fields))
    return ImagePlanes(_layer_planes(placed), lookups, users)


def _layer_planes(placed: Sequence[tuple[Channel, int]]) -> LayerPlanes:
    """Return where the channels that show layers are, given all channels and their first planes."""
    shown, drawn, first = [], [], {OCCUPANCY: -1, GOAL: -1, HEADING: -1}
    for channel, at in placed:
        if channel.layers and channel.layers != (GOAL,):
            shown += channel.layers
            drawn += range(at, at + len(channel.layers))
        if channel.layers:
            first[channel.layers[0]] = at
    planes = np.array(shown, np.int64), np.array(drawn, np.int64)
    return LayerPlanes(*planes, first[OCCUPANCY], first[GOAL], first[HEADING])
