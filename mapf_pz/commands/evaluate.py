"""The command `mapf-pz evaluate`: how policies and planners do on instances that they never saw."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from glob import glob, has_magic
from importlib.util import find_spec
from itertools import chain
from pathlib import Path
from typing import Annotated, Literal, TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from tyro.conf import UseAppendAction

from mapf_pz.config import ActionModel
from mapf_pz.evaluation import (
    Episode,
    EvaluationTask,
    evaluate,
    load_suite,
    markdown_table,
    policy_factory,
    terminal_table,
)
from mapf_pz.evaluation.policies import is_trained
from mapf_pz.evaluation.report import exhausted
from mapf_pz.evaluation.rollout import Policy, PolicyFactory
from mapf_pz.instance import Grid
from mapf_pz.instances import load_instance, load_map
from mapf_pz.interrupts import interruptible
from mapf_pz.io.atomic import write_whole

TABLE_FILE = "evaluation.md"
DEFAULT_AGENTS = 10
"""The number of agents on a map without scenarios."""

Value = TypeVar("Value")


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
    scenario: Annotated[tuple[tuple[str, ...], ...], UseAppendAction] = ()
    """Scenarios for that map, each played once: names, `.scen` files or patterns such as "tests/*.scen", several after
    one option or the option several times. Without any, starts and goals are generated."""
    num_agents: Annotated[tuple[tuple[int, ...], ...], UseAppendAction] = ()
    """The number of agents on that map, or several numbers to evaluate each of them. Default: all agents of the
    scenarios, or 10."""
    max_steps: int = 512
    """Time limit on that map."""
    action_model: ActionModel | None = None
    """Whether agents turn and drive or step in four directions; None: as the suite or the policy has it."""
    episodes: int | None = None
    """The number of episodes of each task, at most one for each scenario or instance. None: as the suite states, one
    for each scenario, or 64 if starts and goals are generated."""
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

    def tasks(self) -> tuple[EvaluationTask, ...]:
        """Return the tasks that were asked for."""
        if self.map is not None and self.suite:
            raise ValueError("expected either --suite or --map")
        if self.map is None and self.scenario:
            raise ValueError("expected --map beside --scenario")
        if self.episodes is not None and self.episodes < 1:
            raise ValueError(f"episodes={self.episodes}: expected 1 or more")
        if self.seed is not None and self.seed < 0:
            raise ValueError(f"seed={self.seed}: expected 0 or more")
        if self.map is None:
            tasks = [task for suite in self.suite or ("standard",) for task in load_suite(suite)]
        else:
            tasks = self._on_map(self.map)
        return tuple(map(self._overridden, tasks))

    def _overridden(self, task: EvaluationTask) -> EvaluationTask:
        """Return the task with the options that override its own."""
        if self.episodes is not None and task.instances and self.episodes > len(task.instances):
            instances = f"{task.label!r} has {len(task.instances)} instances"
            raise ValueError(f"episodes={self.episodes}: {instances}, expected at most one episode for each")
        given = {"action_model": self.action_model, "distance_bytes": self.distance_bytes}
        keywords = {name: value for name, value in given.items() if value is not None}
        return task.with_(keywords=task.keywords | keywords, episodes=self.episodes, seed=self.seed)

    def label(self, policy: str) -> str:
        """Return what a policy is called in the results: it must tell apart what acts differently."""
        seed = f", seed {self.policy_seed}" if self.policy_seed else ""
        return policy + seed + (", deterministic" if self.deterministic and is_trained(policy) else "")

    def _on_map(self, map: str) -> list[EvaluationTask]:
        """Return a task for each number of agents."""
        counts, names = _joined("num-agents", self.num_agents), _joined("scenario", self.scenario)
        if not names:
            keywords = {"map": map, "max_steps": self.max_steps}
            return [
                EvaluationTask(Path(map).stem, count, keywords, episodes=64) for count in counts or [DEFAULT_AGENTS]
            ]
        grid, files = load_map(map), _files(names)
        task_name = f"{grid.name}, {Path(files[0]).name if len(files) == 1 else f'{len(files)} scenarios'}"
        return [_on_scenarios(task_name, grid, files, count, self.max_steps) for count in counts or [None]]


def _joined(name: str, values: Sequence[Sequence[Value]]) -> list[Value]:
    """Return the values of an option that was given several times."""
    if not all(values):
        raise ValueError(f"--{name}: expected one value or more, got none")
    return list(dict.fromkeys(chain.from_iterable(values)))


def _files(names: Sequence[str]) -> list[str]:
    """Return the names of scenarios with the patterns among them replaced by the files that match, each only once."""
    files: list[str] = []
    for name in names:
        found = [name] if os.path.exists(name) or not has_magic(name) else sorted(glob(name))
        if not found:
            raise FileNotFoundError(f"--scenario {name}: no file matches this pattern")
        files += found
    return list(dict.fromkeys(files))


def _on_scenarios(
    task_name: str, grid: Grid, files: Sequence[str], num_agents: int | None, max_steps: int
) -> EvaluationTask:
    """Return a task with one episode for each scenario; the environment decides where agents look at the start."""
    instances = tuple(load_instance(grid, file, num_agents, action_model="cardinal") for file in files)
    return EvaluationTask(task_name, instances[0].num_agents, {"max_steps": max_steps}, instances=instances)


def evaluate_policies(options: EvaluateOptions) -> None:
    """Let policies and planners act in the same episodes, and print the table of results."""
    if not options.policy:
        raise ValueError("expected --policy, once or more")
    # Networks this small take several times as long on two threads; torch, which is not loaded yet, reads this.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    factories: dict[str, PolicyFactory | Policy | str] = {
        options.label(name): policy_factory(name, options.policy_seed, options.deterministic) for name in options.policy
    }
    report(factories, options.tasks(), options.output, options.jobs)


def report(
    policies: dict[str, PolicyFactory | Policy | str],
    tasks: Sequence[EvaluationTask],
    output: Path | None,
    jobs: int | str = 1,
) -> None:
    """Evaluate, print the table, and write it and the figures to `output` if there is one."""
    with interruptible() as check, _progress_bar(check) as show:
        episodes = evaluate(policies, tasks, output, jobs, show)
    Console(file=sys.stdout, width=None if sys.stdout.isatty() else 200).print(terminal_table(episodes))
    for line in exhausted(episodes):
        print(line)
    if output is None:
        return
    write_whole(output / TABLE_FILE, markdown_table(episodes).encode())
    print(f"table and episodes written to {output}")
    if find_spec("matplotlib") is None:
        print("no figures: pip install 'mapf-pz[train]' has what draws them")
        return
    from mapf_pz.evaluation.figures import draw_figures

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
                label = f"{episode.policy}, {episode.num_agents} agents on {episode.task}"
                bar.update(task, advance=1, description=label)

        yield show
