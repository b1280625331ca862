"""The card of a dataset: a `README.md` that says what the demonstrations are, and how they were made."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from importlib.metadata import version
from pathlib import Path
from platform import python_version

import numpy as np

from mapf_pz._internal.json import JsonObject
from mapf_pz.rl.demonstrations.config import DatasetConfig
from mapf_pz.rl.demonstrations.demonstration import METRICS
from mapf_pz.rl.demonstrations.folder import shard_jobs
from mapf_pz.rl.demonstrations.shard import Shard, read_shard

_INTRODUCTION = """\
Demonstrations of multi-agent path finding: instances, and the actions of all agents in each step. The simulator of
`mapf_pz` draws the observations when the demonstrations are replayed: see `mapf_pz.rl.demonstrations.load_dataset`."""


def card(folder: Path, settings: JsonObject, config: DatasetConfig, command: str) -> str:
    """Return the text of the card: settings, versions, and means over the demonstrations.

    Args:
        folder: the dataset, with all its shards.
        settings: the settings in its file.
        config: the settings as given.
        command: the command that made it; empty: none.
    """
    packages = ("mapf-pz", "numpy", "numba")
    versions = ", ".join([*(f"{name} {version(name)}" for name in packages), f"Python {python_version()}"])
    rows = [(name, json.dumps(value)) for name, value in settings.items() if name != "rules"]
    rows += [(name, json.dumps(value)) for name, value in settings["rules"].items()]
    parts = [
        f"---\nlicense: {config.license.lower()}\ntags: [multi-agent path finding, imitation learning]\n---",
        f"# Demonstrations of `{config.planner}`",
        _INTRODUCTION,
        *([f"```sh\n{command}\n```"] if command else []),
        _table(("setting", "value"), ((name, f"`{value}`") for name, value in rows)),
        f"Versions: {versions}. License: {config.license}.",
        "## Content",
        "Metrics are means over the demonstrations; of the other episodes, nothing is stored.",
        _content(folder, config),
    ]
    return "\n\n".join(parts) + "\n"


def _content(folder: Path, config: DatasetConfig) -> str:
    """Return the table of counts and means, with a row for each number of agents."""
    shards: dict[int, list[Shard]] = {}
    for job in shard_jobs(config):
        shards.setdefault(job.num_agents, []).append(read_shard(folder / job.file, config.env.action_model))
    found = {n: [metrics for shard in group for metrics in shard.metrics] for n, group in shards.items()}
    names = [name for name in METRICS if any(name in metrics for each in found.values() for metrics in each)]
    rows: list[list[str]] = []
    for num_agents, group in shards.items():
        metrics = found[num_agents]
        counts = (num_agents, config.episodes, len(metrics), sum(shard.actions.size for shard in group))
        rows.append([*map(str, counts), *(_mean([each[name] for each in metrics if name in each]) for name in names)])
    return _table(("agents", "episodes", "demonstrations", "agent steps", *names), rows)


def _mean(values: Sequence[float]) -> str:
    return f"{np.mean(values):.4g}" if values else ""


def _table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    return "\n".join(f"| {' | '.join(row)} |" for row in (header, ["---"] * len(header), *rows))
