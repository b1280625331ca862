"""The channels of the image: each declares its planes and bounds, and the function that draws it.

Channels that show the map and the agents on it are copied from the map's layers (`layers.py`); the other built-in ones
are looked up (`draw.py`). A user's channel is a `Channel` with a function that draws it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Literal, NamedTuple

from mapf_pz._internal.config import Count, checked
from mapf_pz._internal.jit import Array
from mapf_pz._internal.plugins import resolve
from mapf_pz.instances.heading import Heading
from mapf_pz.simulator.kernels.observation.draw import LookupPlanes
from mapf_pz.simulator.kernels.observation.inputs import ObservationInputs
from mapf_pz.simulator.kernels.observation.layers import EDGES, GOAL, HEADING, OCCUPANCY

DrawChannel = Callable[[ObservationInputs, Array, int], None]
ChannelSymmetry = Literal["cells", "directions", "headings"]


@checked
@dataclass(frozen=True)
class Channel:
    """One channel of the image."""

    draw: DrawChannel | None = None
    """`draw(inputs, image, plane)` writes to all agents' `image` (B, N, K, h, w) float32 from plane number `plane` on.

    It writes every cell of its planes: they are not cleared before. None: the channel is built in.
    """
    planes: Count = 1
    """How many planes of the image it takes."""
    low: float = 0
    """The least value."""
    high: float = 1
    """The largest value."""
    needs_cost_to_go: bool = False
    """Whether `draw` reads the cost to go, which is then computed before; without it, reading is an error."""
    symmetry: ChannelSymmetry | None = None
    """What becomes of it in a state that is turned or mirrored, for `augment`: the cells change places (`cells`), and
    so do four planes for the directions up, right, down, left of the view, which are east, south, west, north in the
    map's frame (`directions`), or the values `(1 + k) / 4` for these directions k, 0 for none (`headings`). None: it is
    not known."""
    layer: int | None = None
    """The layer of the map that it shows, for built-in channels that show one."""
    lookup: str = ""
    """Its field of `LookupPlanes`, for built-in channels that are looked up."""

    def __post_init__(self) -> None:
        """Raise `ValueError` for a symmetry that it does not have with its planes or bounds."""
        if self.symmetry == "directions" and self.planes != len(Heading):
            raise ValueError(f"symmetry='directions': expected planes={len(Heading)}, got {self.planes}")
        if self.symmetry == "headings" and not 0 <= self.low <= self.high <= 1:
            raise ValueError(f"symmetry='headings': expected bounds from 0 to 1, got {self.low:g} and {self.high:g}")


CHANNELS: dict[str, Channel] = {
    # 0 free, 0.5 another agent, 1 obstacle or outside, -1 hidden
    "view": Channel(layer=OCCUPANCY, low=-1, symmetry="cells"),
    # 1 on the agent's own goal
    "goal": Channel(layer=GOAL, symmetry="cells"),
    # on each agent in view, including the observer, (1 + k) / 4 with k its heading
    "orientation": Channel(layer=HEADING, symmetry="headings"),
    # weight of leaving each cell in four directions, divided by the largest; blocked -1, outside 0
    "edge_weights": Channel(layer=EDGES, planes=4, low=-1, symmetry="directions"),
    # how much closer to the goal each cell is
    "cost_to_go": Channel(lookup="cost_to_go", low=-1, needs_cost_to_go=True, symmetry="cells"),
    # 1 where leaving the cell in each of four directions leads closer to the goal
    "heuristic": Channel(lookup="heuristic", planes=4, needs_cost_to_go=True, symmetry="directions"),
    # 1 on the goals of the other agents in view
    "other_goals": Channel(lookup="other_goals", symmetry="cells"),
    # 1 on the cells that the other agents in view would enter next on their own cheapest paths; of equal paths,
    # it prefers one by its direction, which a mirror image does not know
    "others_next": Channel(lookup="others_next", needs_cost_to_go=True, symmetry="cells"),
    # on each other agent in view, 1 where a move in each of four directions leads closer to that agent's goal
    "others_heuristic": Channel(lookup="others_heuristic", planes=4, needs_cost_to_go=True, symmetry="directions"),
    # on each other agent in view 1 if it is on its goal, otherwise -1
    "others_at_goal": Channel(lookup="others_at_goal", low=-1, symmetry="cells"),
    # on each other agent in view 1 if it was delayed in the last step, otherwise -1
    "others_delayed": Channel(lookup="others_delayed", low=-1, symmetry="cells"),
}
"""The built-in channels by name."""


def channel_of(channel: str | Channel) -> Channel:
    """Return a channel that is given by name, as `package.module:name`, or as an object; raises `ValueError`."""
    return resolve("channels", channel, CHANNELS, Channel)


class LayerPlanes(NamedTuple):
    """The first plane in the image of each channel that shows a layer; -1: not drawn."""

    view_at: int
    goal_at: int
    orientation_at: int
    edges_at: int


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
    lookup_at = {channel.lookup: at for channel, at in placed}
    layer_at = {channel.layer: at for channel, at in placed}
    lookups = LookupPlanes(*(lookup_at.get(name, -1) for name in LookupPlanes._fields))
    layers = LayerPlanes(*(layer_at.get(layer, -1) for layer in (OCCUPANCY, GOAL, HEADING, EDGES)))
    return ImagePlanes(layers, lookups, users)
