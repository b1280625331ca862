"""The command `mapf-pz train`: train a preset or continue a run, evaluate what came of it, and show an episode."""

from __future__ import annotations

import logging
import math
import re
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from rich.console import Console
from rich.logging import RichHandler
from tyro.conf import OmitArgPrefixes, Positional, subcommand
from tyro.constructors import StructConstructorSpec, StructTypeInfo
from tyro.extras import subcommand_type_from_defaults

from mapf_pz._internal.atomic import write_whole
from mapf_pz._internal.interrupts import interruptible
from mapf_pz._internal.lock import locked
from mapf_pz.commands.env_flags import ENV_FLAGS, MixtureKeywords, default_of, flags_of, mixture_flag
from mapf_pz.commands.evaluate import TABLE_FILE, report
from mapf_pz.commands.progress import progress_bar
from mapf_pz.commands.render import save_episode
from mapf_pz.evaluation import EvaluationTask, load_suite
from mapf_pz.evaluation.policies import SHIELD_SUFFIX, policy_factory
from mapf_pz.evaluation.reports.formats import markdown
from mapf_pz.evaluation.reports.report import summaries
from mapf_pz.evaluation.results import EPISODES_FILE, discard, read_episodes
from mapf_pz.planners.named import import_code
from mapf_pz.rl.config import DeviceName, TaskConfig, TrainConfig
from mapf_pz.rl.config_file import CONFIG, load_config
from mapf_pz.rl.policies.folder import WEIGHTS
from mapf_pz.rl.presets import PRESETS, SUMMARIES
from mapf_pz.simulator.config import EnvConfig

EPISODE_FILE = "episode.gif"
SUITES = {
    "quickstart": "quickstart",
    "central-ppo": "central-4",
    "central-ppo-8": "central-8",
    "central-warehouse": "report-10",
    "report": "report-10",
    "report-repaired": "report-10",
    "report-published": "report-10",
}
"""The suites that presets are evaluated on afterwards; the others on `standard`."""
SHOWN = ("CSR", "ISR", "throughput", "return")
"""Means of training episodes that are shown as progress."""
SECONDS_PER_LINE = 20.0
"""Seconds between lines of progress where there is no terminal."""
RULES = ("on_target", "collision_system")
"""Keywords under which a policy is evaluated as it was trained, where the suite does not set them."""


@dataclass(frozen=True)
class TrainOptions:
    """A training run, and what is done with the policy."""

    config: TrainConfig
    """The run."""
    output: Path
    """The run's folder; it must not hold a run yet."""
    evaluate: str = "quickstart"
    """The suite to evaluate on afterwards, a name or a file; `none`: no evaluation and no episode."""
    overwrite: bool = False
    """Replace the run that the folder holds."""
    seeds: tuple[int, ...] = ()
    """Train a run with each of these seeds, in subfolders of the output."""
    sweep: tuple[str, ...] = ()
    """Train a run with each of these settings, in subfolders of the output: options of this command without dashes,
    such as `learning-rate=0.001,conv-channels=16 32`, with each of the `seeds`. Runs that the output holds already are
    continued, and finished ones are kept."""
    trust_remote_code: bool = False
    """Read a configuration, an initial policy or a suite that is a file and names code outside this package
    (`package.module:name`), and run that code."""


@ENV_FLAGS.struct_rule
def _task_flags(info: StructTypeInfo) -> StructConstructorSpec | None:
    """Return the flags of a training task, of which those of the mixture may be omitted."""
    if info.type is not TaskConfig:
        return None
    return StructConstructorSpec(_task, tuple(map(mixture_flag, flags_of(default_of(info)))))


def _task(env: EnvConfig, mixture: MixtureKeywords, **others: Any) -> TaskConfig:
    return TaskConfig(env=env, mixture=mixture.mixture(env), **others)


@dataclass(frozen=True)
class ResumeOptions:
    """Continue a run that was interrupted or killed, from its latest checkpoint."""

    output: Positional[Path]
    """The run's folder."""
    agent_steps: int | None = None
    """Minimum length of the whole run, in steps of all agents together; None: as the run was configured."""
    num_learners: int | Literal["auto"] | None = None
    """Number of processes that train together, or `auto`; None: as the run was configured."""
    device: DeviceName | None = None
    """Device of the networks; None: as the run was configured."""
    evaluate: str = "quickstart"
    """The suite to evaluate on afterwards, a name or a file; `none`: no evaluation and no episode."""
    trust_remote_code: bool = False
    """Continue a run whose configuration, or a suite file, names code outside this package (`package.module:name`), and
    run that code."""


if TYPE_CHECKING:
    Run = TrainOptions | ResumeOptions
else:
    Begin = subcommand_type_from_defaults(
        {
            name: TrainOptions(config, Path("runs") / name, evaluate=SUITES.get(name, "standard"))
            for name, config in PRESETS.items()
        },
        SUMMARIES,
    )
    Run = Begin | Annotated[ResumeOptions, subcommand("resume")]


def train(run: Run) -> None:
    """Train a policy or continue its training, evaluate it on instances that it never saw, and draw an episode."""
    with interruptible():
        if isinstance(run, TrainOptions) and (run.seeds or run.sweep):
            _train_runs(run)
        else:
            _train(run)


def train_from(file: Path, trust_remote_code: bool = False) -> Callable[[TrainOptions], None]:
    """Return the command that trains with the configuration in a file, in which options change fields.

    Raises `FileNotFoundError` or `FormatError` if there is no such file, or if it is malformed or names code outside
    this package without `trust_remote_code`.
    """
    default = TrainOptions(load_config(file, trust_remote_code), Path("runs") / file.stem, evaluate="standard")

    def train_with(run: TrainOptions = default) -> None:
        train(run)

    train_with.__doc__ = train.__doc__
    return train_with


def _train_runs(run: TrainOptions) -> None:
    """Train with several seeds and settings, in sequence; draw the learning curves, and print a table of all runs."""
    from mapf_pz.rl.training import curves
    from mapf_pz.rl.training.launch import is_first
    from mapf_pz.rl.training.run import CURVE, CURVES

    if (run.output / CONFIG).exists():
        raise FileExistsError(f"output {str(run.output)!r} holds a run: choose another output for several runs")
    settings = {_folder_name(text): _with_options(run, text) for text in run.sweep} or {"": run}
    if len(settings) < len(run.sweep):
        raise ValueError(f"sweep {' '.join(run.sweep)!r}: expected settings that differ")
    runs = {
        str(name): replace(setting, config=config, output=run.output / name, seeds=(), sweep=())
        for folder, setting in settings.items()
        for name, config in _by_seed(folder, setting)
    }
    rest = {name: _rest_of(each) for name, each in runs.items()}
    for name, each in rest.items():
        print(name)
        _train(each, name)
    if not is_first():
        return
    folders = [each.output for each in runs.values()]
    curves.draw_curves([curves.Run.read(folder) for folder in folders], CURVES, run.output / CURVE)
    print(f"learning curves written to {run.output / CURVE}")
    if run.evaluate != "none":
        episodes = [episode for folder in folders for episode in read_episodes(folder)]
        methods = {folder or run.output.name: str(Path(folder, "seed-*")) for folder in settings if run.seeds}
        table = markdown(summaries(episodes, methods=methods))
        write_whole(run.output / TABLE_FILE, table.encode())
        print(f"\n{table}\ntable written to {run.output / TABLE_FILE}")


def _with_options(run: TrainOptions, text: str) -> TrainOptions:
    """Return the options with others in `text`, such as `learning-rate=0.001,conv-channels=16 32`."""
    words: list[str] = []
    for part in text.split(","):
        name, _, values = part.partition("=")
        words += [f"--{name.strip()}", *values.split()]
    return tyro.cli(
        TrainOptions, default=run, args=words, prog="mapf-pz train", config=(OmitArgPrefixes,), registry=ENV_FLAGS
    )


def _folder_name(text: str) -> str:
    """Return the name of a setting's folder."""
    return re.sub(r"[^\w.,=+-]+", "-", text.strip())


def _by_seed(folder: str, run: TrainOptions) -> Iterator[tuple[Path, TrainConfig]]:
    """Yield the folder of each run of a setting, and its configuration, which names it for loggers."""
    tracking = run.config.tracking
    for seed in run.seeds or (None,):
        name = Path(folder) if seed is None else Path(folder, f"seed-{seed}")
        shown = replace(
            tracking, group=tracking.group or run.output.name, run_name=f"{tracking.run_name or run.output.name}/{name}"
        )
        yield name, replace(run.config, seed=run.config.seed if seed is None else seed, tracking=shown)


def _rest_of(run: TrainOptions) -> Run:
    """Return what is left of a run; raises `FileExistsError` if its folder holds one with other options."""
    file = run.output / CONFIG
    if run.overwrite or not file.exists():
        return run
    found = load_config(file, run.trust_remote_code)
    if replace(run.config, num_learners=found.num_learners) != found:
        raise FileExistsError(f"output {str(run.output)!r} holds a run with other options: choose another output")
    return ResumeOptions(run.output, evaluate=run.evaluate, trust_remote_code=run.trust_remote_code)


def _train(run: Run, name: str | None = None) -> None:
    """Train or continue a run, and evaluate its policy under a name, by default that of the folder."""
    from mapf_pz.rl.training.launch import is_first  # torch is loaded here, so that `--help` is quick

    config = _config_of(run)
    import_code(config.imitation.expert)
    suite = () if run.evaluate == "none" else load_suite(run.evaluate, run.trust_remote_code)
    tasks = [_by_rules_of(config, task) for task in suite]
    for task in tasks:
        _check_fits(config, task)
    if not is_first():
        _train_policy(run, lambda _: None)
        return
    with locked(run.output):
        _train_and_evaluate(run, config, tasks, name or run.output.name)


def _train_and_evaluate(run: Run, config: TrainConfig, tasks: Sequence[EvaluationTask], name: str) -> None:
    if isinstance(run, TrainOptions) and not run.overwrite:
        _check_unused(run.output)
    before = _weights(run.output)
    _learn(run, config)
    print(f"policy, configuration and progress written to {run.output}")
    if not tasks:
        return
    if isinstance(run, TrainOptions) or _weights(run.output) != before:
        discard(run.output)  # of the policy as it was before
    policy = f"{run.output}{SHIELD_SUFFIX if config.task.shield else ''}"
    factory = policy_factory(policy, trust_remote_code=True)  # this command has run the code already
    report({name: factory}, tasks, run.output)
    env, policy = factory(tasks[-1].env_keywords(0))
    save_episode(env, policy, tasks[-1].seed, run.output / EPISODE_FILE, fps=8, policy_name=name)


def _weights(output: Path) -> bytes:
    """Return the weights of the policy in a folder; none if there is no policy."""
    file = output / WEIGHTS
    return file.read_bytes() if file.exists() else b""


def _config_of(run: Run) -> TrainConfig:
    """Return the configuration of the whole run."""
    if isinstance(run, TrainOptions):
        return run.config
    config = load_config(run.output / CONFIG, run.trust_remote_code)
    return config if run.agent_steps is None else replace(config, agent_steps=run.agent_steps)


def _by_rules_of(config: TrainConfig, task: EvaluationTask) -> EvaluationTask:
    """Return the task with the rules that the policy is trained with."""
    return task.with_(keywords={name: getattr(config.task.env, name) for name in RULES} | task.keywords)


def _check_fits(config: TrainConfig, evaluation: EvaluationTask) -> None:
    """Raise `ValueError` if the policy that `config` trains cannot act in the evaluation task."""
    from mapf_pz.rl.algorithms.named import algorithm_of

    action_model = config.task.env.action_model
    expected = evaluation.keywords.get("action_model", action_model)
    advice = "choose another suite with --evaluate, or --evaluate none"
    if action_model != expected:
        raise ValueError(f"action_model={action_model!r}: {evaluation.label!r} needs {expected!r}; {advice}")
    num_agents = algorithm_of(config.algorithm).fixed_num_agents(config)
    if num_agents not in (None, evaluation.num_agents):
        raise ValueError(f"num_agents={num_agents}: {evaluation.label!r} needs {evaluation.num_agents}; {advice}")


def _check_unused(output: Path) -> None:
    """Raise `FileExistsError` if the folder holds a run, or an evaluation, which the new one would replace."""
    from mapf_pz.rl.training.run import RunFolder

    RunFolder(output).check_unused()
    if (output / EPISODES_FILE).exists():
        raise FileExistsError(f"output {str(output)!r} holds an evaluation: choose another output, or --overwrite")


def _learn(run: Run, config: TrainConfig) -> None:
    """Train or resume, and show the progress."""
    agent_steps = config.num_updates * config.steps_per_update
    print(f"training: {config.num_updates} updates of {config.steps_per_update} agent steps, {agent_steps} in all")
    console = Console(stderr=True)
    try:
        with _training_bar(console, agent_steps) if console.is_terminal else nullcontext(Lines(agent_steps)) as show:
            _train_policy(run, show)
    except KeyboardInterrupt:
        if any((run.output / "checkpoints").glob("*")):
            print(f"to continue: mapf-pz train resume {run.output}")
        raise


def _train_policy(run: Run, show: Callable[[dict[str, float]], None]) -> None:
    """Train or resume."""
    from mapf_pz.rl.training.train import resume, train

    logging.getLogger("torchrl").setLevel(logging.WARNING)  # it reports every buffer that it makes
    if isinstance(run, TrainOptions):
        train(run.config, run.output, show, overwrite=run.overwrite, trust_remote_code=run.trust_remote_code)
    else:
        resume(
            run.output,
            run.agent_steps,
            show,
            num_learners=run.num_learners,
            device=run.device,
            trust_remote_code=run.trust_remote_code,
        )


@contextmanager
def _training_bar(console: Console, agent_steps: int) -> Generator[Callable[[dict[str, float]], None]]:
    """Show a bar and messages on a terminal; yield what feeds it a row of progress."""
    logger, handler = logging.getLogger("mapf_pz"), RichHandler(console=console, show_path=False)
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    try:
        with progress_bar("training", agent_steps, console, transient=False) as update:
            yield lambda row: update(completed=row["agent_steps"], state=_means(row))
            update(completed=agent_steps)
    finally:
        logger.removeHandler(handler)


class Lines:
    """Prints rows of progress where there is no terminal: the first, the last, and others at intervals."""

    def __init__(self, agent_steps: int) -> None:
        """Start before the first row of a run of so many agent steps."""
        self._agent_steps = agent_steps
        self._due = 0.0

    def __call__(self, row: dict[str, float]) -> None:
        """Print a row, if one is due."""
        if row["seconds"] >= self._due or row["agent_steps"] >= self._agent_steps:
            self._due = row["seconds"] + SECONDS_PER_LINE
            print(f"{row['agent_steps'] / self._agent_steps:4.0%}  {_means(row)}", flush=True)


def _means(row: dict[str, float]) -> str:
    """Return the speed and the means of training episodes, those that the run has."""
    means = "  ".join(f"{key} {row[key]:.2f}" for key in SHOWN if not math.isnan(row.get(key, math.nan)))
    return f"{row['agent_steps_per_second']:,.0f} steps/s  {means}"
