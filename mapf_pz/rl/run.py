"""A run is a folder: its configuration, its progress as CSV and as a picture, and its policy."""

from __future__ import annotations

import csv
from pathlib import Path

from torch import nn

from mapf_pz.rl.config import TrainConfig
from mapf_pz.rl.policy import save_policy

PROGRESS, CURVE = "progress.csv", "learning_curve.png"


class RunFolder:
    """Writes what a training run leaves behind."""

    def __init__(self, path: Path) -> None:
        """Make the folder; what an earlier run left there is replaced file by file."""
        self.path = path
        path.mkdir(parents=True, exist_ok=True)
        self._rows: list[dict[str, float]] = []

    def log(self, row: dict[str, float]) -> None:
        """Append one row to the progress file; all rows have the same keys."""
        begins = not self._rows
        self._rows.append(row)
        with (self.path / PROGRESS).open("w" if begins else "a", newline="") as file:
            writer = csv.DictWriter(file, list(row))
            if begins:
                writer.writeheader()
            writer.writerow({key: f"{value:.6g}" for key, value in row.items()})

    def finish(self, network: nn.Module, config: TrainConfig) -> None:
        """Write the policy, its configuration and the learning curve."""
        save_policy(self.path, network, config)
        if self._rows:
            self._draw_curve()

    def _draw_curve(self) -> None:
        from matplotlib.figure import Figure

        figure = Figure(figsize=(7, 4), layout="constrained")
        rates = figure.add_subplot()
        steps = [row["agent_steps"] / 1e6 for row in self._rows]
        for key, label in (("CSR", "all agents at their goals (CSR)"), ("ISR", "agents at their goals (ISR)")):
            rates.plot(steps, [row[key] for row in self._rows], label=label)
        returns = rates.twinx()
        returns.plot(steps, [row["return"] for row in self._rows], color="0.7", zorder=0)
        returns.set_ylabel("return of an agent's episode", color="0.5")
        rates.set(xlabel="million agent steps", ylabel="share of training episodes", ylim=(0, 1.02))
        rates.legend(loc="lower right")
        figure.savefig(self.path / CURVE, dpi=150)
