"""Several runs of a method, interquartile means, and probabilities of improvement."""

import numpy as np
import pytest

from mapf_pz.evaluation import Episode
from mapf_pz.evaluation.reports.aggregates import (
    improvements,
    interquartile_means,
    mean_scores,
    performance_profiles,
)
from mapf_pz.evaluation.reports.formats import cells
from mapf_pz.evaluation.reports.intervals import interval, mean_interval
from mapf_pz.evaluation.reports.report import check_methods, differences, summaries


def episodes_of(metric, results):
    """Return episodes with values of a metric, which are given by policy and number of agents."""
    return [
        Episode(policy, "maze", count, number, {metric: float(value)})
        for (policy, count), values in results.items()
        for number, value in enumerate(values)
    ]


SEEDS = {("s/0", 4): [0, 0, 1, 1], ("s/1", 4): [1, 1, 1, 1], ("s/2", 4): [0, 1, 1, 1], ("pibt", 4): [0, 0, 0, 1]}
MINE = {"mine": "s/*"}


def test_runs_of_a_method_are_one_row():
    table = summaries(episodes_of("CSR", SEEDS), ["CSR"], MINE)
    mine, pibt = table.rows
    assert (mine.policy, mine.runs, mine.episodes) == ("mine", 3, 12)
    estimate = mine.estimates["CSR"]
    low, _ = mean_interval([0.5, 1.0, 0.75])
    assert (estimate.mean, estimate.low, estimate.high) == (0.75, low, 1)
    assert pibt.estimates["CSR"].low == interval("CSR", [0, 0, 0, 1])[0]
    assert cells(table)[0] == ["task", "agents", "policy", "runs", "episodes", "CSR"]


def test_equal_runs_have_the_interval_of_their_episodes():
    equal = episodes_of("CSR", {(f"s/{run}", 4): [1] * 4 for run in range(3)})
    (row,) = summaries(equal, ["CSR"], MINE).rows
    assert (row.estimates["CSR"].low, row.estimates["CSR"].high) == interval("CSR", [1] * 12)


def test_differences_of_runs():
    (row,) = differences(episodes_of("CSR", SEEDS), "pibt", ["CSR"], MINE).rows
    low, _ = mean_interval([0.25, 0.75, 0.5])
    assert (row.policy, row.runs, row.estimates["CSR"].mean) == ("mine", 3, 0.5)
    assert (row.estimates["CSR"].low, row.estimates["CSR"].high) == (low, 1)
    (row,) = differences(episodes_of("CSR", SEEDS), "mine", ["CSR"], MINE).rows
    assert (row.policy, row.runs, row.estimates["CSR"].mean) == ("pibt", 1, -0.5)


def test_a_method_has_runs_and_a_name_of_its_own():
    episodes = episodes_of("CSR", SEEDS)
    check_methods(episodes, MINE)
    with pytest.raises(
        ValueError, match="method 'mine': no policy matches 't/\\*', expected some of s/0, s/1, s/2, pibt"
    ):
        check_methods(episodes, {"mine": "t/*"})
    with pytest.raises(ValueError, match="method 'pibt': expected another name than that of a policy"):
        check_methods(episodes, {"pibt": "s/*"})


def test_interquartile_means_of_one_run():
    """Scores of 0, 1, 2 and 9 in four tasks: the mean of the middle half is 1.5."""
    episodes = episodes_of("SoC", {("a", 1): [0, 0], ("a", 2): [0, 2], ("a", 3): [2, 2], ("a", 4): [8, 10]})
    (row,) = interquartile_means(episodes, ["SoC"]).rows
    assert (row.task, row.num_agents, row.episodes) == ("all tasks", None, 8)
    estimate = row.estimates["SoC"]
    assert (estimate.mean, estimate.low, estimate.high) == (1.5, 1, 2)  # only the task with 0 and 2 varies
    assert cells(interquartile_means(episodes, ["SoC"]))[1] == ["all tasks", "", "a", "8", "1.5 [1, 2]"]


def test_interquartile_means_of_several_runs():
    """As `rliable.metrics.aggregate_iqm`: of all runs in all tasks, which are 8 scores here."""
    scores = [(0, 1, 2, 9), (4, 3, 3, 5)]
    episodes = episodes_of(
        "SoC", {(f"s/{r}", t): [value] for r, row in enumerate(scores) for t, value in enumerate(row)}
    )
    (row,) = interquartile_means(episodes, ["SoC"], MINE).rows
    assert (row.policy, row.estimates["SoC"].mean) == ("mine", (2 + 3 + 3 + 4) / 4)
    assert row.estimates["SoC"].low < 3 < row.estimates["SoC"].high


def test_performance_profiles_of_several_runs():
    """As `rliable`'s run-score distributions: the share of the 8 scores of all runs in all tasks above a threshold."""
    scores = [(0, 0.25, 0.5, 1), (1, 0.75, 0.5, 0.5)]
    episodes = episodes_of(
        "CSR", {(f"s/{r}", t): [value] for r, row in enumerate(scores) for t, value in enumerate(row)}
    )
    thresholds = np.array([0, 0.25, 0.5, 0.9, 1])
    profile = performance_profiles(episodes, "CSR", thresholds, MINE)["mine"]
    assert profile.shares.tolist() == [7 / 8, 6 / 8, 3 / 8, 2 / 8, 0]
    assert (profile.low <= profile.shares).all()
    assert (profile.shares <= profile.high).all()
    assert (profile.low[-1], profile.high[0]) == (0, 1)
    estimate = mean_scores(episodes, "CSR", MINE)["mine"]
    assert estimate.mean == 4.5 / 8
    assert estimate.low < estimate.mean < estimate.high


def test_performance_profiles_of_costs_are_of_scores_below():
    episodes = episodes_of("SoC", {("a", 1): [2, 4], ("a", 2): [9, 9]})  # scores of 3 and 9
    profile = performance_profiles(episodes, "SoC", np.array([3, 3.5, 10]))["a"]
    assert profile.shares.tolist() == [0, 0.5, 1]
    assert (profile.low.tolist(), profile.high.tolist()) == ([0, 0, 1], [0.5, 0.5, 1])  # the first varies from 2 to 4
    assert performance_profiles(episodes, "CSR", np.zeros(1)) == {}


def test_the_probability_of_improvement():
    results = {("a", 4): [5, 5, 5], ("b", 4): [4, 5, 6], ("a", 8): [7, 7, 7], ("b", 8): [8, 9, 7]}
    for metric, expected in (
        ("avg_throughput", (0 + 0.5 + 1 + 1 + 1 + 0.5) / 6),
        ("SoC", (1 + 0.5 + 0 + 0 + 0 + 0.5) / 6),
    ):
        (row,) = improvements(episodes_of(metric, results), "a", [metric]).rows
        assert (row.policy, row.episodes, row.estimates[metric].mean) == ("b", 6, pytest.approx(expected))
        assert 0 <= row.estimates[metric].low < expected < row.estimates[metric].high <= 1


def test_the_probability_of_improvement_of_runs():
    (row,) = improvements(episodes_of("CSR", SEEDS), "pibt", ["CSR"], MINE).rows
    each = [(0.5 + 0.5 + 1 + 0.5) / 4, (1 + 1 + 1 + 0.5) / 4, (0.5 + 1 + 1 + 0.5) / 4]
    assert row.estimates["CSR"].mean == pytest.approx(sum(each) / 3)
    (row,) = improvements(episodes_of("CSR", SEEDS), "mine", ["CSR"], MINE).rows
    assert row.estimates["CSR"].mean == pytest.approx(1 - sum(each) / 3)


def test_only_the_same_episodes_are_compared():
    results = {("a", 4): [5], ("b", 4): [4, 5, 6], ("c", 8): [5]}
    b, c = improvements(episodes_of("SoC", results), "a", ["SoC", "best_ratio"]).rows
    assert (b.estimates["SoC"].mean, c.estimates) == (1, {})
    with pytest.raises(ValueError, match="baseline 'd': no such policy in the results, expected one of a, b, c"):
        improvements(episodes_of("SoC", results), "d", ["SoC"])
