"""Guidance graphs: the costs of leaving a cell in each direction, and of waiting or turning there.

It imports instances. Read `graph.py` first. `mapf_pz.optimization` optimizes graphs.
"""

from mapf_pz.guidance.edges import count_moves, open_edges
from mapf_pz.guidance.files import load_guidance, load_moves, save_guidance, save_moves
from mapf_pz.guidance.graph import GuidanceGraph
from mapf_pz.guidance.library import guidance_names

__all__ = [
    "GuidanceGraph",
    "count_moves",
    "guidance_names",
    "load_guidance",
    "load_moves",
    "open_edges",
    "save_guidance",
    "save_moves",
]
