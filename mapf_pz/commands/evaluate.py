"""The command `mapf-pz evaluate`: evaluate policies and planners on the same instances."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from glob import glob, has_magic
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any, Literal

from rich.console import Console
from tyro.conf import UseAppendAction, arg

from mapf_pz._internal.atomic import write_whole
from mapf_pz._internal.interrupts import interruptible
from mapf_pz._internal.lock import locked
from mapf_pz._internal.parallel import use_one_thread
from mapf_pz.commands.env_flags import EpisodeKeywords
from mapf_pz.commands.progress import progress_bar
from mapf_pz.environment.policy import Policy, PolicyFactory, simulator_of
from mapf_pz.evaluation import (
    Episode,
    EvaluationTask,
    evaluate,
    load_suite,
    markdown_table,
    policy_factory,
    terminal_table,
)
from mapf_pz.evaluation.external.command import PREFIX, TIME_LIMIT, CommandFactory
from mapf_pz.evaluation.external.plan_folder import PlanFolderFactory
from mapf_pz.evaluation.policies import TrainedFactory
from mapf_pz.evaluation.reports.published import published_episodes
from mapf_pz.evaluation.reports.report import COLUMNS, check_columns, exhausted, failures, infinite_costs
from mapf_pz.evaluation.tracker import known_cost
from mapf_pz.guidance.library import random_share
from mapf_pz.instances import load_instances
from mapf_pz.instances.instance import Scenario
from mapf_pz.instances.library import scenario_name
from mapf_pz.planners.named import import_code
from mapf_pz.simulator.source import goals_per_agent

TABLE_FILE = "evaluation.md"
DEFAULT_AGENTS = 10
"""Default number of agents on a map without scenarios."""
DEFAULTS: dict[str, Any] = {"max_steps": 512}
"""Defaults of the environment on a map or scenarios."""


@dataclass(frozen=True)
class EvaluateOptions:
    """Options of `mapf-pz evaluate`: policies or plans, and suites or a map."""

    policy: Annotated[tuple[str, ...], UseAppendAction] = ()
    """Policy to evaluate; may be given several times. `random`, a planner (`pibt`, `epibt:depth=5,time_limit=0.1`),
    the name of a bundled trained policy, or the folder of a training run. With the suffix `+pibt`, PIBT executes the
    preferences of a trained policy without collisions. Options follow a colon: `mappo:temperature=0.5`,
    `mappo+pibt:patience=4,temperature=0.5`. `package.module:Class` is a policy or planner of your own, which also takes
    `+pibt` and options. A planner in another language is a command that reads `.map` and `.scen` files and
    writes a plan file: "command:./lacam -m {map} -i {scen} -N {agents} -o {plan} -t {seconds}", or with a name for the
    table, "lacam=command:...". It is run without a shell for each episode; illegal plans fail."""
    plans: Annotated[tuple[str, ...], UseAppendAction] = ()
    """Folder of plan files to evaluate, as FOLDER or NAME=FOLDER; may be given several times. The plan for an instance
    is the file INSTANCE-Nagents.txt (or .json, .csv), such as `random-32-32-20-random-1-50agents.txt`."""
    time_limit: float | None = None
    """Time limit in seconds that commands get as `{seconds}`. A command that takes twice as long is ended. None: 10."""
    suite: Annotated[tuple[str, ...], UseAppendAction] = ()
    """Name of a suite, or path of a suite file; may be given several times. Default: `standard`, if there is no map."""
    env: EpisodeKeywords = field(default_factory=EpisodeKeywords)
    """The environment, in place of a suite, if a map or scenario is given: the files of `--scenario`, which may also be
    patterns such as "tests/*.scen", have an episode each; otherwise starts and goals are random. Other fields that are
    given override those of the suite. None: the suite's or policy's value."""
    agent_counts: Annotated[tuple[int, ...] | None, arg(name="num-agents")] = None
    """Number of agents on the map, or several numbers to evaluate. With a suite: those of its tasks that are evaluated.
    Default: all agents of the scenarios, or 10 without scenarios; all tasks of a suite."""
    episodes: int | None = None
    """Number of episodes of each task. Without random headings or edge weights, at most one for each scenario or
    instance: a policy has the same random seed in each, so that it would repeat the same episode (see `--policy-seed`).
    None: the suite's number, one for each scenario, or 64 if starts and goals are random."""
    seed: int | None = None
    """Random seed of the first episode, which increases by one per episode. None: the suite's seed."""
    policy_seed: int = 0
    """Random seed of the policies."""
    deterministic: bool = False
    """Whether trained policies take the most likely action instead of sampling one."""
    jobs: int | Literal["ray"] = 1
    """Number of processes; `ray`: run on a Ray cluster."""
    columns: tuple[str, ...] = COLUMNS
    """Columns of the table, as for `mapf-pz report`. The file of episodes has all."""
    output: Path | None = None
    """Folder for the episodes (CSV), the table (Markdown) and figures. Existing results of the same policies and tasks
    are reused; if these have changed, the command is refused."""
    overwrite: bool = False
    """Replace results in the folder of policies or tasks that have changed."""
    trust_remote_code: bool = False
    """Load policies and suite files that name code outside this package (`package.module:name`), and run that code."""

    def tasks(self) -> tuple[EvaluationTask, ...]:
        """Return the tasks that the options select."""
        given = self.env.keywords
        if self.suite and ("map" in given or "scenario" in given):
            raise ValueError("expected either --suite or --map and --scenario")
        if self.agent_counts == ():
            raise ValueError("--num-agents: expected at least one value, got none")
        if self.episodes is not None and self.episodes < 1:
            raise ValueError(f"episodes={self.episodes}: expected 1 or more")
        if self.seed is not None and self.seed < 0:
            raise ValueError(f"seed={self.seed}: expected 0 or more")
        if "scenario" in given:
            tasks = self._on_scenarios()
        elif "map" in given:
            tasks = self._on_map()
        else:
            tasks = self._of_suites()
        return tuple(map(self._overridden, tasks))

    def _of_suites(self) -> list[EvaluationTask]:
        """Return the tasks of the suites with the given numbers of agents."""
        suites = self.suite or ("standard",)
        tasks = [task for suite in suites for task in load_suite(suite, self.trust_remote_code)]
        counts = sorted({task.num_agents for task in tasks})
        for count in self.agent_counts or ():
            if count not in counts:
                raise ValueError(f"--num-agents {count}: expected some of the suite's, {', '.join(map(str, counts))}")
        return [task for task in tasks if self.agent_counts is None or task.num_agents in self.agent_counts]

    def _overridden(self, task: EvaluationTask) -> EvaluationTask:
        """Return the task with the settings that the options override."""
        keywords = task.keywords | {
            name: value for name, value in self.env.keywords.items() if name not in ("map", "scenario")
        }
        changed = task.with_(keywords=keywords, episodes=self.episodes, seed=self.seed)
        same = (changed.keywords, changed.seed) == (task.keywords, task.seed) and changed.episodes <= task.episodes
        return changed if same else changed.with_(suite="")

    def factories(self) -> dict[str, PolicyFactory]:
        """Return the factories of the policies by their labels in the results, which differ for different settings."""
        if not self.policy and not self.plans:
            raise ValueError("expected --policy or --plans at least once")
        factories = dict(map(self._labeled, self.policy))
        if self.time_limit is not None and not any(isinstance(one, CommandFactory) for one in factories.values()):
            raise ValueError("--time-limit: expected only with a policy 'command:...'")
        for plans in self.plans:
            name, _, folder = plans.rpartition("=")
            factories[name or folder] = PlanFolderFactory(Path(folder))
        return factories

    def _labeled(self, policy: str) -> tuple[str, PolicyFactory]:
        """Return the label of a policy, and its factory."""
        seed = f", seed {self.policy_seed}" if self.policy_seed else ""
        name, separator, command = policy.partition(PREFIX)
        if separator and (not name or name.endswith("=")):
            limit = TIME_LIMIT if self.time_limit is None else self.time_limit
            return (name[:-1] or policy) + seed, CommandFactory(command, limit, self.policy_seed)
        import_code(policy)
        factory = policy_factory(policy, self.policy_seed, self.deterministic, self.trust_remote_code)
        deterministic = self.deterministic and isinstance(factory, TrainedFactory)
        return policy + seed + (", deterministic" if deterministic else ""), factory

    def _on_map(self) -> list[EvaluationTask]:
        """Return a task with random instances for each number of agents."""
        map, counts = self.env.keywords["map"], self.agent_counts or (DEFAULT_AGENTS,)
        return [EvaluationTask(Path(map).stem, count, {"map": map, **DEFAULTS}, episodes=64) for count in counts]

    def _on_scenarios(self) -> list[EvaluationTask]:
        """Return a task for each number of agents, with an episode for each instance of the scenarios."""
        env = self.env.config(**DEFAULTS)
        files = _files(env.scenarios)
        name = Path(files[0]).name if len(files) == 1 else f"{len(files)} scenarios"
        name = name if env.map is None else f"{Path(str(env.map)).stem}, {name}"
        tasks: list[EvaluationTask] = []
        for count in self.agent_counts or (None,):
            instances = tuple(load_instances(files, env.map, count, goals_per_agent(env)))
            task = EvaluationTask(name, instances[0].num_agents, DEFAULTS, instances=instances)
            if len(files) == len(instances):  # scenarios of the benchmark, not files of several instances
                map = None if env.map is None else Path(str(env.map)).stem
                names = tuple(Path(scenario_name(file, map)).stem for file in files)
                best = tuple(known_cost(file, task.num_agents).best for file in names)
                task = task.with_(instance_names=names, best_costs=best)
            tasks.append(task)
        return tasks


def _files(names: Sequence[str | Path | Scenario]) -> tuple[str, ...]:
    """Return the unique names of scenarios, with patterns replaced by the matching files."""
    files: list[str] = []
    for name in map(str, names):
        found = [name] if os.path.exists(name) or not has_magic(name) else sorted(glob(name))
        if not found:
            raise FileNotFoundError(f"--scenario {name}: no file matches this pattern")
        files += found
    return tuple(dict.fromkeys(files))


def evaluate_policies(options: EvaluateOptions) -> None:
    """Evaluate policies and planners on the same episodes, and print a table of results."""
    use_one_thread()
    check_columns(options.columns)
    factories = options.factories()
    tasks = options.tasks()
    for task in tasks:
        _check_repetitions(task, factories)
    with locked(options.output):
        report(factories, tasks, options.output, options.jobs, options.overwrite, options.columns)


def _check_repetitions(task: EvaluationTask, factories: Mapping[str, PolicyFactory]) -> None:
    """Raise `ValueError` if a policy would repeat the same episodes because nothing in them is random."""
    if task.episodes <= len(task.instances) or not task.instances:
        return
    for name, factory in factories.items():
        config = simulator_of(factory(task.env_keywords(0))[0]).config
        headings = config.action_model == "rotate" and config.initial_heading == "random"
        headings &= any(one.headings is None for one in task.instances)
        if not headings and not random_share(config.edge_weights):
            instances = f"{task.label!r} has {len(task.instances)} instances, and nothing is random with {name!r}"
            raise ValueError(f"episodes={task.episodes}: {instances}; expected at most one episode per instance")


def report(
    policies: Mapping[str, PolicyFactory | Policy | str],
    tasks: Sequence[EvaluationTask],
    output: Path | None,
    jobs: int | str = 1,
    overwrite: bool = False,
    columns: Sequence[str] = COLUMNS,
) -> None:
    """Evaluate policies, print the table, and write the table and figures to `output`, if given."""
    with interruptible() as check, progress_bar("evaluating") as update:

        def show(episode: Episode | None, left: int) -> None:
            check()
            if episode is None:
                update(total=left)
            else:
                update(advance=1, description=f"{episode.policy}, {episode.num_agents} agents on {episode.task}")

        episodes = evaluate(policies, tasks, output, jobs, show, overwrite)
    published = published_episodes(episodes)
    shown = [*episodes, *published]
    has_width = sys.stdout.isatty() or "COLUMNS" in os.environ  # in a pipe, lines are not wrapped
    Console(file=sys.stdout, width=None if has_width else 200).print(terminal_table(shown, columns))
    for line in (*exhausted(episodes), *infinite_costs(episodes), *failures(episodes)):
        print(line)
    if output is None:
        return
    write_whole(output / TABLE_FILE, markdown_table(shown, columns).encode())
    print(f"table and episodes written to {output}")
    if find_spec("matplotlib") is None:
        print("no figures: they require matplotlib, pip install 'mapf-pz[train]'")
        return
    from mapf_pz.evaluation.reports.figures import draw_figures

    for file in draw_figures(episodes, output, published=published):
        print(f"figure written to {file}")
