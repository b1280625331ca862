"""A configuration on disk: `config.json`, and separate files for objects in the environment's fields."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import BeforeValidator, TypeAdapter, ValidationError

from mapf_pz._internal.atomic import write_whole
from mapf_pz._internal.config import complaint
from mapf_pz._internal.plugins import check_trusted
from mapf_pz._internal.text import read_text
from mapf_pz.errors import FormatError
from mapf_pz.planners.named import import_code, own_code
from mapf_pz.rl.config import OptimizationConfig, TrainConfig
from mapf_pz.simulator.saved_config import OBJECT_FIELDS, Origin, object_file, object_files

Config = TypeVar("Config")

CONFIG = "config.json"
CONFIG_FILES = (CONFIG, *map(object_file, OBJECT_FIELDS))
"""All files that a configuration may consist of."""


def _with_optimization(saved: Any) -> Any:
    """Move the fields of `optimization` out of `ppo`, which held them in earlier runs."""
    if not isinstance(saved, dict) or "optimization" in saved or not isinstance(ppo := saved.get("ppo"), dict):
        return saved
    moved = {field.name: ppo.pop(field.name) for field in fields(OptimizationConfig) if field.name in ppo}
    return saved | {"optimization": moved}


_ADAPTER = TypeAdapter(Annotated[TrainConfig, BeforeValidator(_with_optimization)])


def config_files(config: TrainConfig) -> dict[str, bytes]:
    """Return the content of a configuration's files by name; raises `ValueError` for an object that cannot be saved."""
    return {**object_files(config.task.env), CONFIG: _ADAPTER.dump_json(config, indent=2)}


def config_values(config: TrainConfig) -> dict[str, Any]:
    """Return a configuration as nested dictionaries of JSON values."""
    return _ADAPTER.dump_python(config, mode="json")


def save_config(folder: Path, config: TrainConfig) -> None:
    """Write a configuration's files to `folder` and remove those of an earlier one; raises as `config_files`."""
    write_config_files(folder, config_files(config))


def load_config(file: Path, trust_remote_code: bool = False) -> TrainConfig:
    """Read `config.json` and the files that it refers to.

    Raises `FormatError` if one of them is malformed, or names code outside this package without `trust_remote_code`.
    """
    config = read_config(_ADAPTER, file, trust_remote_code)
    expert = config.imitation.expert
    named = {"algorithm": config.algorithm, "encoder": config.model.encoder, "expert": own_code(expert)}
    check_trusted(file, named, trust_remote_code)
    import_code(expert)
    return config


def write_config_files(folder: Path, files: dict[str, bytes]) -> None:
    """Write a configuration's files, by name, to `folder`, and remove those of an earlier one."""
    for name, content in files.items():
        write_whole(folder / name, content)
    for name in set(CONFIG_FILES) - files.keys():
        (folder / name).unlink(missing_ok=True)


def read_config(adapter: TypeAdapter[Config], file: Path, trust_remote_code: bool = False) -> Config:
    """Read a configuration from its JSON file and the files that it refers to; raises as `load_config`."""
    try:
        return adapter.validate_json(read_text(file), context=Origin(file, trust_remote_code))
    except ValidationError as error:
        cause = error.errors()[0].get("ctx", {}).get("error")
        if isinstance(cause, FormatError):
            raise cause from None
        raise FormatError(file, complaint(error)) from None
