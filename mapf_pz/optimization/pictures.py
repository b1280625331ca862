"""Pictures of an optimization: the best graph, and the course of the search."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from mapf_pz._internal.atomic import replacing
from mapf_pz.guidance import GuidanceGraph
from mapf_pz.instances.instance import Grid
from mapf_pz.optimization.search import Progress
from mapf_pz.render.guidance import save_guidance_picture

GRAPH_PICTURE, CURVE_PICTURE = "guidance.png", "curve.png"


def save_pictures(folder: Path, graph: GuidanceGraph, grid: Grid, history: Sequence[Progress]) -> None:
    """Draw the graph and the history, those for which the packages are installed."""
    if find_spec("PIL") is not None:
        save_guidance_picture(graph, grid, folder / GRAPH_PICTURE)
    if find_spec("matplotlib") is not None:
        _draw_curve(history, folder / CURVE_PICTURE)


def _draw_curve(history: Sequence[Progress], file: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.5, 3.4), layout="constrained")
    panel = figure.subplots()
    seconds = [row.seconds for row in history]
    panel.plot(seconds, [row.latest for row in history], ".", markersize=3, alpha=0.5, label="latest simulations")
    panel.plot(seconds, [row.best for row in history], label="best candidate")
    panel.set(xlabel="seconds", ylabel="mean score")
    panel.legend()
    with replacing(file) as temporary:
        figure.savefig(temporary, dpi=110)
