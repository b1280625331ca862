"""An environment's configuration in a run's files: JSON, and one separate file per field that holds an object.

Such a file, `FIELD.safetensors`, stores the object's arrays as tensors, and the rest as JSON in its metadata: a list of
objects that refer to arrays by name and to earlier objects by index. The last object is the value of the field.
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import PlainSerializer, PlainValidator, ValidationInfo
from safetensors import SafetensorError
from safetensors.numpy import load, save

from mapf_pz._internal.config import ABSENT, UNKNOWN
from mapf_pz._internal.plugins import NAMED_PARTS, check_trusted
from mapf_pz._internal.text import read_bytes
from mapf_pz.errors import FormatError
from mapf_pz.guidance import GuidanceGraph
from mapf_pz.guidance.library import guidance_graph, is_guidance_file
from mapf_pz.instances.delays import Delays
from mapf_pz.instances.instance import Grid, Instance, Scenario
from mapf_pz.instances.sources import FixedMap, FixedScenario, InstanceList, SourceMixture
from mapf_pz.instances.warehouse import WarehouseTasks
from mapf_pz.simulator.config import EnvConfig
from mapf_pz.simulator.kernels.reward import RewardConfig
from mapf_pz.simulator.keywords import EnvKeywords
from mapf_pz.simulator.source import make_source

OBJECT_FIELDS = ("map", "scenario", "edge_weights", "source")
"""The fields of `EnvConfig` that may hold an object, which is saved in a separate file."""
PART_FIELDS = ("channels", "features", "reward")
"""The fields of `EnvConfig` that may name user-defined parts."""
_TYPES = {
    kind.__name__: kind
    for kind in (
        *(GuidanceGraph, Grid, Scenario, Delays, Instance),
        *(FixedMap, FixedScenario, InstanceList, SourceMixture, WarehouseTasks),
    )
}
MAX_OBJECT_BYTES = 2**30
"""Maximum size of the file of an object."""
_DAMAGE = (
    *(SafetensorError, OSError, ValueError, TypeError, LookupError, AttributeError),
    *(OverflowError, RecursionError, MemoryError),
)


class Origin(NamedTuple):
    """Where a configuration is read from."""

    file: Path
    """The file, in the folder of the objects' files."""
    trust_remote_code: bool
    """Whether it may name code outside this package."""


def object_file(field: str) -> str:
    """Return the name of the file of a field that holds an object."""
    return f"{field}.safetensors"


def dump_env(config: EnvConfig) -> dict[str, Any]:
    """Return the configuration's fields in their JSON form."""
    fields = config.keywords()
    for name in PART_FIELDS:
        _check_savable(name, fields[name])
    if is_guidance_file(config.edge_weights):
        fields["edge_weights"] = _guidance(config)
    stored = {name: _stored(name, fields[name]) for name in OBJECT_FIELDS}
    fields |= stored
    if config.delays is None:
        del fields["delays"]
    else:
        fields["delays"] = str(config.delays)
    return fields


def _check_savable(name: str, value: Any) -> None:
    """Raise `ValueError` for a channel, feature or reward that is given as an object instead of a name."""
    for part in value if isinstance(value, tuple) else (value,):
        if not isinstance(part, (str, RewardConfig)):
            raise ValueError(f"{name}: a run cannot save {part!r}, only its name, package.module:name")


def _stored(name: str, value: Any) -> Any:
    """Return a field's value in its JSON form: a file name in place of an object; a path is never a name."""
    if isinstance(value, tuple):
        return [_stored(name, part) for part in value]
    if isinstance(value, Path):
        return {"path": str(value)}
    return value if value is None or isinstance(value, str) else object_file(name)


def load_env(stored: Any, info: ValidationInfo) -> EnvConfig:
    """Return the configuration; `info.context` is its `Origin`, or None if it is not read from a file.

    Raises `ValueError` for invalid fields, and `FormatError` for damaged files and for code that is not trusted.
    """
    if isinstance(stored, EnvConfig):
        return stored
    if not isinstance(stored, dict):
        raise ValueError("expected an object")
    stored = {"delays": None} | stored  # absent if there are none, as in files of earlier versions
    names = {field.name for field in dataclasses.fields(EnvConfig)}
    for name in sorted(names ^ stored.keys()):
        raise ValueError(f"{name}: {ABSENT if name in names else UNKNOWN}")
    origin: Origin | None = info.context
    if origin is not None:
        check_trusted(origin.file, {name: stored[name] for name in NAMED_PARTS}, origin.trust_remote_code)
    folder = None if origin is None else origin.file.parent
    fields: dict[str, Any] = stored | {name: _loaded(name, stored[name], folder) for name in OBJECT_FIELDS}
    try:
        if isinstance(fields["reward"], dict):
            fields["reward"] = RewardConfig(**fields["reward"])
        return EnvConfig(**fields)
    except TypeError as error:
        raise ValueError(str(error)) from None


def _loaded(name: str, value: Any, folder: Path | None) -> Any:
    """Return a field's value from its JSON form and the folder of the objects' files."""
    if isinstance(value, list):
        return [_loaded(name, part, folder) for part in value]
    if isinstance(value, dict) and value.keys() == {"path"}:
        return Path(value["path"])
    return value if folder is None or value != object_file(name) else _read_object(folder / object_file(name))


SavedEnv = Annotated[EnvConfig, PlainValidator(load_env), PlainSerializer(dump_env)]
"""An environment's configuration as a field of a configuration that is saved."""


def dump_keywords(given: EnvKeywords) -> dict[str, Any]:
    """Return the fields that are given in their JSON form."""
    return {name: value for name, value in dump_env(given.config()).items() if name in given.keywords}


def load_keywords(stored: Any, info: ValidationInfo) -> EnvKeywords:
    """Return the fields that are given; raises the same errors as `load_env`."""
    if isinstance(stored, EnvKeywords):
        return stored
    if not isinstance(stored, dict):
        raise ValueError("expected an object")
    config = load_env(dump_env(EnvConfig()) | stored, info)
    return EnvKeywords({name: getattr(config, name) for name in stored})


SavedKeywords = Annotated[EnvKeywords, PlainValidator(load_keywords), PlainSerializer(dump_keywords)]
"""Keywords of an environment as a field of a configuration that is saved."""


def object_files(config: EnvConfig) -> dict[str, bytes]:
    """Return the contents of the objects' files, by name; raises `ValueError` for an object of another type."""
    files: dict[str, bytes] = {}
    for name in OBJECT_FIELDS:
        value = getattr(config, name)
        if name == "edge_weights" and is_guidance_file(value):
            value = _guidance(config)
        if value is not None and not isinstance(value, (str, Path, tuple)):
            try:
                files[object_file(name)] = _written(value)
            except TypeError as error:
                raise ValueError(f"{name}: {error}") from None
    return files


def _guidance(config: EnvConfig) -> GuidanceGraph:
    """Return the guidance graph of a file, which is saved as an object, so that a run does not depend on the file."""
    grid = make_source(config).grid
    if grid is None:
        raise ValueError("edge_weights: a file is for one map, but the maps of the episodes differ")
    return guidance_graph(config.edge_weights, grid)


def _written(value: object) -> bytes:
    objects: list[dict[str, Any]] = []
    arrays: dict[str, np.ndarray] = {}
    numbers: dict[int, int] = {}

    def write(part: Any) -> Any:
        if part is None or isinstance(part, (str, int, float)):
            return part
        if isinstance(part, np.ndarray):
            arrays[f"array_{len(arrays)}"] = np.ascontiguousarray(part)
            return {"array": f"array_{len(arrays) - 1}"}
        if isinstance(part, tuple):
            return list(map(write, part))
        if id(part) not in numbers:
            kind = type(part)
            if _TYPES.get(kind.__name__) is not kind:
                advice = "generated maps are set by the task's MapMixture"
                raise TypeError(f"a run cannot save a {kind.__name__}, only {', '.join(_TYPES)}; {advice}")
            made = {field.name: write(getattr(part, field.name)) for field in dataclasses.fields(kind) if field.init}
            objects.append({"type": kind.__name__, "fields": made})
            numbers[id(part)] = len(objects) - 1
        return {"object": numbers[id(part)]}

    write(value)
    return save(arrays, {"objects": json.dumps(objects)})


def _read_object(file: Path) -> Any:
    """Return the object that a file holds; raises `FormatError` if the file is missing or damaged."""
    objects: list[Any] = []

    def read(stored: Any, arrays: dict[str, np.ndarray]) -> Any:
        if isinstance(stored, list):
            return tuple(read(part, arrays) for part in stored)
        if not isinstance(stored, dict):
            return stored
        return arrays[stored["array"]] if "array" in stored else objects[stored["object"]]

    try:
        content = read_bytes(file, MAX_OBJECT_BYTES)
        arrays = load(content)
        header = json.loads(content[8 : 8 + int.from_bytes(content[:8], "little")])
        for entry in json.loads(header["__metadata__"]["objects"]):
            made = {name: read(stored, arrays) for name, stored in entry["fields"].items()}
            objects.append(_TYPES[entry["type"]](**made))
        return objects[-1]
    except _DAMAGE as error:
        raise FormatError(file, f"not a saved value of {file.stem}: {' '.join(str(error).split())}") from None
