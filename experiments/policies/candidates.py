"""Search for better settings of `oneshot-cardinal` by successive halving: `python -m experiments.policies.candidates`.

Candidates differ from the preset in one thing. All are trained for a short time, the better half again for twice as
long, and so on. They learn and are evaluated without the safety layer, on maps that no policy learns on.
`docs/results/candidates.csv` gets the results, whose runs are not repeated, `docs/results/candidate-curves.csv` the
progress of the trainings, and `docs/explanation/imitation.md` the table.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from experiments.pages import key_of, read_rows, spread, write_rows, write_table
from experiments.policies import imitation
from experiments.report.published import folder
from experiments.report.reproduction import Variation
from experiments.tables.results import FILES
from mapf_pz.rl.presets import PRESETS
from mapf_pz.rl.progress import read_progress

PRESET = "oneshot-cardinal"
RESULTS, CURVES, PAGE = FILES / "candidates.csv", FILES / "candidate-curves.csv", imitation.PAGE
KEY = ("candidate", "seed", "agent_steps")
"""Columns that determine a run."""
PROGRESS = ("loss", "agreement", "validation_CSR")
"""What is kept of the progress of a training."""


def candidates() -> Iterator[Variation]:
    """Yield the preset and what differs from it in one thing."""
    base = Variation("preset", PRESETS[PRESET])
    yield base
    yield base.with_("not augmented", imitation={"augment": False})
    yield base.with_("half the gradient steps", optimization={"num_epochs": 1})
    yield base.with_("maps of up to 21 x 21 cells", task={"mixture": imitation.small_maps(base.config.task.mixture)})
    yield base.with_("64 agents", env={"num_agents": 64})
    yield base.with_("expert works a third as long", imitation={"expert": "lacam:time_limit=0.033,clock=work"})
    yield base.with_("plans for 8 steps", imitation={"segment_steps": 8})
    yield base.with_("three rounds", model={"communication": 3})
    yield base.with_("view 11 x 11", env={"view_size": (11, 11)})
    yield base.with_("wider layers", model={"hidden": 256, "head": (256,)})


@dataclass(frozen=True)
class Options:
    """Options of the search."""

    output: Path = Path("runs/candidates")
    """Folder of all runs."""
    candidates: tuple[str, ...] = tuple(candidate.name for candidate in candidates())
    """Names of candidates."""
    lengths: tuple[int, ...] = (1_500_000, 3_000_000)
    """Agent steps of a training in each round."""
    seed: int = 0
    """Random seed."""
    episodes: int = 64
    """Number of episodes on each set with each number of agents."""


def main(options: Options) -> None:
    """Train and evaluate the missing runs in sequence; write the results after each, and the table at the end."""
    found = read_rows(RESULTS)
    alive = [candidate for candidate in candidates() if candidate.name in options.candidates]
    for agent_steps in options.lengths:
        of_round = (str(options.seed), str(agent_steps))
        for candidate in alive:
            key = (candidate.name, *of_round)
            if key not in [key_of(row, KEY) for row in found]:
                run = folder(options.output, f"{candidate.name}-{agent_steps}", options.seed)
                measured = imitation.trained(candidate.config, options.seed, agent_steps, run)
                measured |= imitation.measured(PRESET, [str(run)], run, options.episodes)
                of_run = dict(zip(KEY, key, strict=True))
                found.append(of_run | measured)
                write_rows(RESULTS, found)
                write_rows(CURVES, [*read_rows(CURVES), *(of_run | row for row in curve(run))])
        alive = better_half(alive, [row for row in found if key_of(row, KEY[1:]) == of_round])
    write()


def curve(run: Path) -> Iterator[dict[str, str]]:
    """Yield a run's progress: agent steps so far, hours, and `PROGRESS`; updates without a validation lack its CSR."""
    for row in read_progress(run):
        so_far = {"agent_steps_so_far": f"{row['agent_steps']:.0f}", "hours": f"{row['seconds'] / 3600:.3f}"}
        yield so_far | {name: "" if math.isnan(row[name]) else f"{row[name]:.3f}" for name in PROGRESS}


def score(row: Mapping[str, str]) -> float:
    """Return the mean over all sets and numbers of agents."""
    return float(np.mean([float(row[column]) for column in imitation.measures()]))


def better_half(alive: Sequence[Variation], rows: Sequence[Mapping[str, str]]) -> list[Variation]:
    """Return the better half of the candidates, those of the highest scores, in their order."""
    scores = {row["candidate"]: score(row) for row in rows}
    best = sorted(alive, key=lambda candidate: -scores[candidate.name])[: -(-len(alive) // 2)]
    return [candidate for candidate in alive if candidate in best]


def write() -> None:
    """Write the table."""
    write_table(PAGE, "candidates", table(read_rows(RESULTS)))


def table(rows: Sequence[Mapping[str, str]]) -> Iterator[str]:
    """Yield the results as Markdown: a row for each candidate and length, of each length the best first.

    Cells have the mean over seeds, in brackets the smallest and the largest.
    """
    measures = imitation.measures()
    yield f"| candidate | seeds | million agent steps | hours | {' | '.join(measures)} | mean |"
    yield f"| {' | '.join(['---'] * (5 + len(measures)))} |"
    groups: dict[tuple[int, str], list[Mapping[str, str]]] = {}
    for row in rows:
        groups.setdefault((int(row["agent_steps"]), row["candidate"]), []).append(row)
    scores = {group: [score(row) for row in runs] for group, runs in groups.items()}
    for group in sorted(groups, key=lambda group: (group[0], -np.mean(scores[group]))):
        (steps, name), runs = group, groups[group]
        cells = [spread([float(row[column]) for row in runs], 2) for column in ("hours", *measures)]
        mean = spread(scores[group], 3)
        yield f"| {name} | {len(runs)} | {steps / 1e6:g} | {' | '.join(cells)} | {mean} |"


if __name__ == "__main__":
    main(tyro.cli(Options))
