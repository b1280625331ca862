"""Summaries of evaluated episodes: means with intervals, and differences between policies on the same episodes."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mapf_pz.evaluation.reports.intervals import difference_interval, interval
from mapf_pz.evaluation.results import METRICS, Episode

SOLVED = " (solved)"
"""Suffix of metrics that are averaged over solved episodes, those with a CSR of 1."""
COLUMNS = (
    *("CSR", "ISR", f"SoC_ratio{SOLVED}", f"makespan{SOLVED}", "avg_throughput", "exhausted_agents", "best_ratio"),
    *("collisions", "step_ms", "agent_us"),
)
"""The default columns of tables; other metrics are only in the file of episodes."""
ALL_COLUMNS = (*METRICS, *(f"{name}{SOLVED}" for name in ("SoC", "SoC_ratio", "makespan", "ep_length")))
"""All columns that tables may have."""

Group = tuple[str, int, str]
"""A task's name, its number of agents, and a policy."""


@dataclass(frozen=True)
class Estimate:
    """A mean and its 95 % interval."""

    mean: float
    """The mean."""
    low: float
    """Lower end of the interval."""
    high: float
    """Upper end of the interval."""


@dataclass(frozen=True)
class Summary:
    """The results of a policy in a task."""

    task: str
    """The task's name."""
    num_agents: int
    """Number of agents."""
    policy: str
    """The policy."""
    episodes: int
    """Number of episodes."""
    estimates: Mapping[str, Estimate]
    """Estimates by column, out of `ALL_COLUMNS`."""
    suite: str = ""
    """Name, version and digest of the task's suite; empty if there is none."""


@dataclass(frozen=True)
class SummaryTable:
    """Results of policies in tasks."""

    columns: tuple[str, ...]
    """The columns that at least one row has, in order."""
    rows: tuple[Summary, ...]
    """A row for each task and policy."""

    @property
    def suites(self) -> tuple[str, ...]:
        """Names, versions and digests of the rows' suites."""
        return tuple(dict.fromkeys(row.suite for row in self.rows if row.suite))


def column_values(episode: Episode) -> dict[str, float]:
    """Return the values of an episode by column; those of solved episodes only if the episode is solved."""
    values = dict(episode.metrics)
    if values.get("CSR") == 1:
        values |= {f"{name}{SOLVED}": value for name, value in episode.metrics.items()}
    return {name: value for name, value in values.items() if name in ALL_COLUMNS}


def grouped(episodes: Iterable[Episode]) -> dict[Group, dict[str, list[float]]]:
    """Return the values of each column for each task and policy, in the order of the episodes."""
    groups: dict[Group, dict[str, list[float]]] = {}
    for episode in episodes:
        values = groups.setdefault((episode.task, episode.num_agents, episode.policy), {})
        for name, value in column_values(episode).items():
            values.setdefault(name, []).append(value)
    return groups


def summaries(episodes: Iterable[Episode], columns: Sequence[str] = COLUMNS) -> SummaryTable:
    """Return the means of each task and policy, in the order of the episodes.

    Columns without values are omitted, and `exhausted_agents` if it is 0. Raises `ValueError` if a task is of several
    suites or of several versions of one.
    """
    episodes = list(episodes)
    suites = suites_by_task(episodes)
    rows = [
        Summary(
            *group,
            max(map(len, values.values()), default=0),
            _estimates(values, columns, interval),
            suites[group[:2]],
        )
        for group, values in grouped(episodes).items()
    ]
    return _table(rows, columns)


def differences(episodes: Sequence[Episode], baseline: str, columns: Sequence[str] = COLUMNS) -> SummaryTable:
    """Return the mean differences between each policy and the policy `baseline` on the same episodes of each task.

    Raises `ValueError` if there are no episodes of that policy, and as `summaries`.
    """
    suites = suites_by_task(episodes)
    references = {episode.key[1:]: column_values(episode) for episode in episodes if episode.policy == baseline}
    if not references:
        known = ", ".join(dict.fromkeys(episode.policy for episode in episodes))
        raise ValueError(f"baseline {baseline!r}: no such policy in the results, expected one of {known}")
    groups: dict[Group, list[dict[str, float]]] = defaultdict(list)
    for episode in episodes:
        other = references.get(episode.key[1:])
        if episode.policy != baseline and other is not None:
            values = column_values(episode)
            pair = {name: value - other[name] for name, value in values.items() if name in other}
            groups[episode.task, episode.num_agents, episode.policy].append(pair)
    rows = [
        Summary(*group, len(pairs), _estimates(_by_name(pairs), columns, difference_interval), suites[group[:2]])
        for group, pairs in groups.items()
    ]
    return _table(rows, columns)


def suites_by_task(episodes: Iterable[Episode]) -> dict[tuple[str, int], str]:
    """Return the suite of each task, by its name and number of agents; raises `ValueError` if a task has several."""
    suites: dict[tuple[str, int], str] = {}
    for episode in episodes:
        suite = suites.setdefault((episode.task, episode.num_agents), episode.suite)
        if suite != episode.suite:
            names = " and ".join(repr(name) if name else "no suite" for name in (suite, episode.suite))
            raise ValueError(f"task {episode.task_label!r}: its results belong to {names}; expected those of one")
    return suites


def exhausted(episodes: Iterable[Episode]) -> list[str]:
    """Return a warning for each task and policy with agents that reached the end of their goal sequences."""
    return [
        f"{policy}, {num_agents} agents on {task_name}: agents reached the end of their goal sequence and started it "
        f"over in {np.count_nonzero(values['exhausted_agents'])} episodes; their throughput is not comparable"
        for (task_name, num_agents, policy), values in grouped(episodes).items()
        if any(values.get("exhausted_agents", ()))
    ]


def _table(rows: Sequence[Summary], columns: Sequence[str]) -> SummaryTable:
    """Return the rows by task and number of agents, with tasks and policies in the order in which they come first."""
    tasks, policies = list(dict.fromkeys(r.task for r in rows)), list(dict.fromkeys(r.policy for r in rows))
    ordered = sorted(rows, key=lambda row: (tasks.index(row.task), row.num_agents, policies.index(row.policy)))
    return SummaryTable(tuple(name for name in columns if any(name in row.estimates for row in rows)), tuple(ordered))


def _by_name(pairs: Sequence[Mapping[str, float]]) -> dict[str, list[float]]:
    values: dict[str, list[float]] = defaultdict(list)
    for pair in pairs:
        for name, value in pair.items():
            values[name].append(value)
    return values


def _estimates(
    values: Mapping[str, Sequence[float]],
    columns: Sequence[str],
    interval_of: Callable[[str, Sequence[float]], tuple[float, float]],
) -> dict[str, Estimate]:
    shown = [name for name in columns if name in values and (name != "exhausted_agents" or any(values[name]))]
    return {name: Estimate(float(np.mean(values[name])), *interval_of(name, values[name])) for name in shown}
