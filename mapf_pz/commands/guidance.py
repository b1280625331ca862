"""The command `mapf-pz guidance`: draw, convert, generate, evaluate and optimize guidance graphs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from tyro.conf import Positional, subcommand

from mapf_pz._internal.text import read_text
from mapf_pz.commands.guidance_search import (
    EvaluateGuidance,
    OptimizeGuidance,
    ResumeGuidance,
    evaluate_guidance,
    optimize_guidance,
    resume_guidance,
)
from mapf_pz.guidance import GuidanceGraph, load_guidance, load_moves, save_guidance
from mapf_pz.guidance.files import check_guidance_file
from mapf_pz.guidance.graph import AGAINST, ALONG, CONGESTION, CONTRAFLOW, HIGH, LOW
from mapf_pz.guidance.library import guidance_graph
from mapf_pz.instances import load_map
from mapf_pz.instances.instance import Grid
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
            evaluate_guidance(task)
        case OptimizeGuidance():
            optimize_guidance(task)
        case ResumeGuidance():
            resume_guidance(task)


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
