"""The folder of a dataset: its settings in `dataset.json`, its shards, and its card `README.md`."""

from __future__ import annotations

import json
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

from mapf_pz._internal.atomic import naming, write_whole
from mapf_pz._internal.json import JsonObject, parse_object
from mapf_pz._internal.text import read_text
from mapf_pz.errors import FormatError
from mapf_pz.guidance.library import weights_digest
from mapf_pz.instances.instance import Grid, Scenario
from mapf_pz.rl.demonstrations.config import RULES, DatasetConfig
from mapf_pz.rl.demonstrations.shard import FORMAT
from mapf_pz.rl.inputs import sources_digest
from mapf_pz.simulator.config import EnvConfig

SETTINGS_FILE, CARD_FILE = "dataset.json", "README.md"
_SHARDS = "shard-*.npz"


class ShardJob(NamedTuple):
    """The episodes of a shard."""

    config: DatasetConfig
    """The settings of the dataset."""
    num_agents: int
    """N, the number of agents."""
    first: int
    """Number of the first episode in the dataset."""
    episodes: int
    """Number of episodes."""

    @property
    def file(self) -> str:
        """The name of the shard's file."""
        return _SHARDS.replace("*", f"{self.num_agents:04}-agents-{self.first:08}")


def shard_jobs(config: DatasetConfig) -> list[ShardJob]:
    """Return the shards of a dataset; its episodes are numbered from 0, and grouped by the number of agents."""
    return [
        ShardJob(config, num_agents, k * config.episodes + first, min(config.shard_size, config.episodes - first))
        for k, num_agents in enumerate(config.agent_counts)
        for first in range(0, config.episodes, config.shard_size)
    ]


def shard_files(folder: Path) -> list[Path]:
    """Return the finished shards of a dataset, sorted by name."""
    return sorted(folder.glob(_SHARDS))


def dataset_files(folder: Path) -> list[Path]:
    """Return the files of a dataset that determine its demonstrations."""
    return [folder / SETTINGS_FILE, *shard_files(folder)]


def open_folder(folder: Path, config: DatasetConfig) -> JsonObject:
    """Create the folder of a dataset, or resume it; return its settings.

    Raises `ValueError` if it contains a dataset with other settings, or of files with another content.
    """
    settings = _settings(config)
    text = json.dumps(settings, indent=2).encode()
    file = folder / SETTINGS_FILE
    with naming(folder):
        folder.mkdir(parents=True, exist_ok=True)
    if not file.exists():
        write_whole(file, text)
    elif file.read_bytes() != text:
        raise ValueError(f"{folder}: contains demonstrations with other settings; expected another folder")
    return json.loads(text)


def read_rules(folder: Path) -> EnvConfig:
    """Return the environment of a dataset, with the keywords `RULES`.

    Raises `FileNotFoundError` if the folder contains no dataset, and `FormatError` if its settings are malformed.
    """
    file = folder / SETTINGS_FILE
    settings = parse_object(read_text(file), file)
    rules = settings.get("rules")
    if settings.get("format") != FORMAT or not isinstance(rules, dict) or set(rules) != set(RULES):
        raise FormatError(file, f"expected a dataset of the format {FORMAT} with the rules {', '.join(RULES)}")
    try:
        return EnvConfig(**rules)
    except (ValueError, TypeError) as error:
        raise FormatError(file, f"rules: {' '.join(str(error).split())}") from None


def inputs_digest(config: DatasetConfig) -> str:
    """Return the digest of all maps and scenarios of a dataset, and of its edge weights, whose files are read."""
    return sources_digest(map(config.source, config.agent_counts), weights_digest(config.env.edge_weights))


def _settings(config: DatasetConfig) -> JsonObject:
    """Return the settings that determine the demonstrations, as JSON."""
    env = config.env
    return {
        "format": FORMAT,
        "mapf_pz": version("mapf-pz"),
        "planner": config.planner,
        "rules": {name: _plain(getattr(env, name)) for name in RULES},
        "maps": _maps(config),
        "goals": env.goals,
        "initial_heading": _plain(env.initial_heading),
        "num_agents": list(config.agent_counts),
        "episodes": config.episodes,
        "shard_size": config.shard_size,
        "solved_only": config.solved_only,
        "seed": config.seed,
        "inputs": inputs_digest(config),
    }


def _maps(config: DatasetConfig) -> Any:
    """Return a description of the maps: a name, names of scenarios, the type of a source, or the mixture."""
    env = config.env
    if env.source is not None:
        return env.source if isinstance(env.source, str) else type(env.source).__name__
    names = [*([] if env.map is None else [env.map]), *env.scenarios]
    return [_plain(name) for name in names] or asdict(config.mixture)


def _plain(value: Any) -> Any:
    """Return a value as JSON."""
    if isinstance(value, Grid):
        return value.name
    if isinstance(value, Scenario):
        return f"{len(value)} agents"
    return str(value) if isinstance(value, Path) else value
