"""Search for better settings of a preset by successive halving: `python -m experiments.policies.candidates`.

Candidates differ from `oneshot-cardinal-one-round` in one thing. All are trained for a short time, the better half
again for twice as long, and so on. They learn and are evaluated without the safety layer, on maps that no policy learns
on. `docs/results/candidates.csv` gets the results, whose runs are not repeated, `docs/results/candidate-curves.csv` the
progress of the trainings, and `docs/explanation/imitation.md` the table.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from experiments.pages import FILES, key_of, spread, write_table
from experiments.policies import imitation
from experiments.report.reproduction import Variation
from experiments.study import Study, StudyOptions, check_known, folder
from mapf_pz.rl.presets import PRESETS
from mapf_pz.rl.progress import read_progress

PRESET = "oneshot-cardinal-one-round"
PAGE = imitation.PAGE
KEY = ("candidate", "seed", "agent_steps")
"""Columns that determine a run."""
PROGRESS = ("loss", "agreement", "validation_CSR")
"""What is kept of the progress of a training."""
STUDY = Study(FILES / "candidates.csv", KEY, ("hours", *imitation.MEASURES))
CURVES = Study(FILES / "candidate-curves.csv", KEY, ("agent_steps_so_far", "hours", *PROGRESS))


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
class Options(StudyOptions):
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
    check_known("candidates", options.candidates, [candidate.name for candidate in candidates()])
    alive = [] if options.write else [each for each in candidates() if each.name in options.candidates]
    for agent_steps in options.lengths:
        learn(alive, agent_steps, options)
        of_round = (str(options.seed), str(agent_steps))
        alive = better_half(alive, [row for row in STUDY.rows() if key_of(row, KEY[1:]) == of_round])
    write()


def learn(alive: Sequence[Variation], agent_steps: int, options: Options) -> None:
    """Train and evaluate the missing runs of a round."""
    configs = {(candidate.name, options.seed, agent_steps): candidate.config for candidate in alive}
    for run in STUDY.missing(configs):
        where = folder(options.output, f"{run[0]}-{agent_steps}", options.seed)
        hours = imitation.trained(configs[run], options.seed, agent_steps, where)
        STUDY.add(run, hours | imitation.measured(PRESET, [str(where)], where, options.episodes))
        CURVES.add(run, *curve(where))


def curve(run: Path) -> Iterator[dict[str, str]]:
    """Yield a run's progress: agent steps so far, hours, and `PROGRESS`; updates without a validation lack its CSR."""
    for row in read_progress(run):
        so_far = {"agent_steps_so_far": f"{row['agent_steps']:.0f}", "hours": f"{row['seconds'] / 3600:.3f}"}
        yield so_far | {name: "" if math.isnan(row[name]) else f"{row[name]:.3f}" for name in PROGRESS}


def score(row: Mapping[str, str]) -> float:
    """Return the mean over all sets and numbers of agents."""
    return float(np.mean([float(row[column]) for column in imitation.MEASURES]))


def better_half(alive: Sequence[Variation], rows: Sequence[Mapping[str, str]]) -> list[Variation]:
    """Return the better half of the candidates, those of the highest scores, in their order."""
    scores = {row["candidate"]: score(row) for row in rows}
    best = sorted(alive, key=lambda candidate: -scores[candidate.name])[: -(-len(alive) // 2)]
    return [candidate for candidate in alive if candidate in best]


def write() -> None:
    """Write the table."""
    write_table(PAGE, "candidates", table(STUDY.rows()))


def table(rows: Sequence[Mapping[str, str]]) -> Iterator[str]:
    """Yield the results as Markdown: a row for each candidate and length, of each length the best first.

    Cells have the mean over seeds, in brackets the smallest and the largest.
    """
    measures = imitation.MEASURES
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
