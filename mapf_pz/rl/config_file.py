"""A run's configuration on disk: `config.json`, and separate files for objects in the environment's fields."""

from __future__ import annotations

from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from mapf_pz.errors import FormatError
from mapf_pz.io.atomic import write_whole
from mapf_pz.io.text import read_text
from mapf_pz.rl.config import TrainConfig
from mapf_pz.rl.saved_env import OBJECT_FIELDS, complaint, object_file, object_files

CONFIG = "config.json"
CONFIG_FILES = (CONFIG, *map(object_file, OBJECT_FIELDS))
"""All files that a configuration may consist of."""
_ADAPTER = TypeAdapter(TrainConfig)


def config_files(config: TrainConfig) -> dict[str, bytes]:
    """Return the content of a configuration's files by name; raises `ValueError` for an object that cannot be saved."""
    return {**object_files(config.task.env), CONFIG: _ADAPTER.dump_json(config, indent=2)}


def save_config(folder: Path, config: TrainConfig) -> None:
    """Write a configuration's files to `folder` and remove those of an earlier one; raises as `config_files`."""
    files = config_files(config)
    for name, content in files.items():
        write_whole(folder / name, content)
    for name in set(CONFIG_FILES) - files.keys():
        (folder / name).unlink(missing_ok=True)


def load_config(file: Path) -> TrainConfig:
    """Read `config.json` and the files that it refers to; raises `FormatError` if one of them is malformed."""
    try:
        return _ADAPTER.validate_json(read_text(file), context=file.parent)
    except ValidationError as error:
        cause = error.errors()[0].get("ctx", {}).get("error")
        if isinstance(cause, FormatError):
            raise cause from None
        raise FormatError(file, complaint(error)) from None
