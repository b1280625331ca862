"""Statistics over all tasks of an evaluation: interquartile means, probabilities of improvement, performance profiles.

Agarwal et al., *Deep Reinforcement Learning at the Edge of the Statistical Precipice*, NeurIPS 2021, whose library is
rliable. The score of a run, a policy of one training seed, in a task is the mean over its episodes. A method has one or
more runs.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import trim_mean

from mapf_pz._internal.arrays import Floats
from mapf_pz.evaluation.reports.intervals import LEVELS, RESAMPLES, mean_interval
from mapf_pz.evaluation.reports.report import (
    COLUMNS,
    NO_METHODS,
    Estimate,
    Methods,
    Summary,
    SummaryTable,
    check_baseline,
    column_values,
    method_of,
    table_of,
)
from mapf_pz.evaluation.results import Episode

ALL_TASKS = "all tasks"
"""The task of the rows."""
HIGHER_IS_BETTER = ("CSR", "ISR", "avg_throughput")
"""The metrics of which more is better. Of the others less is; `best_ratio` has no direction."""
TRIMMED = 0.25
"""Share of the scores that an interquartile mean omits at each end."""

Cell = tuple[str, int]
"""A task's name and its number of agents."""
Run = Mapping[Cell, Mapping[int, float]]
"""The values of a column in a run, by task and number of the episode."""


class Profile(NamedTuple):
    """A performance profile: the share of the scores above each of T thresholds."""

    shares: Floats
    """(T,)."""
    low: Floats
    """Lower ends of the intervals (T,)."""
    high: Floats
    """Upper ends of the intervals (T,)."""


def interquartile_means(
    episodes: Sequence[Episode], columns: Sequence[str] = COLUMNS, methods: Methods = NO_METHODS
) -> SummaryTable:
    """Return the interquartile mean of the scores of each method: of the middle half of all runs in all tasks.

    The interval is that of a percentile bootstrap, which samples runs within each task or, of a method with one run,
    episodes.
    """
    return _of_all_tasks(episodes, columns, methods, lambda _, runs: _interquartile_mean(runs))


def improvements(
    episodes: Sequence[Episode], baseline: str, columns: Sequence[str] = COLUMNS, methods: Methods = NO_METHODS
) -> SummaryTable:
    """Return the probability that each method is better than the method `baseline`; equal counts as half.

    It is the share of the episodes, which are the same for both, in which the method is better. The interval is that of
    the mean over episodes or, of a method with several runs, over runs.

    Raises `ValueError` if there are no episodes of the baseline.
    """
    check_baseline(episodes, baseline, methods)
    references, others = [], []
    for episode in episodes:
        (references if method_of(episode.policy, methods) == baseline else others).append(episode)
    directed = [name for name in columns if not name.startswith("best_ratio")]
    baselines = {name: _runs(references, name, methods).get(baseline, []) for name in directed}
    return _of_all_tasks(others, directed, methods, lambda name, runs: _improvement(name, runs, baselines[name]))


def _of_all_tasks(
    episodes: Sequence[Episode],
    columns: Sequence[str],
    methods: Methods,
    estimate: Callable[[str, Sequence[Run]], Estimate | None],
) -> SummaryTable:
    """Return a row for each method, with an estimate for each column that has one."""
    counts: dict[str, int] = defaultdict(int)
    for episode in episodes:
        counts[method_of(episode.policy, methods)] += 1
    estimates: dict[str, dict[str, Estimate]] = {method: {} for method in counts}
    for name in columns:
        for method, runs in _runs(episodes, name, methods).items():
            found = estimate(name, runs)
            if found is not None:
                estimates[method][name] = found
    rows = [Summary(ALL_TASKS, None, method, counts[method], estimates[method]) for method in counts]
    return table_of(rows, columns)


def _runs(episodes: Sequence[Episode], column: str, methods: Methods) -> dict[str, list[Run]]:
    """Return the runs of each method with values of a column."""
    found: dict[str, dict[str, dict[Cell, dict[int, float]]]] = {}
    for episode in episodes:
        value = column_values(episode).get(column)
        if value is not None:
            run = found.setdefault(method_of(episode.policy, methods), {}).setdefault(episode.policy, {})
            run.setdefault((episode.task, episode.num_agents), {})[episode.number] = value
    return {method: list(runs.values()) for method, runs in found.items()}


def performance_profiles(
    episodes: Sequence[Episode], column: str, thresholds: Floats, methods: Methods = NO_METHODS
) -> dict[str, Profile]:
    """Return for each method the share of the scores, of all runs in all tasks, above each of the `thresholds` (T,).

    The interval is that of `interquartile_means`. Of a column of which less is better, scores are those below. Methods
    without values of the column have no profile.
    """
    sign = _direction(column)
    return {method: _profile(runs, thresholds, sign) for method, runs in _runs(episodes, column, methods).items()}


def mean_scores(episodes: Sequence[Episode], column: str, methods: Methods = NO_METHODS) -> dict[str, Estimate]:
    """Return the mean of the scores of each method, with the interval of `interquartile_means`."""
    means: dict[str, Estimate] = {}
    for method, runs in _runs(episodes, column, methods).items():
        scores, resampled = _scores(runs)
        low, high = np.quantile(resampled.mean(axis=1), LEVELS)
        means[method] = Estimate(float(scores.mean()), float(low), float(high))
    return means


def _profile(runs: Sequence[Run], thresholds: Floats, sign: int) -> Profile:
    scores, resampled = _scores(runs)
    shares = [np.mean(sign * resampled > sign * threshold, axis=1) for threshold in thresholds]
    low, high = np.quantile(np.array(shares), LEVELS, axis=1)
    return Profile((sign * scores > sign * thresholds[:, None]).mean(axis=1), low, high)


def _interquartile_mean(runs: Sequence[Run]) -> Estimate:
    """Return the interquartile mean of the scores of one or more runs."""
    scores, resampled = _scores(runs)
    low, high = np.quantile(_trimmed(resampled), LEVELS)
    return Estimate(float(_trimmed(scores[None])[0]), float(low), float(high))


def _scores(runs: Sequence[Run]) -> tuple[Floats, Floats]:
    """Return the scores (S,) of all runs in all tasks, and `RESAMPLES` samples of them (R, S).

    Samples are of runs within each task; of a single run, they are of the episodes within each task.
    """
    rng = np.random.default_rng(0)
    scores: dict[Cell, list[float]] = defaultdict(list)
    for run in runs:
        for cell, values in run.items():
            scores[cell].append(float(np.mean(list(values.values()))))
    if len(runs) > 1:
        resampled = [rng.choice(each, (RESAMPLES, len(each))) for each in scores.values()]
    else:
        values_of = [np.array(list(values.values())) for values in runs[0].values()]
        resampled = [rng.choice(each, (RESAMPLES, len(each))).mean(axis=1, keepdims=True) for each in values_of]
    return np.concatenate(list(scores.values())), np.concatenate(resampled, axis=1)


def _trimmed(scores: Floats) -> Floats:
    """Return the interquartile mean (R,) of each row of scores (R, S)."""
    return np.asarray(trim_mean(scores, TRIMMED, axis=1))


def _improvement(column: str, runs: Sequence[Run], baselines: Sequence[Run]) -> Estimate | None:
    """Return the probability that runs are better than those of the baseline; None if they share no episode."""
    sign = _direction(column)
    compared = [shares for run in runs if (shares := _compared(run, baselines, sign))]
    if not compared:
        return None
    samples = [float(np.mean(shares)) for shares in compared] if len(compared) > 1 else compared[0]
    return Estimate(float(np.mean(samples)), *mean_interval(samples, 0, 1))


def _direction(column: str) -> int:
    """Return 1 if more is better, -1 if less is."""
    return 1 if column.partition(" ")[0] in HIGHER_IS_BETTER else -1


def _compared(run: Run, baselines: Sequence[Run], sign: int) -> list[float]:
    """Return for each episode of a run the share of the baseline's runs than which it is better, half if equal."""
    shares: list[float] = []
    for cell, values in run.items():
        for number, value in values.items():
            others = [other[cell][number] for other in baselines if number in other.get(cell, {})]
            if others:
                shares.append(float(np.mean([(1 + np.sign(sign * (value - other))) / 2 for other in others])))
    return shares
