"""The command `mapf-pz evaluate`: how a trained policy does on instances that it never saw."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import track

from mapf_pz.evaluate.report import Episodes, results_table, write_episodes
from mapf_pz.evaluate.run import Policy, Trial, run_episodes
from mapf_pz.evaluate.suites import SUITES
from mapf_pz.rl.policy import load_policy

EPISODES_FILE, TABLE_FILE = "episodes.csv", "evaluation.txt"


@dataclass(frozen=True)
class EvaluateOptions:
    """Which policy, and what it is tried on: a suite, or one map."""

    policy: str
    """The name of a policy that comes with the package, the folder of a training run, or the weights' file in it."""
    suite: str = "quickstart"
    """The name of a suite; not used where a map is given."""
    map: str | None = None
    """A map's name or the path of a `.map` file."""
    scenario: str | None = None
    """The path of a `.scen` file for that map; None draws starts and goals."""
    num_agents: int = 10
    """The number of agents on that map."""
    max_steps: int = 512
    """Time limit on that map."""
    episodes: int | None = None
    """How many episodes of each trial; None: as the suite has it, 64 on a map."""
    seed: int | None = None
    """Of the first episode; None: as the suite has it."""
    policy_seed: int = 0
    """Of the policy's draws."""
    deterministic: bool = False
    """Always take the likeliest action."""
    output: Path | None = None
    """A folder for the table and the episodes as CSV."""

    def trials(self) -> tuple[Trial, ...]:
        """Return the trials that were asked for; raises `ValueError` for an unknown suite."""
        changes = {name: getattr(self, name) for name in ("episodes", "seed") if getattr(self, name) is not None}
        if self.map is None:
            if self.suite not in SUITES:
                raise ValueError(f"suite {self.suite!r}: expected one of {', '.join(SUITES)}")
            return tuple(Trial(trial.name, trial.keywords, **_numbers(trial) | changes) for trial in SUITES[self.suite])
        keywords: dict[str, Any] = {"map": self.map, "num_agents": self.num_agents, "max_steps": self.max_steps}
        name = f"{self.num_agents} agents on {Path(self.map).stem}"
        if self.scenario is not None:
            keywords["scenario"] = self.scenario
            name += f", {Path(self.scenario).name}"
        return (Trial(name, keywords, **{"episodes": 64} | changes),)


def evaluate(options: EvaluateOptions) -> None:
    """Evaluate a trained policy and print the table of results."""
    policy = load_policy(options.policy, options.policy_seed, options.deterministic)
    evaluate_policy(policy, options.trials(), options.output)


def evaluate_policy(policy: Policy, trials: tuple[Trial, ...], output: Path | None) -> dict[str, Episodes]:
    """Run the trials, print the table, and write it and the episodes to `output` if there is one."""
    results: dict[str, Episodes] = {}
    progress = Console(stderr=True)
    for trial in trials:
        episodes = run_episodes(policy, trial)
        shown = track(
            episodes, trial.name, trial.episodes, console=progress, transient=True, disable=not progress.is_terminal
        )
        results[trial.name] = list(shown)
    table = results_table(results)
    console = Console(file=sys.stdout, width=None if sys.stdout.isatty() else 160)
    console.print(table)
    if output is not None:
        output.mkdir(parents=True, exist_ok=True)
        write_episodes(results, output / EPISODES_FILE)
        with (output / TABLE_FILE).open("w") as file:
            Console(file=file, width=160).print(table)
    return results


def _numbers(trial: Trial) -> dict[str, int]:
    return {"episodes": trial.episodes, "seed": trial.seed}
