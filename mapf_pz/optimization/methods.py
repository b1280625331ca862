"""The methods of optimization by name."""

from __future__ import annotations

from collections.abc import Callable

from mapf_pz.optimization.cma_es import cma, cma_weights
from mapf_pz.optimization.evolution import evolution
from mapf_pz.optimization.feedback import feedback
from mapf_pz.optimization.flips import flips
from mapf_pz.optimization.search import Search
from mapf_pz.optimization.update_model import piu

METHODS: dict[str, Callable[[Search, float], object]] = {
    "evolution": evolution,
    "feedback": feedback,
    "cma": cma,
    "cma-weights": cma_weights,
    "piu": piu,
    "flips": flips,
}
"""Functions that improve the archive of a search until a share of its time budget is spent."""
