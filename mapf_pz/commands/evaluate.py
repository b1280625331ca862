"""The command `mapf-pz evaluate`: evaluate policies and planners on the same instances."""

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
from mapf_pz.evaluation.episodes import Policy, PolicyFactory
from mapf_pz.evaluation.policies import is_trained
from mapf_pz.evaluation.report import exhausted
from mapf_pz.instance import Grid
from mapf_pz.instances import load_instance, load_map
from mapf_pz.interrupts import interruptible
from mapf_pz.io.atomic import write_whole

TABLE_FILE = "evaluation.md"
DEFAULT_AGENTS = 10
"""Default number of agents on a map without scenarios."""

Value = TypeVar("Value")


@dataclass(frozen=True)
class EvaluateOptions:
    """Options of `mapf-pz evaluate`: policies, and suites or a map."""

    policy: Annotated[tuple[str, ...], UseAppendAction]
    """Policy to evaluate; may be given several times. `random`, a planner (`pibt`, `epibt:depth=5,time_limit=0.1`),
    the name of a bundled trained policy, or the folder of a training run. With the suffix `+pibt`, PIBT executes the
    preferences of a trained policy without collisions."""
    suite: Annotated[tuple[str, ...], UseAppendAction] = ()
    """Name of a suite, or path of a suite file; may be given several times. Default: `standard`, if there is no map."""
    map: str | None = None
    """Name of a map, or path of a `.map` file, instead of suites."""
    scenario: Annotated[tuple[tuple[str, ...], ...], UseAppendAction] = ()
    """Scenarios for the map, with one episode each: names, `.scen` files or patterns such as "tests/*.scen"; several
    values may be given. Without scenarios, starts and goals are random."""
    num_agents: Annotated[tuple[tuple[int, ...], ...], UseAppendAction] = ()
    """Number of agents on the map, or several numbers to evaluate. Default: all agents of the scenarios, or 10 without
    scenarios."""
    max_steps: int = 512
    """Maximum number of steps of an episode on the map."""
    action_model: ActionModel | None = None
    """`rotate`: agents turn and move forward; `cardinal`: agents move in four directions. None: the model of the suite
    or policy."""
    episodes: int | None = None
    """Number of episodes of each task, at most one for each scenario or instance. None: the suite's number, one for
    each scenario, or 64 if starts and goals are random."""
    seed: int | None = None
    """Random seed of the first episode, which increases by one per episode. None: the suite's seed."""
    policy_seed: int = 0
    """Random seed of the policies."""
    deterministic: bool = False
    """Whether trained policies take the most likely action instead of sampling one."""
    distance_bytes: int | None = None
    """Maximum memory for cost-to-go tables per process in bytes. None: the suite's value, or as needed, up to half of
    the machine's memory."""
    jobs: int | Literal["ray"] = 1
    """Number of processes; `ray`: run on a Ray cluster."""
    output: Path | None = None
    """Folder for the episodes (CSV), the table (Markdown) and figures; existing results are reused."""

    def tasks(self) -> tuple[EvaluationTask, ...]:
        """Return the tasks that the options select."""
        if self.map is not None and self.suite:
            raise ValueError("expected either --suite or --map")
        if self.map is None and self.scenario:
            raise ValueError("--scenario: expected --map, too")
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
        """Return the task with the settings that the options override."""
        if self.episodes is not None and task.instances and self.episodes > len(task.instances):
            instances = f"{task.label!r} has {len(task.instances)} instances"
            raise ValueError(f"episodes={self.episodes}: {instances}, expected at most one episode per instance")
        given = {"action_model": self.action_model, "distance_bytes": self.distance_bytes}
        keywords = {name: value for name, value in given.items() if value is not None}
        return task.with_(keywords=task.keywords | keywords, episodes=self.episodes, seed=self.seed)

    def label(self, policy: str) -> str:
        """Return the label of a policy in the results, which is unique for different settings."""
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
        name = f"{grid.name}, {Path(files[0]).name if len(files) == 1 else f'{len(files)} scenarios'}"
        return [_on_scenarios(name, grid, files, count, self.max_steps) for count in counts or [None]]


def _joined(name: str, values: Sequence[Sequence[Value]]) -> list[Value]:
    """Return the unique values of an option that may be given several times."""
    if not all(values):
        raise ValueError(f"--{name}: expected at least one value, got none")
    return list(dict.fromkeys(chain.from_iterable(values)))


def _files(names: Sequence[str]) -> list[str]:
    """Return the unique names of scenarios, with patterns replaced by the matching files."""
    files: list[str] = []
    for name in names:
        found = [name] if os.path.exists(name) or not has_magic(name) else sorted(glob(name))
        if not found:
            raise FileNotFoundError(f"--scenario {name}: no file matches this pattern")
        files += found
    return list(dict.fromkeys(files))


def _on_scenarios(
    name: str, grid: Grid, files: Sequence[str], num_agents: int | None, max_steps: int
) -> EvaluationTask:
    """Return a task with one episode for each scenario; the environment samples the initial headings."""
    instances = tuple(load_instance(grid, file, num_agents, action_model="cardinal") for file in files)
    return EvaluationTask(name, instances[0].num_agents, {"max_steps": max_steps}, instances=instances)


def evaluate_policies(options: EvaluateOptions) -> None:
    """Evaluate policies and planners on the same episodes, and print a table of results."""
    if not options.policy:
        raise ValueError("expected --policy at least once")
    # These small networks are several times slower with two threads. Set this before torch is imported.
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
    """Evaluate policies, print the table, and write the table and figures to `output`, if given."""
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
        print("no figures: they require matplotlib, pip install 'mapf-pz[train]'")
        return
    from mapf_pz.evaluation.figures import draw_figures

    for file in draw_figures(episodes, output):
        print(f"figure written to {file}")


@contextmanager
def _progress_bar(check: Callable[[], None]) -> Generator[Callable[[Episode | None, int], None]]:
    """Show a progress bar; yield the function that updates it and calls `check`."""
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
