import csv

import pytest
from rich.console import Console

from mapf_pz.evaluate.report import interval, results_table, write_episodes

EPISODES = [{"CSR": 1.0, "SoC": 10.0}, {"CSR": 0.0, "SoC": 20.0}]


def test_interval_holds_the_mean_and_shrinks_with_more_values():
    low, high = interval([0.0, 1.0] * 50)
    assert 0.35 < low < 0.5 < high < 0.65
    narrow = interval([0.0, 1.0] * 5000)
    assert high - low > 5 * (narrow[1] - narrow[0])
    assert interval([3.0] * 10) == (3.0, 3.0)


def test_table_shows_means_of_known_metrics():
    console = Console(width=120, record=True, file=None)
    with console.capture() as shown:
        console.print(results_table({"one": EPISODES, "lifelong": [{"avg_throughput": 2.0}]}))
    text = shown.get()
    assert "0.5 [0, 1]" in text
    assert "2 [2, 2]" in text


def test_episodes_are_written_one_a_row(tmp_path):
    write_episodes({"one": EPISODES}, tmp_path / "episodes.csv")
    with (tmp_path / "episodes.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["trial"] for row in rows] == ["one", "one"]
    assert [float(row["SoC"]) for row in rows] == pytest.approx([10.0, 20.0])
