"""Summaries of evaluated episodes: means with intervals, and differences between policies on the same episodes."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase

import numpy as np

from mapf_pz.evaluation.reports.intervals import TIMES, bounds_of, difference_interval, interval, mean_interval
from mapf_pz.evaluation.results import METRICS, Episode
from mapf_pz.simulator.metrics import DELAY_METRICS, WEIGHTED_METRICS

SOLVED = " (solved)"
"""Suffix of metrics that are averaged over solved episodes, those with a CSR of 1."""
COLUMNS = (
    "CSR",
    "ISR",
    f"SoC_ratio{SOLVED}",
    f"delayed_SoC_ratio{SOLVED}",
    "avg_throughput",
    "exhausted_agents",
    "best_ratio",
    "step_ms",
)
"""The default columns of tables."""
ALL_COLUMNS = (
    *METRICS,
    *(f"{name}{SOLVED}" for name in ("SoC", "SoC_ratio", *WEIGHTED_METRICS, DELAY_METRICS[1], "makespan", "ep_length")),
)
"""All columns that tables may have."""

Group = tuple[str, int, str]
"""A task's name, its number of agents, and a policy or method."""
Key = tuple[str, int, int]
"""A task's name, its number of agents, and the number of an episode."""
Methods = Mapping[str, str]
"""Patterns of policies, such as `runs/mine/seed-*`, by the name of a method whose runs, of several seeds, they are."""
NO_METHODS: Methods = {}
"""Each policy is one method."""


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
    num_agents: int | None
    """Number of agents; None: of tasks with several numbers."""
    policy: str
    """The policy or method."""
    episodes: int
    """Number of episodes."""
    estimates: Mapping[str, Estimate]
    """Estimates by column, out of `ALL_COLUMNS`."""
    runs: int = 1
    """Number of policies, of several training seeds, that the method has."""
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


def check_columns(columns: Iterable[str]) -> None:
    """Raise `ValueError` for columns that are not in `ALL_COLUMNS`."""
    unknown = [name for name in columns if name not in ALL_COLUMNS]
    if unknown:
        raise ValueError(f"columns {unknown}: expected some of {', '.join(map(repr, ALL_COLUMNS))}")


def column_values(episode: Episode) -> dict[str, float]:
    """Return the finite values of an episode by column; those of solved episodes only if the episode is solved."""
    values = dict(episode.metrics)
    if values.get("CSR") == 1:
        values |= {f"{name}{SOLVED}": value for name, value in episode.metrics.items()}
    return {name: value for name, value in values.items() if name in ALL_COLUMNS and math.isfinite(value)}


def grouped(episodes: Iterable[Episode]) -> dict[Group, dict[str, list[float]]]:
    """Return the values of each column for each task and policy, in the order of the episodes."""
    groups: dict[Group, dict[str, list[float]]] = {}
    for episode in episodes:
        values = groups.setdefault((episode.task, episode.num_agents, episode.policy), {})
        for name, value in column_values(episode).items():
            values.setdefault(name, []).append(value)
    return groups


def method_of(policy: str, methods: Methods) -> str:
    """Return the name of the method that a policy is a run of, the first with a matching pattern; else its own name."""
    return next((name for name, pattern in methods.items() if fnmatchcase(policy, pattern)), policy)


def check_methods(episodes: Iterable[Episode], methods: Methods) -> None:
    """Raise `ValueError` for a method without runs, and for one that has the name of another policy."""
    policies = dict.fromkeys(episode.policy for episode in episodes)
    found = {policy: method_of(policy, methods) for policy in policies}
    for name, pattern in methods.items():
        if name not in found.values():
            raise ValueError(f"method {name!r}: no policy matches {pattern!r}, expected some of {', '.join(policies)}")
        if name in policies and sum(method == name for method in found.values()) > 1:
            raise ValueError(f"method {name!r}: expected another name than that of a policy")


def check_baseline(episodes: Iterable[Episode], baseline: str, methods: Methods) -> None:
    """Raise `ValueError` if there are no episodes of the policy or method `baseline`."""
    known = dict.fromkeys(method_of(episode.policy, methods) for episode in episodes)
    if baseline not in known:
        raise ValueError(f"baseline {baseline!r}: no such policy in the results, expected one of {', '.join(known)}")


def summaries(
    episodes: Iterable[Episode], columns: Sequence[str] = COLUMNS, methods: Methods = NO_METHODS
) -> SummaryTable:
    """Return the means of each task and policy, in the order of the episodes.

    Several runs of a method are one row, with the mean of their means, and the outer one of its intervals over the runs
    and over all their episodes. Columns without values are omitted, and `exhausted_agents` if it is 0.

    Raises `ValueError` if a task is of several suites or of several versions of one.
    """
    episodes = list(episodes)
    suites = suites_by_task(episodes)
    by_method: dict[Group, list[dict[str, list[float]]]] = {}
    for (task, num_agents, policy), values in grouped(episodes).items():
        by_method.setdefault((task, num_agents, method_of(policy, methods)), []).append(values)
    rows = [replace(_summary(group, runs, columns), suite=suites[group[:2]]) for group, runs in by_method.items()]
    return table_of(rows, columns)


def _summary(
    group: Group,
    runs: Sequence[Mapping[str, Sequence[float]]],
    columns: Sequence[str],
    differ: bool = False,
) -> Summary:
    """Return the row of one or more runs, whose values, or with `differ` their differences, are given by column."""
    count = sum(max(map(len, values.values()), default=0) for values in runs)
    estimates: dict[str, Estimate] = {}
    for name in columns:
        each = [values[name] for values in runs if name in values]
        if each and (name != "exhausted_agents" or any(map(any, each))):
            estimates[name] = _estimate(name, each, differ)
    return Summary(*group, count, estimates, len(runs))


def _estimate(name: str, runs: Sequence[Sequence[float]], differ: bool) -> Estimate:
    """Return the mean of one or more runs, each with the same weight, and its interval."""
    means = [float(np.mean(values)) for values in runs]
    values = [value for run in runs for value in run]
    low, high = difference_interval(name, values) if differ else interval(name, values)
    if len(means) > 1 and name not in TIMES:
        # Student's interval over few runs is wide, but it is empty if they are equal.
        least, most = bounds_of(name)
        over_runs = np.clip(mean_interval(means), least - most if differ else least, most - least if differ else most)
        low, high = min(low, float(over_runs[0])), max(high, float(over_runs[1]))
    return Estimate(float(np.mean(means)), low, high)


def differences(
    episodes: Sequence[Episode], baseline: str, columns: Sequence[str] = COLUMNS, methods: Methods = NO_METHODS
) -> SummaryTable:
    """Return the mean differences between each policy and the policy `baseline` on the same episodes of each task.

    With several runs of a method, differences are those of the runs, and the baseline is the mean of its runs.

    Raises `ValueError` if there are no episodes of that policy, and as `summaries`.
    """
    check_baseline(episodes, baseline, methods)
    suites = suites_by_task(episodes)
    found: dict[Key, dict[str, list[float]]] = {}
    for episode in episodes:
        if method_of(episode.policy, methods) == baseline:
            for name, value in column_values(episode).items():
                found.setdefault(episode.key[1:], {}).setdefault(name, []).append(value)
    references = {key: {name: float(np.mean(each)) for name, each in values.items()} for key, values in found.items()}
    groups: dict[Group, dict[str, list[dict[str, float]]]] = {}
    for episode in episodes:
        other, method = references.get(episode.key[1:]), method_of(episode.policy, methods)
        if method != baseline and other is not None:
            values = column_values(episode)
            pair = {name: value - other[name] for name, value in values.items() if name in other}
            runs = groups.setdefault((episode.task, episode.num_agents, method), {})
            runs.setdefault(episode.policy, []).append(pair)
    rows = [
        replace(
            _summary(group, [_by_name(pairs) for pairs in runs.values()], columns, differ=True),
            suite=suites[group[:2]],
        )
        for group, runs in groups.items()
    ]
    return table_of(rows, columns)


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


def infinite_costs(episodes: Iterable[Episode]) -> list[str]:
    """Return a warning for each task and policy with episodes of infinite cost, which means omit."""
    counts = Counter(
        (episode.task, episode.num_agents, episode.policy)
        for episode in episodes
        if math.isinf(episode.metrics.get("weighted_cost", 0))
    )
    return [
        f"{policy}, {num_agents} agents on {task_name}: agents moved along edges of infinite weight in {count} "
        f"episodes, which the means of weighted costs omit"
        for (task_name, num_agents, policy), count in counts.items()
    ]


def failures(episodes: Iterable[Episode]) -> list[str]:
    """Return a line for each task and policy with plans that were not executed, with the reason of the first."""
    noted: dict[Group, list[Episode]] = defaultdict(list)
    for episode in episodes:
        if episode.note:
            noted[episode.task, episode.num_agents, episode.policy].append(episode)
    return [
        f"{policy}, {num_agents} agents on {task_name}: {len(failed)} episodes failed; "
        f"the first, {failed[0].instance or f'number {failed[0].number}'}: {failed[0].note}"
        for (task_name, num_agents, policy), failed in noted.items()
    ]


def table_of(rows: Sequence[Summary], columns: Sequence[str]) -> SummaryTable:
    """Return the rows by task and number of agents, with tasks and policies in the order in which they come first.

    Columns without values are omitted.
    """
    tasks, policies = list(dict.fromkeys(r.task for r in rows)), list(dict.fromkeys(r.policy for r in rows))
    ordered = sorted(rows, key=lambda row: (tasks.index(row.task), row.num_agents or 0, policies.index(row.policy)))
    return SummaryTable(tuple(name for name in columns if any(name in row.estimates for row in rows)), tuple(ordered))


def _by_name(pairs: Sequence[Mapping[str, float]]) -> dict[str, list[float]]:
    values: dict[str, list[float]] = defaultdict(list)
    for pair in pairs:
        for name, value in pair.items():
            values[name].append(value)
    return values
