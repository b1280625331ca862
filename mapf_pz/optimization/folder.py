"""The folder of an optimization: configuration, history, candidates, the best guidance graph, and pictures."""

from __future__ import annotations

import csv
import time
from collections.abc import Mapping, Sequence
from dataclasses import astuple, fields, replace
from importlib.util import find_spec
from pathlib import Path
from typing import get_type_hints

import numpy as np
from pydantic import TypeAdapter

from mapf_pz._internal.arrays import Floats
from mapf_pz._internal.atomic import replacing
from mapf_pz._internal.npz import read_npz, write_npz
from mapf_pz._internal.plugins import check_trusted
from mapf_pz._internal.text import read_text
from mapf_pz.errors import FormatError
from mapf_pz.evaluation.policies import policy_factory
from mapf_pz.guidance import GuidanceGraph, save_guidance
from mapf_pz.instances.instance import Grid
from mapf_pz.optimization.candidate import Candidate, Origin
from mapf_pz.optimization.config import OptimizeConfig
from mapf_pz.optimization.rule import FeedbackRule, Traffic
from mapf_pz.optimization.search import Progress
from mapf_pz.optimization.usage import Usage
from mapf_pz.planners.named import import_code, own_code
from mapf_pz.render.guidance import save_guidance_picture
from mapf_pz.rl.config_file import CONFIG, read_config, write_config_files
from mapf_pz.rl.inputs import sources_digest
from mapf_pz.simulator.saved_config import object_files
from mapf_pz.simulator.source import make_source

GRAPH_FILE, HISTORY_FILE, CANDIDATES_FILE = "guidance.json", "history.csv", "candidates.npz"
SAVE_SECONDS = 20
"""Seconds between two saves of the candidates."""
_ADAPTER = TypeAdapter(OptimizeConfig)
_SCORES, _INPUTS = "scores", "inputs"
_COLUMNS = ("move", "wait", "rule", "direction", "waiting", "flow", "moves", "waits")


class OptimizationFolder:
    """Writes the files of an optimization."""

    def __init__(self, path: Path, config: OptimizeConfig, rows: Sequence[Progress] = ()) -> None:
        """Prepare the folder for an optimization, or to continue the one with this history."""
        self.path = path
        self._grid = config.task.grid
        self._inputs = _inputs_digest(config)
        files = object_files(config.task.config) | {CONFIG: _ADAPTER.dump_json(config, indent=2)}
        path.mkdir(parents=True, exist_ok=True)
        self._rows = list(rows)
        self._seconds = self._rows[-1].seconds if self._rows else 0.0
        self._simulations = self._rows[-1].simulations if self._rows else 0
        write_config_files(path, files)
        self._save_history()
        self._saved = time.monotonic()

    @classmethod
    def create(cls, path: Path, config: OptimizeConfig) -> OptimizationFolder:
        """Create the folder of a new optimization; raises `FileExistsError` if it holds one already."""
        if (path / HISTORY_FILE).exists():
            raise FileExistsError(
                f"output {str(path)!r} holds an optimization: choose another output, or continue it with "
                f"`mapf-pz guidance resume {path}`"
            )
        return cls(path, config)

    @classmethod
    def open(cls, path: Path, config: OptimizeConfig) -> OptimizationFolder:
        """Open the folder of an optimization to continue it; raises `FormatError` if its history is malformed."""
        return cls(path, config, _read_history(path / HISTORY_FILE))

    @property
    def num_rows(self) -> int:
        """Number of rows of the history so far."""
        return len(self._rows)

    def load_candidates(self) -> list[Candidate]:
        """Return the candidates in the folder; none if there are none yet.

        Raises `FormatError` if they are malformed, or of other inputs: a map, a scenario or a policy.
        """
        file = self.path / CANDIDATES_FILE
        if not file.exists():
            return []
        arrays = read_npz(file, (_SCORES, _INPUTS, *_COLUMNS))
        if str(arrays[_INPUTS]) != self._inputs:
            changed = "of which a file has changed: expected another output"
            raise FormatError(file, f"candidates for another map, scenario or policy, {changed}")
        try:
            return [_candidate(arrays, index, self._grid) for index in range(len(arrays[_SCORES]))]
        except (ValueError, LookupError, TypeError) as error:
            raise FormatError(file, f"expected candidates: {' '.join(str(error).split())}") from None

    def add(self, progress: Progress, candidates: Sequence[Candidate]) -> None:
        """Add a row to the history, and save it and the candidates now and then."""
        seconds, simulations = progress.seconds + self._seconds, progress.simulations + self._simulations
        self._rows.append(replace(progress, seconds=seconds, simulations=simulations))
        if time.monotonic() - self._saved > SAVE_SECONDS:
            self._save(candidates)

    def _save(self, candidates: Sequence[Candidate]) -> None:
        self._saved = time.monotonic()
        self._save_history()
        write_npz(self.path / CANDIDATES_FILE, {_INPUTS: self._inputs, **_arrays(candidates)})

    def _save_history(self) -> None:
        with replacing(self.path / HISTORY_FILE) as temporary, temporary.open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow([field.name for field in fields(Progress)])
            writer.writerows(astuple(row) for row in self._rows)

    def save_result(self, candidates: Sequence[Candidate], graph: GuidanceGraph) -> None:
        """Save everything, the best graph, and pictures."""
        self._save(candidates)
        save_guidance(graph, self.path / GRAPH_FILE, self._grid)
        save_pictures(self.path, graph, self._grid, self._rows)


def read_optimization(path: Path, trust_remote_code: bool = False) -> OptimizeConfig:
    """Return the configuration of the optimization in a folder.

    Raises:
        FileNotFoundError: The folder holds no optimization.
        FormatError: The configuration is malformed, or names code outside this package without `trust_remote_code`.
    """
    if not (path / HISTORY_FILE).exists():
        raise FileNotFoundError(f"{str(path)!r} holds no optimization to resume")
    config = read_config(_ADAPTER, path / CONFIG, trust_remote_code)
    check_trusted(path / CONFIG, {"planner": own_code(config.task.planner)}, trust_remote_code)
    import_code(config.task.planner)
    return replace(config, task=replace(config.task, trust_remote_code=trust_remote_code))


def _inputs_digest(config: OptimizeConfig) -> str:
    """Return the digest of the maps and scenarios and the policy that an optimization reads."""
    task = config.task
    policy = policy_factory(task.planner, trust_remote_code=task.trust_remote_code)
    return sources_digest([make_source(task.config)], getattr(policy, "identity", None))


def _read_history(file: Path) -> list[Progress]:
    rows = list(csv.reader(read_text(file).splitlines()))
    names = [field.name for field in fields(Progress)]
    if not rows or rows[0] != names:
        raise FormatError(file, f"expected the columns {', '.join(names)}", 1)
    return [_progress(row, file, line) for line, row in enumerate(rows[1:], 2)]


def _progress(row: Sequence[str], file: Path, line: int) -> Progress:
    """Return a row of the history in `line` of the file."""
    kinds = get_type_hints(Progress)
    try:
        return Progress(**{name: kind(text) for (name, kind), text in zip(kinds.items(), row, strict=True)})
    except ValueError:
        raise FormatError(file, f"expected the values of {', '.join(kinds)}", line) from None


def _arrays(candidates: Sequence[Candidate]) -> dict[str, Floats]:
    """Return the candidates' arrays, a row for each; rules are NaN where there is none."""
    most = max((len(candidate.scores) for candidate in candidates), default=0)
    scores = [[*candidate.scores, *[np.nan] * (most - len(candidate.scores))] for candidate in candidates]
    columns: dict[str, list[Floats]] = {name: [] for name in _COLUMNS}
    for candidate in candidates:
        origin, usage, graph = candidate.origin, candidate.usage, candidate.graph
        nothing = Usage.empty(graph.shape)
        rule = np.full(FeedbackRule().vector().shape, np.nan) if origin is None else origin.rule.vector()
        traffic = Traffic(nothing.moves, nothing.waits, nothing.waits) if origin is None else origin.traffic
        seen = nothing if usage is None else usage
        values = (graph.move, graph.wait, rule, *traffic, seen.moves, seen.waits)
        for name, value in zip(_COLUMNS, values, strict=True):
            columns[name].append(value)
    return {_SCORES: np.array(scores), **{name: np.array(values) for name, values in columns.items()}}


def _candidate(arrays: Mapping[str, Floats], index: int, grid: Grid) -> Candidate:
    """Return a candidate; raises `ValueError` if it is of another map."""
    values = {name: arrays[name][index] for name in _COLUMNS}
    graph = GuidanceGraph(values["move"], values["wait"])
    if graph.shape != grid.shape:
        raise ValueError(f"candidates for a map of {graph.shape} cells, but the map has {grid.shape}")
    origin = None
    if not np.isnan(values["rule"]).any():
        traffic = Traffic(values["direction"], values["waiting"], values["flow"])
        origin = Origin(FeedbackRule.from_vector(values["rule"]), traffic)
    scores = arrays[_SCORES][index]
    known = scores[~np.isnan(scores)].tolist()
    return Candidate(graph, origin, known, Usage(values["moves"], values["waits"]) if known else None)


GRAPH_PICTURE, CURVE_PICTURE = "guidance.png", "curve.png"


def save_pictures(folder: Path, graph: GuidanceGraph, grid: Grid, history: Sequence[Progress]) -> None:
    """Draw the graph and the history, those for which the packages are installed."""
    if find_spec("PIL") is not None:
        save_guidance_picture(graph, grid, folder / GRAPH_PICTURE)
    if find_spec("matplotlib") is not None:
        _draw_curve(history, folder / CURVE_PICTURE)


def _draw_curve(history: Sequence[Progress], file: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.5, 3.4), layout="constrained")
    panel = figure.subplots()
    seconds = [row.seconds for row in history]
    panel.plot(seconds, [row.latest for row in history], ".", markersize=3, alpha=0.5, label="latest simulations")
    panel.plot(seconds, [row.best for row in history], label="best candidate")
    panel.set(xlabel="seconds", ylabel="mean score")
    panel.legend()
    with replacing(file) as temporary:
        figure.savefig(temporary, dpi=110)
