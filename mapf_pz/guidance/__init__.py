"""Guidance graphs: the costs of leaving a cell in each direction, and of waiting or turning there."""

from mapf_pz.guidance.graph import GuidanceGraph, open_edges

__all__ = ["GuidanceGraph", "open_edges"]
