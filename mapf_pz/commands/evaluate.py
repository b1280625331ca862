"""The command `mapf-pz evaluate`: how policies and planners do on instances that they never saw."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any, Literal

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from tyro.conf import UseAppendAction

from mapf_pz.config import ActionModel
from mapf_pz.evaluate import Episode, Trial, evaluate, load_suite, markdown_table, named_policy, terminal_table
from mapf_pz.evaluate.policies import is_trained
from mapf_pz.evaluate.run import Casting, Policy
from mapf_pz.files import write_whole
from mapf_pz.interrupts import interruptible

TABLE_FILE = "evaluation.md"


@dataclass(frozen=True)
class EvaluateOptions:
    """Who is tried, and on what: suites, or one map."""

    policy: Annotated[tuple[str, ...], UseAppendAction]
    """Once or more: `random`; a planner (`pibt`, `epibt:depth=5,time_limit=0.1`); a trained policy, by its name if it
    comes with the package or by its run's folder; that with `+pibt` after it: carried out by PIBT."""
    suite: Annotated[tuple[str, ...], UseAppendAction] = ()
    """Once or more: the name of a suite, or the path of a suite's file; `standard` where neither is given nor a map."""
    map: str | None = None
    """In place of suites: a map's name or the path of a `.map` file."""
    scenario: str | None = None
    """The path of a `.scen` file for that map; None draws starts and goals."""
    num_agents: int = 10
    """The number of agents on that map."""
    max_steps: int = 512
    """Time limit on that map."""
    action_model: ActionModel | None = None
    """Whether agents turn and drive or step in four directions; None: as the suite or the policy has it."""
    episodes: int | None = None
    """How many episodes of each trial; None: as the suite has it, 64 on a map."""
    seed: int | None = None
    """Of the first episode; None: as the suite has it."""
    policy_seed: int = 0
    """Of the policies' draws."""
    deterministic: bool = False
    """Trained policies take the likeliest action."""
    distance_bytes: int | None = None
    """The most memory for cost-to-go tables of one process, in bytes; None: as the suite has it, or as much as is
    needed, up to half of the machine's."""
    jobs: int | Literal["ray"] = 1
    """How many processes; `ray`: as many as the Ray cluster has room for."""
    output: Path | None = None
    """A folder for all episodes as CSV, the table in Markdown, and figures; what it has already is not done again."""

    def trials(self) -> tuple[Trial, ...]:
        """Return the trials that were asked for."""
        if self.map is not None and self.suite:
            raise ValueError("expected either --suite or --map")
        if self.map is None and self.scenario is not None:
            raise ValueError("expected --map beside --scenario")
        if self.episodes is not None and self.episodes < 1:
            raise ValueError(f"episodes={self.episodes}: expected 1 or more")
        if self.seed is not None and self.seed < 0:
            raise ValueError(f"seed={self.seed}: expected 0 or more")
        if self.map is None:
            trials = [trial for suite in self.suite or ("standard",) for trial in load_suite(suite)]
        else:
            trials = [self._on_map(self.map)]
        given = {"action_model": self.action_model, "distance_bytes": self.distance_bytes}
        keywords = {name: value for name, value in given.items() if value is not None}
        return tuple(
            trial.but(keywords=trial.keywords | keywords, episodes=self.episodes, seed=self.seed) for trial in trials
        )

    def label(self, policy: str) -> str:
        """Return what a policy is called in the results: it must tell apart what acts differently."""
        seed = f", seed {self.policy_seed}" if self.policy_seed else ""
        return policy + seed + (", deterministic" if self.deterministic and is_trained(policy) else "")

    def _on_map(self, map: str) -> Trial:
        keywords: dict[str, Any] = {"map": map, "max_steps": self.max_steps}
        about = Path(map).stem
        if self.scenario is not None:
            keywords["scenario"] = self.scenario
            about += f", {Path(self.scenario).name}"
        return Trial(about, self.num_agents, keywords, episodes=64)


def evaluate_policies(options: EvaluateOptions) -> None:
    """Let policies and planners act in the same episodes, and print the table of results."""
    if not options.policy:
        raise ValueError("expected --policy, once or more")
    # Networks this small take several times as long on two threads; torch, which is not loaded yet, reads this.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    castings: dict[str, Casting | Policy | str] = {
        options.label(name): named_policy(name, options.policy_seed, options.deterministic) for name in options.policy
    }
    report(castings, options.trials(), options.output, options.jobs)


def report(
    policies: dict[str, Casting | Policy | str], trials: Sequence[Trial], output: Path | None, jobs: int | str = 1
) -> None:
    """Evaluate, print the table, and write it and the figures to `output` if there is one."""
    with interruptible() as check, _progress_bar(check) as show:
        episodes = evaluate(policies, trials, output, jobs, show)
    Console(file=sys.stdout, width=None if sys.stdout.isatty() else 200).print(terminal_table(episodes))
    if output is None:
        return
    write_whole(output / TABLE_FILE, markdown_table(episodes).encode())
    print(f"table and episodes written to {output}")
    if find_spec("matplotlib") is None:
        print("no figures: pip install 'mapf-pz[train]' has what draws them")
        return
    from mapf_pz.evaluate.figures import draw_figures

    for file in draw_figures(episodes, output):
        print(f"figure written to {file}")


@contextmanager
def _progress_bar(check: Callable[[], None]) -> Generator[Callable[[Episode | None, int], None]]:
    """Show a bar; yield what moves it, and calls `check`."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("evaluating", total=None)

        def show(episode: Episode | None, left: int) -> None:
            check()
            if episode is None:
                bar.update(task, total=left)
            else:
                about = f"{episode.policy}, {episode.num_agents} agents on {episode.about}"
                bar.update(task, advance=1, description=about)

        yield show
