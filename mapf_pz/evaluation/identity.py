"""Identities of results: what must not have changed for the episodes of a folder to be reused.

The identity of a policy has the version of the package, and what determines its decisions: the digests of its weights
and configuration, its options and its seed. Code that changes within a version is not a part of it. The identity of a
task has its rules, its seed, and the digests of its instances and edge weights. A folder keeps both by name in
`identities.json`.

Processes load policies and tasks from their files, once for each job. So identities are computed again after files are
read, and before the episodes of a job are written: a file that was replaced ends the evaluation.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from mapf_pz._internal.atomic import write_whole
from mapf_pz._internal.digest import NoDigestError, digest
from mapf_pz._internal.json import JsonObject, parse_object
from mapf_pz._internal.text import read_text
from mapf_pz._internal.version import __version__
from mapf_pz.errors import FormatError
from mapf_pz.evaluation.task import EvaluationTask
from mapf_pz.guidance.library import weights_digest
from mapf_pz.simulator.config import EnvConfig
from mapf_pz.simulator.source import make_source

Identity = Mapping[str, Any]
"""Named numbers, texts and digests, as JSON."""
IDENTITIES_FILE = "identities.json"
_SOURCE_FIELDS = ("map", "scenario", "source", "goals", "on_target", "max_steps")
_IGNORED_FIELDS = ("map", "scenario", "source", "edge_weights", "num_agents", "distance_bytes", "reward", "render_mode")
"""Fields of an environment that are in the digests of instances and weights, or do not affect metrics."""


def policy_identity(policy: object) -> Identity | None:
    """Return the version of the package and what a policy or policy factory states; None if it states nothing.

    Raises `TypeError` as `stated_identity` does.
    """
    stated = stated_identity(policy)
    return None if stated is None else {"version": __version__, **stated}


def stated_identity(policy: object) -> Identity | None:
    """Return what a policy or policy factory states in an attribute `identity`; None if it has none.

    That is text such as `"mine, version 2"`, which its author changes with the policy's decisions, or a mapping of
    names to texts and numbers, of which messages tell those that differ.

    Raises `TypeError` if the attribute is something else.
    """
    try:
        stated = getattr(policy, "identity", None)
    except NoDigestError:  # of an object in the configuration of a trained policy
        stated = None
    if stated is None:
        return None
    if isinstance(stated, str) and stated:
        stated = {"policy": "object", "identity": stated}
    if not isinstance(stated, Mapping):
        got = type(policy).__name__
        raise TypeError(f"policy {got}: expected its identity to be a non-empty text or a mapping, got {stated!r}")
    return _plain(stated)


def task_identity(task: EvaluationTask) -> Identity | None:
    """Return the identity of a task; None if a part of it, such as its source, has no digest.

    The number of episodes is not a part of it, but that of the suite is.

    Raises as loading the task's map, scenario or weights does.
    """
    keywords: Mapping[str, object] = task.keywords
    try:
        rules = {
            name: value if isinstance(value, (bool, int, str)) else digest(value)
            for name, value in sorted(keywords.items())
            if name not in _IGNORED_FIELDS
        }
        return _plain(
            {
                "seed": task.seed,
                "instances": digest(_instances(task)),
                "edge_weights": weights_digest(keywords.get("edge_weights", EnvConfig.edge_weights)),
                "best_known": digest((task.best, task.best_costs)),
                **({"suite": task.suite} if task.suite else {}),
                **rules,
            }
        )
    except NoDigestError:
        return None


def suite_digest(tasks: Iterable[EvaluationTask]) -> str | None:
    """Return the digest of all instances and rules of a suite's tasks, and of their names and numbers of episodes.

    Best known costs, which not every user has, are not a part of it. None if a part of a task has no digest.
    """
    parts: list[object] = []
    for task in tasks:
        identity = task_identity(replace(task, best_costs=(), suite=""))
        if identity is None:
            return None
        parts.append((task.label, task.episodes, identity))
    return digest(parts)


def _plain(identity: Identity) -> Identity:
    """Return the identity as it is read from a file."""
    return json.loads(json.dumps(identity))


def _instances(task: EvaluationTask) -> object:
    """Return the arrays of the instances or, if they are generated, their source."""
    if task.instances:
        return [
            (
                *(one.grid.free, one.scenario.starts, one.scenario.goals, one.scenario.goal_counts, one.headings),
                *((one.delays,) if one.delays else ()),  # so that instances without delays keep their digests
            )
            for one in task.instances
        ]
    keywords = {name: task.keywords[name] for name in _SOURCE_FIELDS if name in task.keywords}
    return make_source(EnvConfig(**keywords, num_agents=task.num_agents))


@dataclass(frozen=True)
class Identities:
    """The identities of the policies and tasks of an evaluation; None where there is none."""

    policies: Mapping[str, Identity | None] = field(default_factory=dict[str, "Identity | None"])
    """Identities by the policies' names."""
    tasks: Mapping[str, Identity | None] = field(default_factory=dict[str, "Identity | None"])
    """Identities by the tasks' labels."""

    @classmethod
    def of(cls, policies: Mapping[str, object], tasks: Iterable[EvaluationTask]) -> Identities:
        """Return the identities of policies or policy factories by name, and of tasks."""
        return cls(
            {name: policy_identity(policy) for name, policy in policies.items()},
            {task.label: task_identity(task) for task in tasks},
        )

    @classmethod
    def read(cls, folder: Path) -> Identities:
        """Return those of a folder, none if it has no file; raises `FormatError` if the file is malformed."""
        file = folder / IDENTITIES_FILE
        if not file.exists():
            return cls()
        data = parse_object(read_text(file), file)
        return cls(*(_identities_in(data, name, file) for name in ("policies", "tasks")))

    def write(self, folder: Path) -> None:
        """Write them to a folder."""
        content = json.dumps({"policies": self.policies, "tasks": self.tasks}, indent=1)
        write_whole(folder / IDENTITIES_FILE, f"{content}\n".encode())

    def updated(self, other: Identities) -> Identities:
        """Return these identities, with those of `other` in the place of the same names."""
        return Identities({**self.policies, **other.policies}, {**self.tasks, **other.tasks})

    def one(self, policy: str, task: str) -> Identities:
        """Return those of one policy, by its name, and one task, by its label."""
        return Identities({policy: self.policies[policy]}, {task: self.tasks[task]})

    def check_unchanged(self, policies: Mapping[str, object], tasks: Iterable[EvaluationTask]) -> None:
        """Raise `ValueError` if one of these policies or tasks has another identity now; where there is none, pass."""
        known = [name for name, identity in self.policies.items() if identity is not None]
        labels = [label for label, identity in self.tasks.items() if identity is not None]
        changed = self.changes(Identities.of(policies, tasks), known, labels).first
        if changed is not None:
            raise ValueError(f"{changed} from the start of the evaluation; expected files that do not change")

    def changes(self, now: Identities, policies: Iterable[str], tasks: Iterable[str]) -> Changes:
        """Return what is different in `now`, out of these policies and tasks."""
        return Changes(_changes(self.policies, now.policies, policies), _changes(self.tasks, now.tasks, tasks))


def _identities_in(data: JsonObject, name: str, file: Path) -> dict[str, Identity | None]:
    """Return the identities in a member of a file; raises `FormatError` if it is malformed."""
    found = data.get(name)
    if not isinstance(found, dict) or not all(one is None or isinstance(one, dict) for one in found.values()):
        raise FormatError(file, f"expected {name!r} to be an object with an object or null for each name")
    return found


@dataclass(frozen=True)
class Changes:
    """Policies and tasks whose identities differ from the recorded ones, and descriptions of the differences."""

    policies: Mapping[str, str]
    """Descriptions by the policies' names."""
    tasks: Mapping[str, str]
    """Descriptions by the tasks' labels."""

    @property
    def first(self) -> str | None:
        """The first of them in one line; None if there are none."""
        named = (("policy", self.policies), ("task", self.tasks))
        return next((f"{kind} {name!r}: {text}" for kind, parts in named for name, text in parts.items()), None)


def _changes(
    recorded: Mapping[str, Identity | None], now: Mapping[str, Identity | None], names: Iterable[str]
) -> dict[str, str]:
    found = {name: difference(recorded, now[name], name) for name in dict.fromkeys(names) if name in now}
    return {name: text for name, text in found.items() if text}


def difference(recorded: Mapping[str, Identity | None], now: Identity | None, name: str) -> str:
    """Return how an identity differs from the recorded one of this name; empty if they are equal."""
    if now is None:
        return "no attribute 'identity' states what it is, so its results cannot be reused"
    if name not in recorded:
        return f"its results have no identity in {IDENTITIES_FILE}"
    before = recorded[name]
    if before is None:
        return "its results are those of an object without the attribute 'identity'"
    names = [part for part in (*before, *(now.keys() - before.keys())) if before.get(part) != now.get(part)]
    plural = len(names) > 1 or any(part.endswith("s") for part in names)
    return f"{', '.join(names)} {'differ' if plural else 'differs'}" if names else ""
