"""The command `mapf-pz plot`: draw the learning curves of training runs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from mapf_pz.rl.training.curves import Run, draw_curves


@dataclass(frozen=True)
class PlotOptions:
    """Options of `mapf-pz plot`: training runs, and what is drawn of them."""

    runs: Positional[tuple[Path, ...]]
    """Folders of training runs. Runs that differ only in their seeds become one curve: the mean and the range."""
    columns: tuple[Literal["CSR", "ISR", "throughput", "agreement", "return"], ...] = ("CSR", "throughput", "agreement")
    """What to plot, one panel for each that the runs have."""
    output: Path = Path("learning_curves.png")
    """File of the figure, in a format that its name ends with: .png, .svg or .pdf."""


def plot(options: PlotOptions) -> None:
    """Draw the learning curves of training runs, over running means of episodes, and their validations."""
    if not options.runs:
        raise ValueError("runs: expected the folder of a training run or more")
    runs = [Run.read(folder) for folder in options.runs]
    draw_curves(runs, options.columns, options.output)
    print(f"learning curves of {len(runs)} run{'s' * (len(runs) > 1)} written to {options.output}")
