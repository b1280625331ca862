"""A run's configuration on disk: `config.json`, and beside it the guidance graph, if the task has one of its own."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from pydantic import TypeAdapter, ValidationError
from safetensors import SafetensorError
from safetensors.numpy import load, save

from mapf_pz.files import write_whole
from mapf_pz.guidance import GuidanceGraph
from mapf_pz.instances.textfile import read_text
from mapf_pz.rl.config import GRAPH, TrainConfig
from mapf_pz.types import FormatError

CONFIG = "config.json"
_ADAPTER = TypeAdapter(TrainConfig)
_DAMAGE = (SafetensorError, OSError, ValueError, TypeError, LookupError, AttributeError, OverflowError)


def config_as_json(config: TrainConfig) -> bytes:
    """Return the content of `config.json`; it names the file of a guidance graph, but does not contain the graph."""
    return _ADAPTER.dump_json(config, indent=2)


def save_config(folder: Path, config: TrainConfig) -> None:
    """Write `config.json` and the guidance graph, if there is one, to `folder`."""
    graph = config.task.edge_weights
    if isinstance(graph, GuidanceGraph):
        write_whole(folder / GRAPH, save({"move": graph.move, "wait": graph.wait}))
    write_whole(folder / CONFIG, config_as_json(config))
    if not isinstance(graph, GuidanceGraph):
        (folder / GRAPH).unlink(missing_ok=True)


def load_config(file: Path) -> TrainConfig:
    """Read `config.json` and the guidance graph that it names; raises `FormatError` if one of them is malformed."""
    try:
        return _ADAPTER.validate_json(read_text(file), context=partial(_read_graph, file.with_name(GRAPH)))
    except ValidationError as error:
        first = error.errors()[0]
        cause = first.get("ctx", {}).get("error")
        if isinstance(cause, FormatError):
            raise cause from None
        place = ".".join(str(part) for part in first["loc"])
        raise FormatError(file, f"{place}: {first['msg']}") from None


def _read_graph(file: Path) -> GuidanceGraph:
    try:
        arrays = load(file.read_bytes())
        return GuidanceGraph(arrays["move"], arrays["wait"])
    except _DAMAGE as error:
        raise FormatError(file, f"not a guidance graph: {' '.join(str(error).split())}") from None
