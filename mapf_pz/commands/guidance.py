"""The command `mapf-pz guidance`: draw, convert, generate, evaluate and optimize guidance graphs."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
from rich.console import Console
from rich.table import Table
from tyro.conf import Positional, subcommand

from mapf_pz._internal.interrupts import interruptible
from mapf_pz._internal.text import read_text
from mapf_pz.commands.progress import progress_bar
from mapf_pz.guidance import GuidanceGraph, load_guidance, load_moves, save_guidance
from mapf_pz.guidance.files import check_guidance_file
from mapf_pz.guidance.graph import AGAINST, ALONG, CONGESTION, CONTRAFLOW, HIGH, LOW
from mapf_pz.guidance.library import guidance_graph
from mapf_pz.instances import load_map
from mapf_pz.instances.instance import Grid
from mapf_pz.optimization.config import OptimizeConfig
from mapf_pz.optimization.evaluate import Comparison, compare
from mapf_pz.optimization.folder import GRAPH_FILE, read_optimization
from mapf_pz.optimization.optimize import Optimized, optimize, resume
from mapf_pz.optimization.search import Progress
from mapf_pz.optimization.task import GuidanceTask
from mapf_pz.planners.named import import_code
from mapf_pz.render.guidance import check_picture, save_guidance_picture


@dataclass(frozen=True, kw_only=True)
class ShowGuidance:
    """Draw a guidance graph: arrows in the cheaper direction of each edge, and colors by cost or by traffic."""

    graph: Positional[str]
    """Name of a guidance graph, or path of a file."""
    map: str
    """Name of a map, or path of a `.map` file."""
    output: Path
    """Output file, `.png` or `.svg`."""
    moves: Path | None = None
    """File of counted moves (`.npz`), by which cells are colored. None: colored by the mean cost of leaving them."""
    cell_size: int | None = None
    """Pixels per cell. None: chosen by the size of the map."""


@dataclass(frozen=True, kw_only=True)
class ConvertGuidance:
    """Convert a guidance graph to another file format; the extension determines it."""

    input: Positional[Path]
    """Input file: `.json` or `.csv` (GGO), `.w` (WPPL), or `.npz` (this package)."""
    output: Positional[Path]
    """Output file, of one of the same formats."""
    map: str
    """Name of a map, or path of a `.map` file, which the graph must be for."""


@dataclass(frozen=True, kw_only=True)
class _Generated:
    map: str
    """Name of a map, or path of a `.map` file."""
    output: Path
    """Output file: `.json` or `.csv` (GGO), `.w` (WPPL), or `.npz` (this package)."""


@dataclass(frozen=True, kw_only=True)
class GenerateUniform(_Generated):
    """Give every action the cost 1."""


@dataclass(frozen=True, kw_only=True)
class GenerateRandom(_Generated):
    """Sample every weight uniformly."""

    low: float = LOW
    """Minimum weight."""
    high: float = HIGH
    """Maximum weight."""
    seed: int = 0
    """Random seed."""


@dataclass(frozen=True, kw_only=True)
class GenerateCrisscross(_Generated):
    """Alternate the directions of rows and of columns."""

    along: float = ALONG
    """Weight of moves in the direction of the row or column."""
    against: float = AGAINST
    """Weight of other moves."""


@dataclass(frozen=True, kw_only=True)
class GenerateHighway(_Generated):
    """Prefer directions that are drawn with arrows."""

    arrows: Path
    """Text file with one line per row: `>`, `v`, `<`, `^`, or `.` for no direction."""
    along: float = ALONG
    """Weight of moves in the direction of an arrow."""
    against: float = AGAINST
    """Weight of other moves from a cell with an arrow."""


@dataclass(frozen=True, kw_only=True)
class GenerateTraffic(_Generated):
    """Make moves against recorded traffic, and optionally into busy cells, more expensive."""

    moves: Path
    """File of counted moves (`.npz`)."""
    contraflow: float = CONTRAFLOW
    """Weight of the traffic in the opposite direction."""
    congestion: float = CONGESTION
    """Weight of the traffic into the cell."""


@dataclass(frozen=True)
class GenerateGuidance:
    """Generate a guidance graph for a map."""

    generator: (
        Annotated[GenerateUniform, subcommand("uniform")]
        | Annotated[GenerateRandom, subcommand("random")]
        | Annotated[GenerateCrisscross, subcommand("crisscross")]
        | Annotated[GenerateHighway, subcommand("highway")]
        | Annotated[GenerateTraffic, subcommand("traffic")]
    )
    """How the weights are generated."""


@dataclass(frozen=True, kw_only=True)
class EvaluateGuidance:
    """Compare guidance graphs on the same seeds: mean scores and their standard errors."""

    task: GuidanceTask = field(default_factory=GuidanceTask)
    """The planner or policy, and its episodes."""
    graphs: tuple[str, ...] = ("uniform", "crisscross")
    """Guidance graphs by name, or paths of their files."""
    num_seeds: int = 50
    """Number of episodes of each graph."""
    first_seed: int = 0
    """Seed of the first episode, which increases by one per episode."""
    jobs: int | str = 1
    """Number of processes; `ray`: run on a Ray cluster."""


@dataclass(frozen=True, kw_only=True)
class OptimizeGuidance:
    """Optimize a guidance graph for a planner or policy on a map."""

    config: OptimizeConfig = field(default_factory=OptimizeConfig)
    """The optimization."""
    output: Path = Path("runs/guidance")
    """Folder for the graph (`guidance.json`), the history (CSV), the candidates and pictures."""


@dataclass(frozen=True, kw_only=True)
class ResumeGuidance:
    """Continue an optimization with its configuration and candidates, for another time budget."""

    output: Positional[Path]
    """The folder of the optimization."""
    minutes: float | None = None
    """Time budget in minutes, the final selection included. None: as configured."""
    jobs: int | str | None = None
    """Number of processes; `ray`: run on a Ray cluster. None: as configured."""
    trust_remote_code: bool = False
    """Load a configuration and a policy that name code outside this package, and run that code."""


def guidance(
    task: Annotated[ShowGuidance, subcommand("show")]
    | Annotated[ConvertGuidance, subcommand("convert")]
    | Annotated[GenerateGuidance, subcommand("generate")]
    | Annotated[EvaluateGuidance, subcommand("evaluate")]
    | Annotated[OptimizeGuidance, subcommand("optimize")]
    | Annotated[ResumeGuidance, subcommand("resume")],
) -> None:
    """Draw, convert, generate, evaluate or optimize guidance graphs."""
    match task:
        case ShowGuidance():
            _show(task)
        case ConvertGuidance():
            _convert(task)
        case GenerateGuidance(generator):
            _generate(generator)
        case EvaluateGuidance():
            import_code(task.task.planner)
            _evaluate(task)
        case OptimizeGuidance():
            import_code(task.config.task.planner)
            _optimize(task.config, task.output, partial(optimize, task.config, task.output))
        case ResumeGuidance():
            _resume(task)


def _show(task: ShowGuidance) -> None:
    check_picture(task.output, task.cell_size)
    grid = load_map(task.map)
    graph = guidance_graph(task.graph, grid)
    moves = None if task.moves is None else load_moves(task.moves, grid)
    task.output.parent.mkdir(parents=True, exist_ok=True)
    save_guidance_picture(graph, grid, task.output, moves, task.cell_size)
    print(f"{task.output}: {task.graph} on map {grid.name}")


def _convert(task: ConvertGuidance) -> None:
    check_guidance_file(task.output)
    grid = load_map(task.map)
    _save(load_guidance(task.input, grid), task.output, grid)


def _generate(
    generator: GenerateUniform | GenerateRandom | GenerateCrisscross | GenerateHighway | GenerateTraffic,
) -> None:
    check_guidance_file(generator.output)
    grid = load_map(generator.map)
    match generator:
        case GenerateUniform():
            graph = GuidanceGraph.uniform(grid.free)
        case GenerateRandom():
            rng = np.random.default_rng(generator.seed)
            graph = GuidanceGraph.random(grid.free, rng, generator.low, generator.high)
        case GenerateCrisscross():
            graph = GuidanceGraph.crisscross(grid.free, generator.along, generator.against)
        case GenerateHighway():
            graph = GuidanceGraph.highway(grid.free, read_text(generator.arrows), generator.along, generator.against)
        case GenerateTraffic():
            moves = load_moves(generator.moves, grid)
            graph = GuidanceGraph.traffic(grid.free, moves, generator.contraflow, generator.congestion)
    _save(graph, generator.output, grid)


def _save(graph: GuidanceGraph, output: Path, grid: Grid) -> None:
    output.parent.mkdir(parents=True, exist_ok=True)
    save_guidance(graph, output, grid)
    print(f"{output}: guidance graph of map {grid.name}")


def _evaluate(options: EvaluateGuidance) -> None:
    """Compare guidance graphs, and print a table."""
    task = options.task
    if "edge_weights" in task.env.keywords:
        raise ValueError("edge_weights: expected --graphs, which are compared")
    graphs = {name: guidance_graph(name, task.grid) for name in options.graphs}
    with interruptible() as check, progress_bar("evaluating", len(graphs) * options.num_seeds) as update:

        def on_episode() -> None:
            check()
            update(advance=1)

        found = compare(task, graphs, options.num_seeds, options.first_seed, options.jobs, on_episode)
    _print_table(task, found)


def _print_table(task: GuidanceTask, found: list[Comparison]) -> None:
    table = Table("guidance graph", "goals per step" if task.is_lifelong else "- cost per agent", "standard error")
    for row in found:
        table.add_row(row.name, f"{row.mean:.3f}", f"{row.standard_error:.3f}")
    Console(file=sys.stdout, width=None if sys.stdout.isatty() else 120).print(table)


def _resume(options: ResumeGuidance) -> None:
    """Continue the optimization in a folder."""
    trusted = options.trust_remote_code
    config = read_optimization(options.output, trusted)
    if options.minutes is not None:
        config = replace(config, minutes=options.minutes)
    run = partial(resume, options.output, options.minutes, options.jobs, trust_remote_code=trusted)
    _optimize(config, options.output, run)


def _optimize(config: OptimizeConfig, output: Path, run: Callable[[Callable[[Progress], None]], Optimized]) -> None:
    """Run an optimization with a progress bar, and print its result."""
    with interruptible() as check, progress_bar("optimizing", round(60 * config.minutes)) as update:

        def on_progress(progress: Progress) -> None:
            check()
            state = f"best {progress.best:.3f} in {progress.simulations} simulations"
            update(completed=round(progress.seconds), state=state)

        result = run(on_progress)
    ending = "interrupted; the best graph so far" if result.interrupted else "the best graph"
    unit = "goals per step" if config.task.is_lifelong else "score"
    print(f"{ending}: {result.score:.3f} {unit} in {result.num_scores} episodes, written to {output / GRAPH_FILE}")
