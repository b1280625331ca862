import pytest
from rich.console import Console

from mapf_pz.evaluation import Episode, markdown_table, terminal_table
from mapf_pz.evaluation.report import exhausted, grouped, interval, rows

EPISODES = [
    Episode("pibt", "maze", 4, 0, {"CSR": 1.0, "SoC": 10.0, "runtime": 0.5}),
    Episode("pibt", "maze", 4, 1, {"CSR": 0.0, "SoC": 20.0, "runtime": 0.5}),
    Episode("pibt", "maze", 8, 0, {"CSR": 1.0, "SoC": 30.0, "runtime": 0.5}),
    Episode("random", "maze", 4, 0, {"CSR": 0.25, "SoC": 30.0, "runtime": 0.5}),
    Episode("pibt", "lifelong", 4, 0, {"avg_throughput": 2.0, "best_ratio": 0.123456}),
]


def shown(episodes):
    console = Console(width=150, record=True)
    with console.capture() as captured:
        console.print(terminal_table(episodes))
    return captured.get()


def test_interval_holds_the_mean_and_shrinks_with_more_values():
    low, high = interval([0.0, 1.0] * 50)
    assert 0.35 < low < 0.5 < high < 0.65
    narrow = interval([0.0, 1.0] * 5000)
    assert high - low > 5 * (narrow[1] - narrow[0])
    assert interval([3.0] * 10) == (3.0, 3.0)
    assert interval([0.0, 1.0] * 50) == (low, high)


def test_interval_of_normal_values():
    values = [-1.0] * 200 + [1.0] * 200  # standard error of the mean: 1 / 20
    assert interval(values) == pytest.approx((-1.96 / 20, 1.96 / 20), abs=0.01)


def test_groups_are_by_task_and_policy():
    groups = grouped(EPISODES)
    assert list(groups) == [("maze", 4, "pibt"), ("maze", 8, "pibt"), ("maze", 4, "random"), ("lifelong", 4, "pibt")]
    assert groups["maze", 4, "pibt"] == {"CSR": [1, 0], "SoC": [10, 20], "runtime": [0.5, 0.5]}


def test_the_table():
    header, *body = rows(EPISODES)
    assert header == ["task", "agents", "policy", "episodes", "CSR", "avg_throughput", "best_ratio"]
    assert body == [
        ["maze", "4", "pibt", "2", "0.5 [0, 1]", "", ""],
        ["maze", "8", "pibt", "1", "1", "", ""],
        ["maze", "4", "random", "1", "0.25", "", ""],
        ["lifelong", "4", "pibt", "1", "", "2", "0.123"],
    ]


def test_agents_at_the_end_of_their_goal_sequences_are_reported():
    def lifelong(policy, *counts):
        return [Episode(policy, "maze", 4, e, {"exhausted_agents": float(n)}) for e, n in enumerate(counts)]

    assert exhausted(lifelong("pibt", 0, 0)) == []
    assert rows(lifelong("pibt", 0, 0))[0] == ["task", "agents", "policy", "episodes"]
    assert rows(lifelong("pibt", 0, 3))[1][-1] == "1.5 [0, 3]"
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
        "| maze | 4 | pibt | 2 | 0.5 [0, 1] |",
        r"| maze | 4 | a\|b | 1 | 1 |",
    ]


def test_the_terminal_shows_what_the_table_has():
    text = shown(EPISODES)
    assert "mean [95 % interval]" in text
    assert "0.5 [0, 1]" in text
    assert "best_ratio" in text
    assert "SoC" not in text


def test_brackets_are_no_markup():
    text = shown([Episode("runs/[bold]", "[red]maze", 4, 0, {"CSR": 1.0})])
    assert "runs/[bold]" in text
    assert "[red]maze" in text
