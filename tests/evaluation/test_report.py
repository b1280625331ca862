import csv
import math
from dataclasses import replace

import pytest
from rich.console import Console

from experiments.checks.interval_coverage import coverage, distributions
from mapf_pz.evaluation import Episode, markdown_table, terminal_table
from mapf_pz.evaluation.reports.formats import cells, comma_separated, latex
from mapf_pz.evaluation.reports.intervals import difference_interval, interval, mean_interval, wilson
from mapf_pz.evaluation.reports.report import Estimate, differences, exhausted, grouped, infinite_costs, summaries


def rows(episodes):
    return cells(summaries(episodes))


EPISODES = [
    Episode("pibt", "maze", 4, 0, {"CSR": 1.0, "SoC": 10.0, "runtime": 0.5}),
    Episode("pibt", "maze", 4, 1, {"CSR": 0.0, "SoC": 20.0, "runtime": 0.5}),
    Episode("pibt", "maze", 8, 0, {"CSR": 1.0, "SoC": 30.0, "runtime": 0.5}),
    Episode("random", "maze", 4, 0, {"CSR": 0.0, "SoC": 30.0, "runtime": 0.5}),
    Episode("pibt", "lifelong", 4, 0, {"avg_throughput": 2.0, "best_ratio": 0.123456}),
]


def shown(episodes):
    console = Console(width=150, record=True)
    with console.capture() as captured:
        console.print(terminal_table(episodes))
    return captured.get()


def test_the_interval_holds_the_mean_and_shrinks_with_more_values():
    for bounds in ((), (0, 1)):
        low, high = mean_interval([0.0, 1.0] * 50, *bounds)
        assert 0.35 < low < 0.45 < 0.55 < high < 0.65
        narrow = mean_interval([0.0, 1.0] * 1250, *bounds)
        assert high - low > 4 * (narrow[1] - narrow[0])
        assert mean_interval([0.0, 1.0] * 50, *bounds) == (low, high)


def test_the_interval_of_normal_values():
    values = [-1.0] * 200 + [1.0] * 200  # standard error of the mean: 1 / 20
    assert mean_interval(values) == pytest.approx((-1.96 / 20, 1.96 / 20), abs=0.01)


def test_the_interval_of_few_values_is_at_least_students():
    low, high = mean_interval([1.0, 2.0, 3.0])  # R: t.test(c(1, 2, 3))
    assert low <= -0.4841 + 1e-4
    assert high >= 4.4841 - 1e-4


def test_the_interval_of_equal_values():
    assert mean_interval([3.0] * 10) == mean_interval([3.0]) == (3, 3)  # nothing bounds the others
    low, high = mean_interval([1.0] * 10, 0, 1)
    assert 0.7 < low < 0.85  # R: qbeta(0.025, 10, 0.5) is 0.776
    assert high == 1
    low, high = difference_interval("CSR", [0.0] * 10)
    assert -0.3 < low < -0.1 < 0.1 < high < 0.3


@pytest.mark.parametrize(
    "name",
    [
        *("ISR 0.5, all agents or none", "ISR 0.98, all agents or none", "throughput, livelock in 10% of the episodes"),
        "cost ratio, exponential above 1",
    ],
)
def test_intervals_of_eight_episodes_hold_the_mean(name):
    (values,) = (one for one in distributions() if one.name == name)
    found, _ = coverage(values, 8, lambda sample: mean_interval(sample, values.least, values.most), 150, seed=0)
    assert found >= 0.85  # 0.90 and two standard errors of the simulation less


@pytest.mark.parametrize(
    ("share", "count", "expected"),
    [(1.0, 3, (0.4385, 1)), (0.0, 64, (0, 0.0566)), (0.5, 10, (0.2366, 0.7634)), (0.9, 100, (0.8256, 0.9448))],
)
def test_wilsons_interval(share, count, expected):  # of binom.test's relatives in R: prop.test(correct=FALSE)
    assert wilson(share, count) == pytest.approx(expected, abs=1e-4)


def test_only_success_has_wilsons_interval():
    assert interval("CSR", [1.0] * 3) == wilson(1.0, 3)
    assert interval("ISR", [1.0] * 3) == mean_interval([1.0] * 3, 0, 1)
    assert interval("SoC", [1.0] * 3) == (1, 1)


@pytest.mark.parametrize("count", [4, 5, 8, 30])
def test_ratios_of_solved_episodes_end_at_1(count):
    for name in ("SoC_ratio (solved)", "weighted_cost_ratio (solved)"):
        low, high = interval(name, [1.0] * (count - 1) + [1.36])
        assert low == 1
        assert high > 1.01


def test_infinite_costs_are_left_out_and_reported():
    values = {"a": (1.5, math.inf, 2.5, 4.0), "b": (2.0, 2.0, 2.0, 2.0)}
    tried = [
        Episode(name, "maze", 4, k, {"CSR": float(k < 3), "weighted_cost": 8 * value, "weighted_cost_ratio": value})
        for name, ratios in values.items()
        for k, value in enumerate(ratios)
    ]
    name = "weighted_cost_ratio (solved)"
    a, b = summaries(tried, [name]).rows
    assert (a.estimates[name].mean, b.estimates[name].mean) == (2, 2)
    (difference,) = differences(tried, "b", [name]).rows
    assert difference.estimates[name].mean == 0
    assert name not in summaries(EPISODES).columns
    (line,) = infinite_costs(tried)
    assert line.startswith("a, 4 agents on maze: agents moved along edges of infinite weight in 1 episodes, which")


@pytest.mark.parametrize("metric", ["runtime", "step_ms", "agent_us"])
def test_times_have_no_interval(metric):
    """One of four episodes took longer."""
    tried = [Episode("a", "maze", 4, k, {metric: value}) for k, value in enumerate((0.5, 0.5, 0.6, 12.0))]
    (row,) = summaries(tried, [metric]).rows
    assert row.estimates[metric] == Estimate(3.4, 3.4, 3.4)
    assert "3.4 |" in markdown_table(tried, [metric])
    others = [replace(one, policy=name) for name in ("b-1", "b-2") for one in tried]
    (compared,) = differences([*tried, *others], "a", [metric], {"b": "b-*"}).rows
    assert compared.estimates[metric] == Estimate(0, 0, 0)


def test_the_interval_of_few_values_is_near_them():
    """Although three of four are almost equal."""
    low, high = interval("makespan (solved)", [50, 50, 51, 120])
    assert 0 < low < 20
    assert 120 < high < 130


def test_groups_are_by_task_and_policy():
    groups = grouped(EPISODES)
    assert list(groups) == [("maze", 4, "pibt"), ("maze", 8, "pibt"), ("maze", 4, "random"), ("lifelong", 4, "pibt")]
    values = {"CSR": [1, 0], "SoC": [10, 20], "runtime": [0.5, 0.5], "SoC (solved)": [10]}
    assert groups["maze", 4, "pibt"] == values


def test_the_table():
    header, *body = rows(EPISODES)
    assert header == ["task", "agents", "policy", "episodes", "CSR", "avg_throughput", "best_ratio"]
    assert body == [
        ["maze", "4", "pibt", "2", "0.5 [0.0945, 0.905]", "", ""],
        ["maze", "4", "random", "1", "0 [0, 0.793]", "", ""],
        ["maze", "8", "pibt", "1", "1 [0.207, 1]", "", ""],
        ["lifelong", "4", "pibt", "1", "", "2", "0.123"],
    ]


def test_chosen_columns_in_their_order():
    table = summaries(EPISODES, ["SoC (solved)", "SoC", "collisions", "CSR"])
    assert table.columns == ("SoC (solved)", "SoC", "CSR")
    assert cells(table)[1][-3:] == ["10", "15 [0, 78.5]", "0.5 [0.0945, 0.905]"]


def test_differences_are_those_of_the_same_episodes():
    episodes = [
        Episode(policy, "maze", 4, number, {"CSR": float(solved), "SoC": cost})
        for policy, results in {"a": [(1, 10), (1, 20), (0, 50)], "b": [(1, 13), (0, 40)], "c": []}.items()
        for number, (solved, cost) in enumerate(results)
    ]
    table = differences(episodes, "a", ["CSR", "SoC", "SoC (solved)"])
    assert cells(table)[1:] == [["maze", "4", "b", "2", "-0.5 [-0.984, 0.663]", "11.5 [-96.5, 120]", "3"]]
    with pytest.raises(ValueError, match="baseline 'd': no such policy in the results, expected one of a, b"):
        differences(episodes, "d")


def test_agents_at_the_end_of_their_goal_sequences_are_reported():
    def lifelong(policy, *counts):
        return [Episode(policy, "maze", 4, e, {"exhausted_agents": float(n)}) for e, n in enumerate(counts)]

    assert exhausted(lifelong("pibt", 0, 0)) == []
    assert rows(lifelong("pibt", 0, 0))[0] == ["task", "agents", "policy", "episodes"]
    assert rows(lifelong("pibt", 0, 3))[1][-1] == "1.5 [0, 20.6]"
    (line,) = exhausted([*lifelong("pibt", 0, 0), *lifelong("epibt", 0, 3)])
    assert line.startswith("epibt, 4 agents on maze: ")
    assert " in 1 episodes; " in line


def test_no_episodes():
    assert rows([]) == [["task", "agents", "policy", "episodes"]]


def test_markdown():
    lines = markdown_table([*EPISODES[:2], Episode("a|b", "maze", 4, 0, {"CSR": 1.0})]).splitlines()
    assert lines == [
        "| task | agents | policy | episodes | CSR |",
        "| --- | --- | --- | --- | --- |",
        "| maze | 4 | pibt | 2 | 0.5 [0.0945, 0.905] |",
        r"| maze | 4 | a\|b | 1 | 1 [0.207, 1] |",
    ]


def test_names_are_no_html_in_markdown():
    text = markdown_table([Episode("<b>mine</b>", "<img src=x onerror=alert(1)>", 4, 0, {"CSR": 1.0})])
    assert "| &lt;img src=x onerror=alert(1)&gt; | 4 | &lt;b&gt;mine&lt;/b&gt; |" in text


def test_latex():
    table = summaries([*EPISODES[:4], Episode("a_b&c", "maze", 8, 1, {"CSR": 1.0})], ["CSR"])
    assert latex(table).splitlines() == [
        r"\begin{tabular}{lrlrr}",
        r"\toprule",
        r"task & agents & policy & episodes & CSR \\",
        r"\midrule",
        r"maze & 4 & pibt & 2 & 0.5 [0.0945, 0.905] \\",
        r"maze & 4 & random & 1 & 0 [0, 0.793] \\",
        r"\midrule",
        r"maze & 8 & pibt & 1 & 1 [0.207, 1] \\",
        r"maze & 8 & a\_b\&c & 1 & 1 [0.207, 1] \\",
        r"\bottomrule",
        r"\end{tabular}",
    ]


def test_csv_has_numbers():
    text = comma_separated(summaries(EPISODES[2:], ["CSR", "best_ratio"]))
    header, first, *_, last = csv.reader(text.splitlines())
    assert header[3:] == [
        "runs",
        "episodes",
        "CSR",
        "CSR low",
        "CSR high",
        "best_ratio",
        "best_ratio low",
        "best_ratio high",
        "suite",
    ]
    assert (first[:3], last[:3]) == (["maze", "4", "random"], ["lifelong", "4", "pibt"])
    assert [float(value) for value in first[5:8]] == pytest.approx([0, 0, 0.79345], abs=1e-4)
    assert last[3:] == ["1", "1", "", "", "", "0.123456", "0.123456", "0.123456", ""]


def test_cells_of_csv_are_no_formulas():
    text = comma_separated(summaries([Episode("=cmd", "@maze", 4, 0, {"CSR": 1.0})], ["CSR"]))
    assert list(csv.reader(text.splitlines()))[1][:3] == ["'@maze", "4", "'=cmd"]


def test_the_terminal_shows_what_the_table_has():
    text = shown(EPISODES)
    assert "mean [95 % interval]" in text
    assert "0.5 [0.0945, 0.905]" in text
    assert "best_ratio" in text
    assert "SoC" not in text


def test_brackets_are_no_markup():
    text = shown([Episode("runs/[bold]", "[red]maze", 4, 0, {"CSR": 1.0})])
    assert "runs/[bold]" in text
    assert "[red]maze" in text


def test_tables_state_their_suites():
    episodes = [replace(one, suite="mine/2 ab" if one.task == "maze" else "") for one in EPISODES]
    assert markdown_table(episodes).endswith("\n\nSuite: mine/2 ab\n")
    assert "Suite: mine/2 ab" in shown(episodes)
    assert latex(summaries(episodes)).startswith("% Suite: mine/2 ab\n")
    lines = list(csv.DictReader(comma_separated(summaries(episodes)).splitlines()))
    assert {line["task"]: line["suite"] for line in lines} == {"maze": "mine/2 ab", "lifelong": ""}
    assert {row.suite for row in differences(episodes, "pibt").rows} == {"mine/2 ab"}
    assert "Suite" not in markdown_table(EPISODES)


def test_results_of_two_versions_are_not_compared():
    episodes = [replace(EPISODES[0], suite="mine/1 ab"), replace(EPISODES[3], suite="mine/2 ab")]
    message = "task '4 agents on maze': its results belong to 'mine/1 ab' and 'mine/2 ab'; expected those of one"
    for call in (lambda: summaries(episodes), lambda: differences(episodes, "pibt")):
        with pytest.raises(ValueError, match=message):
            call()
    with pytest.raises(ValueError, match="'mine/1 ab' and no suite"):
        summaries([episodes[0], replace(episodes[1], suite="")])
