"""Measure whether edge weights help learned policies: idea 1 of the report. `python -m experiments.guidance_training`.

Policies are trained on one crowded map with different edge weights, lifelong and one-shot, with three seeds each, and
evaluated on the same held-out episodes, with and without PIBT, which executes their preferences without collisions. The
first run optimizes a graph for PIBT. Existing files are reused, so that the program can be stopped and resumed. It
prints the tables of docs/explanation/report.md.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, product
from pathlib import Path

import numpy as np
import tyro

from mapf_pz.evaluation import EvaluationTask, evaluate
from mapf_pz.evaluation.policies import SHIELD_SUFFIX
from mapf_pz.evaluation.reports.report import grouped
from mapf_pz.optimization.config import OptimizeConfig
from mapf_pz.optimization.folder import GRAPH_FILE
from mapf_pz.optimization.optimize import optimize
from mapf_pz.optimization.task import LIFELONG, GuidanceTask
from mapf_pz.rl.config import TrainConfig
from mapf_pz.rl.presets import PRESETS
from mapf_pz.rl.training.progress import PROGRESS, read_progress
from mapf_pz.rl.training.train import train
from mapf_pz.simulator.config import OnTarget

MAP, NUM_AGENTS = "random-16-16-20", 32
POLICIES = ("pibt", "epibt", "lacam:anytime=False", "mappo-cardinal", "mappo-cardinal+pibt")
"""Planners and bundled policies that are evaluated with each graph."""
OPTIMIZED = "optimized"


@dataclass(frozen=True)
class Mode:
    """Lifelong or one-shot episodes."""

    on_target: OnTarget
    """What happens to agents at their goals."""
    max_steps: int
    """Number of steps of the evaluation's episodes."""
    metrics: dict[str, str]
    """Metrics in the tables, with their formats."""


MODES = {
    "lifelong": Mode("restart", 512, {"avg_throughput": ".2f"}),
    "one-shot": Mode("nothing", 128, {"CSR": ".2f", "ISR": ".2f", "SoC": ".0f"}),
}


@dataclass(frozen=True)
class Setting:
    """Edge weights of a training."""

    name: str
    """Name in the tables."""
    graph: str
    """The guidance graph of the training."""
    evaluated: tuple[str, ...]
    """The guidance graphs of the evaluations."""
    observed: bool = True
    """Whether the four channels `edge_weights` are observed. Other channels, features and rewards use the weights, too,
    through the cost to go."""


SETTINGS = (
    Setting("uniform", "uniform", ("uniform", OPTIMIZED)),
    Setting("random", "random", ("random", OPTIMIZED)),
    Setting("crisscross", "crisscross", ("crisscross",)),
    Setting("optimized", OPTIMIZED, (OPTIMIZED,)),
    Setting("uniform, without the channels", "uniform", ("uniform", OPTIMIZED), observed=False),
    Setting("optimized, without the channels", OPTIMIZED, (OPTIMIZED,), observed=False),
)


@dataclass(frozen=True)
class Options:
    """Options of the experiment."""

    output: Path = Path("runs/guidance_training")
    """Folder of all files."""
    agent_steps: int = 400_000
    """Length of each training in agent steps."""
    seeds: tuple[int, ...] = (0, 1, 2)
    """Random seeds of the trainings."""
    episodes: int = 32
    """Number of held-out episodes of each evaluation."""
    minutes: float = 1.0
    """Time budget of the optimization of the graph."""
    planners_only: bool = False
    """Train no policies, and print only the tables of planners and bundled policies."""

    def weights(self, graph: str) -> str:
        """Return the value of `edge_weights`: a name or a file."""
        return str(self.output / "graph" / GRAPH_FILE) if graph == OPTIMIZED else graph

    def run(self, mode: str, setting: Setting, seed: int) -> Path:
        """Return the folder of a training."""
        return self.output / mode / f"{setting.name.replace(', ', '-').replace(' ', '-')}-{seed}"


def main(options: Options) -> None:
    """Optimize the graph, train the missing runs, and print the tables."""
    optimize_graph(options)
    for setting, mode, seed in product(() if options.planners_only else SETTINGS, MODES, options.seeds):
        learn(mode, setting, seed, options)
    for mode in MODES:
        print_table(["policy", "graph", *MODES[mode].metrics], planner_rows(mode, options))
        if options.planners_only:
            continue
        names = [f"{metric}{suffix}" for suffix in ("", ", " + SHIELD_SUFFIX) for metric in MODES[mode].metrics]
        print_table(["trained with", "evaluated with", *names], policy_rows(mode, options))


def optimize_graph(options: Options) -> None:
    """Optimize a graph for lifelong PIBT, unless it exists."""
    if Path(options.weights(OPTIMIZED)).exists():
        return
    env = replace(LIFELONG, map=MAP, num_agents=NUM_AGENTS, action_model="cardinal")
    optimize(OptimizeConfig(task=GuidanceTask(env=env), minutes=options.minutes, jobs=1), options.output / "graph")


def learn(mode: str, setting: Setting, seed: int, options: Options) -> None:
    """Train a policy, unless its run is complete."""
    output = options.run(mode, setting, seed)
    if not (output / PROGRESS).exists() or length(output) < options.agent_steps:
        config = replace(training(mode, setting, options), seed=seed, agent_steps=options.agent_steps)
        train(config, output, overwrite=True)


def training(mode: str, setting: Setting, options: Options) -> TrainConfig:
    """Return the configuration: the preset `mappo-cardinal` with a smaller view, smaller batches and other channels."""
    preset = PRESETS["mappo-cardinal"]
    weights = ("edge_weights",) if setting.observed else ()
    env = replace(
        preset.task.env,
        map=MAP,
        num_agents=NUM_AGENTS,
        max_steps=128,
        on_target=MODES[mode].on_target,
        view_size=(5, 5),
        channels=("view", "goal", "cost_to_go", *weights, "others_next", "others_at_goal"),
        edge_weights=options.weights(setting.graph),
    )
    optimization = replace(preset.optimization, num_envs=16, minibatch_size=64, num_epochs=3, learning_rate=1e-3)
    return replace(preset, task=replace(preset.task, env=env), optimization=optimization)


def length(run: Path) -> float:
    """Return the number of agent steps of a run."""
    return read_progress(run)[-1]["agent_steps"]


def measure(mode: str, graph: str, policy: str, options: Options) -> dict[str, list[float]]:
    """Return the metrics of a policy's episodes with a graph."""
    setup = {"map": MAP, "on_target": MODES[mode].on_target, "max_steps": MODES[mode].max_steps}
    setup |= {"action_model": "cardinal", "edge_weights": options.weights(graph)}
    task = EvaluationTask(graph, NUM_AGENTS, setup, options.episodes)
    (values,) = grouped(evaluate([policy], [task], options.output / f"evaluation-{mode}-{graph}")).values()
    return values


def planner_rows(mode: str, options: Options) -> Iterator[list[str]]:
    """Yield a row for each planner or bundled policy and graph: means over the episodes and standard errors."""
    for policy, graph in product(POLICIES, ("uniform", "crisscross", OPTIMIZED)):
        values = measure(mode, graph, policy, options)
        cells: list[str] = []
        for metric, digits in MODES[mode].metrics.items():
            error = np.std(values[metric], ddof=1) / options.episodes**0.5
            cells.append(f"{np.mean(values[metric]):{digits}} ± {error:{digits}}")
        yield [policy, graph, *cells]


def policy_rows(mode: str, options: Options) -> Iterator[list[str]]:
    """Yield a row for each training and graph: means over the seeds, and the minimum and maximum of the seeds."""
    for setting in SETTINGS:
        for graph in setting.evaluated:
            cells: list[str] = []
            for suffix in ("", SHIELD_SUFFIX):
                runs = [f"{options.run(mode, setting, seed)}{suffix}" for seed in options.seeds]
                values = [measure(mode, graph, run, options) for run in runs]
                for metric, digits in MODES[mode].metrics.items():
                    means = [np.mean(value[metric]) for value in values]
                    cells.append(f"{np.mean(means):{digits}} ({min(means):{digits}} to {max(means):{digits}})")
            yield [setting.name, graph, *cells]


def print_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a table in Markdown."""
    for row in chain((header, ["---"] * len(header)), rows):
        print("|", " | ".join(row), "|", flush=True)
    print()


if __name__ == "__main__":
    main(tyro.cli(Options))
