import csv
import math
import os
from dataclasses import replace

import numpy as np
import pytest

from mapf_pz import GuidanceGraph
from mapf_pz.commands.main import main
from mapf_pz.errors import FormatError
from mapf_pz.evaluation import Episode, EvaluationTask, evaluate
from mapf_pz.evaluation.identity import Identities
from mapf_pz.evaluation.results import COLUMNS, METRICS, Results, read_episodes
from mapf_pz.instances import RandomObstacles
from mapf_pz.simulator.metrics import DELAY_METRICS, WEIGHTED_METRICS, metric_names
from tests.evaluation.test_episodes import TIMES, Right
from tests.helpers.text_instances import drawn

TASKS = (
    EvaluationTask("drawn", 1, {"max_steps": 6}, 3, instances=(drawn("a...A"), drawn("a.A.."))),
    EvaluationTask("random", 2, {"max_steps": 6, "source": RandomObstacles(4, 4, 0.1, 2)}, 10),
)
ALL = sum(task.episodes for task in TASKS)
HEADER = ",".join(COLUMNS)


class Interrupted(Right):
    """Is interrupted in one of its episodes."""

    def __init__(self, stop_in):
        super().__init__()
        self.stop_in = stop_in

    def act(self, observations):
        if self.episodes == self.stop_in:
            raise KeyboardInterrupt
        return super().act(observations)


def untimed(episodes):
    return [(e.key, {name: value for name, value in e.metrics.items() if name not in TIMES}) for e in episodes]


def evaluated(policy, tasks, folder, policies=None):
    """Evaluate; return the episodes, and how many were left to do at first."""
    lefts = []
    episodes = evaluate(policies or {"right": policy}, tasks, folder, show=lambda episode, left: lefts.append(left))
    assert lefts == list(range(lefts[0], -1, -1))
    return episodes, lefts[0]


def rows(folder):
    with (folder / "episodes.csv").open() as file:
        return list(csv.DictReader(file))


def test_instances_have_the_names_of_the_task(tmp_path):
    task = EvaluationTask(
        "drawn", 1, {"max_steps": 6}, 3, seed=5, instances=TASKS[0].instances, instance_names=("a", "b")
    )
    evaluated(Right(), [task], tmp_path)
    assert [(row["instance"], row["seed"]) for row in rows(tmp_path)] == [("a", "5"), ("b", "6"), ("a", "7")]
    with pytest.raises(ValueError, match="task 'drawn': 2 instances, but 1 names of instances"):
        task.with_(instance_names=("a",))


def test_the_file_has_every_number(tmp_path):
    episodes, left = evaluated(Right(), TASKS, tmp_path)
    assert (left, len(episodes)) == (ALL, ALL)
    written = rows(tmp_path)
    assert [tuple(row) for row in written] == [COLUMNS] * ALL
    assert [(row["instance"], row["seed"]) for row in written[:3]] == [
        ("drawn", "1000000"),
        ("drawn", "1000001"),
        ("drawn", "1000002"),
    ]
    assert {row["instance"] for row in written[3:]} == {""}
    for row, episode in zip(written, episodes, strict=True):
        assert (row["policy"], row["task"], int(row["num_agents"]), int(row["episode"])) == episode.key
        assert {name: float(row[name]) for name in METRICS if row[name]} == episode.metrics
    assert Results(tmp_path).episodes == episodes


def test_finished_jobs_are_not_repeated(tmp_path):
    before, _ = evaluated(Right(), TASKS, tmp_path)
    text = (tmp_path / "episodes.csv").read_bytes()
    policy = Right()
    after, left = evaluated(policy, TASKS, str(tmp_path))  # a string is a path, too
    assert (after, left, policy.episodes) == (before, 0, 0)
    assert (tmp_path / "episodes.csv").read_bytes() == text


def test_an_interrupted_evaluation_resumes(tmp_path):
    whole, _ = evaluated(Right(), TASKS, tmp_path / "whole")
    # 3 episodes, 8, and the first of the last 2; before each of these parts it decides once, which is not measured.
    with pytest.raises(KeyboardInterrupt):
        evaluated(Interrupted((1 + 3) + (1 + 8) + (1 + 1)), TASKS, tmp_path / "part")
    assert len(rows(tmp_path / "part")) == 3 + 8
    policy = Right()
    resumed, left = evaluated(policy, TASKS, tmp_path / "part")
    assert (left, policy.episodes) == (2, 1 + 2)
    assert untimed(resumed) == untimed(whole)
    assert len(rows(tmp_path / "part")) == ALL


@pytest.mark.parametrize("kept", [0, 1, 17, -1, -30], ids="{} bytes".format)
def test_a_line_that_was_cut_is_done_again(tmp_path, kept):
    whole, _ = evaluated(Right(), TASKS, tmp_path)
    file = tmp_path / "episodes.csv"
    text = file.read_bytes()
    file.write_bytes(text[:kept])
    lost = 1 if kept < 0 else ALL
    assert text[:kept].count(b"\n") == (1 + ALL - lost if kept < 0 else 0)
    again, left = evaluated(Right(), TASKS, tmp_path)
    assert left == lost
    assert untimed(again) == untimed(whole)
    assert len(rows(tmp_path)) == ALL


@pytest.mark.parametrize("text", ["policy,episode\n", "notes of mine", HEADER.replace("CSR", "csr") + "\n"])
def test_a_file_with_other_columns_is_not_changed(tmp_path, text):
    (tmp_path / "episodes.csv").write_text(text)
    with pytest.raises(FormatError, match=r"episodes\.csv:1: expected the columns policy, task"):
        evaluated(Right(), TASKS, tmp_path)
    assert (tmp_path / "episodes.csv").read_text() == text


def test_results_of_an_earlier_version_are_refused_or_replaced(tmp_path):
    text = HEADER.replace("suite,", "") + "\nright,drawn,1,0,,0,1\n"
    (tmp_path / "episodes.csv").write_text(text)
    with pytest.raises(FormatError, match=r"episodes\.csv:1: results of an earlier version, without suites: evaluate"):
        evaluated(Right(), TASKS, tmp_path)
    assert (tmp_path / "episodes.csv").read_text() == text
    evaluate({"right": Right()}, TASKS, tmp_path, overwrite=True)
    assert len(rows(tmp_path)) == ALL


def earlier(text, later):
    """Return a file as it was before there were the columns `later`."""
    kept = [column for column, name in enumerate(COLUMNS) if name not in later]
    return "".join(",".join(line.split(",")[column] for column in kept) + "\n" for line in text.splitlines())


@pytest.mark.parametrize("later", [DELAY_METRICS, (*WEIGHTED_METRICS, *DELAY_METRICS)])
def test_results_of_earlier_versions_are_read_and_completed(tmp_path, later):
    whole, _ = evaluated(Right(), TASKS, tmp_path)
    file = tmp_path / "episodes.csv"
    text = earlier(file.read_text(), later)
    assert not any(name in text for name in later)
    for content, left in ((text, 0), (text[:-5], 1), (text[:40], ALL)):
        file.write_text(content)
        assert read_episodes(tmp_path) == whole[: ALL - left]
        assert file.read_text() == content
        again, undone = evaluated(Right(), TASKS, tmp_path)
        assert (untimed(again), undone) == (untimed(whole), left)
        assert [tuple(row) for row in rows(tmp_path)] == [COLUMNS] * ALL
    file.write_text(text.replace(",1,0", ",1,0,0", 1))
    with pytest.raises(
        FormatError, match=rf"episodes\.csv:2: expected an episode of {len(COLUMNS) - len(later)} values"
    ):
        read_episodes(tmp_path)


def test_metrics_of_delays_are_written(tmp_path):
    keywords = {"max_steps": 40, "delays": "0.3:1-2"}
    task = EvaluationTask("drawn", 1, keywords, 8, instances=(drawn("a...A"),))
    episodes, _ = evaluated(Right(), [task], tmp_path)
    assert read_episodes(tmp_path) == episodes
    assert 0 < np.mean([one.metrics["delay_share"] for one in episodes]) < 1
    assert {one.metrics["delayed_SoC_ratio"] for one in episodes} == {1}  # nobody is in its way
    assert np.mean([one.metrics["SoC_ratio"] for one in episodes]) > 1


def test_weighted_costs_are_written_and_may_be_infinite(tmp_path):
    graph = GuidanceGraph(np.full((4, 1, 5), 0.25), np.full((1, 5), 2.0))
    task = EvaluationTask("drawn", 1, {"max_steps": 6, "edge_weights": graph}, 1, instances=(drawn("a...A"),))
    (episode,), _ = evaluated(Right(), [task], tmp_path)
    assert (episode.metrics["weighted_cost"], episode.metrics["weighted_cost_ratio"]) == (4 * 0.25, 1)
    assert read_episodes(tmp_path) == [episode]
    results = Results(tmp_path)
    results.add(replace(episode, number=1, metrics=episode.metrics | dict.fromkeys(WEIGHTED_METRICS, math.inf)))
    assert [row["weighted_cost"] for row in rows(tmp_path)] == ["1.0", "inf"]
    assert read_episodes(tmp_path) == results.episodes


def test_results_state_their_suite(tmp_path):
    (task,) = (replace(task, suite="mine/1 ab") for task in TASKS[:1])
    (episode, *_), _ = evaluated(Right(), [task], tmp_path)
    assert episode.suite == "mine/1 ab"
    assert {row["suite"] for row in rows(tmp_path)} == {"mine/1 ab"}
    with pytest.raises(ValueError, match=r"task '1 agents on drawn': suite differs; expected another folder"):
        Results(tmp_path, Identities.of({}, [replace(task, suite="mine/2 ab")]))


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("right,drawn,1", f"expected an episode of {len(COLUMNS)} values, got 3"),
        ("", f"expected an episode of {len(COLUMNS)} values, got 0"),
        ('right,"drawn,1,2,,0,' + "," * (len(METRICS) + 1), "expected CSV"),
        ({"num_agents": "0"}, "num_agents='0': expected a whole number, 1 or more"),
        ({"episode": "two"}, "episode='two': expected a whole number, 0 or more"),
        ({"episode": "1_0"}, "episode='1_0': expected a whole number, 0 or more"),
        ({"seed": "-5"}, "seed='-5': expected a whole number, 0 or more"),
        ({"seed": "9" * 9999}, r"seed='9+\.\.\.9+': expected a whole number"),
        ({"ISR": "high"}, "ISR='high': expected a number from 0 to 1"),
        ({"CSR": "5"}, "CSR='5': expected a number from 0 to 1"),
        ({"ISR": "-1"}, "ISR='-1': expected a number from 0 to 1"),
        ({"collisions": "nan"}, "collisions='nan': expected a number from 0 to 1"),
        ({"SoC": "1_0"}, "SoC='1_0': expected a finite number, 0 or more"),
        ({"makespan": "inf"}, "makespan='inf': expected a finite number"),
        ({"step_ms": "Infinity"}, "step_ms='Infinity': expected a finite number"),
        ({"weighted_cost": "1e999"}, "weighted_cost='1e999': expected a finite number"),
        ({"SoC_ratio": "1e999"}, "SoC_ratio='1e999': expected a finite number"),
        ({"SoC": ""}, "expected the metrics CSR, ISR, SoC, makespan, .*, got CSR, ISR, SoC_ratio"),
        ({"avg_throughput": "0.5"}, "expected the metrics avg_throughput, ep_length, .*, got CSR, ISR, SoC"),
        (dict.fromkeys(METRICS, ""), "expected the metrics CSR, .*, got none"),
        ({"episode": "0"}, "the same policy, task and episode as in line 2"),
        ({"seed": "7"}, "seed=7: expected 1000001, that of the task"),
        ({"instance": "other"}, "instance='other': expected 'drawn', that of the task"),
        ({"suite": "other"}, "suite='other': expected '', that of the task"),
    ],
)
def test_a_malformed_row_is_an_error(tmp_path, row, message):
    evaluated(Right(), TASKS[:1], tmp_path)
    lines = (tmp_path / "episodes.csv").read_text().splitlines()
    cells = dict(zip(COLUMNS, lines[2].split(","), strict=True))
    lines[2] = row if isinstance(row, str) else ",".join((cells | row).values())
    (tmp_path / "episodes.csv").write_text("\n".join(lines) + "\n")
    with pytest.raises(FormatError, match=rf"episodes\.csv:[34]: {message}"):
        evaluated(Right(), TASKS[:1], tmp_path)


def test_bytes_that_are_no_text(tmp_path):
    (tmp_path / "episodes.csv").write_bytes(f"{HEADER}\n".encode() + b"\xff\n")
    with pytest.raises(FormatError, match=r"episodes\.csv:2: expected UTF-8 text"):
        read_episodes(tmp_path)


def test_reading_does_not_write(tmp_path):
    whole, _ = evaluated(Right(), TASKS, tmp_path)
    file = tmp_path / "episodes.csv"
    partial = file.read_bytes()[:-5]
    file.write_bytes(partial)
    assert read_episodes(tmp_path) == whole[:-1]
    assert main(["report", str(tmp_path)]) == 0
    assert file.read_bytes() == partial


def test_more_and_fewer_episodes(tmp_path):
    evaluated(Right(), TASKS, tmp_path)
    more, left = evaluated(Right(), [task.with_(episodes=task.episodes + 2) for task in TASKS], tmp_path)
    assert (left, len(more)) == (4, ALL + 4)
    fewer, left = evaluated(Right(), [task.with_(episodes=2) for task in TASKS], tmp_path)
    assert (left, len(fewer)) == (0, 4)
    assert fewer == [episode for episode in more if episode.number < 2]


def test_policies_can_be_added(tmp_path):
    first, _ = evaluated(Right(), TASKS, tmp_path)
    both, left = evaluated(None, TASKS, tmp_path, {"right": Right(), "random": "random"})
    assert (left, len(both)) == (ALL, 2 * ALL)
    assert [episode for episode in both if episode.policy == "right"] == first


@pytest.mark.parametrize("name", ["a,b", 'say "go"', "line\u2028separator", "a\nb", "Straße", "=1+1", "'=", "@x"])
def test_names_come_back_as_they_were(tmp_path, name):
    results = Results(tmp_path)
    required = dict.fromkeys((*metric_names("nothing"), "collisions"), 0.1)
    episodes = [Episode(name, "drawn", 1, n, required | {"SoC": 0.1 + n, "runtime": 1e-300}) for n in range(3)]
    for episode in episodes:
        results.add(episode)
    assert Results(tmp_path).episodes == episodes
    assert not any(row["policy"][0] in "=+-@" for row in rows(tmp_path))  # which spreadsheets evaluate


def test_the_folder_is_a_file(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(FileExistsError):
        evaluated(Right(), TASKS, tmp_path / "file")


def test_without_a_folder_nothing_is_written(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert len(evaluated(Right(), TASKS, None)[0]) == ALL
    assert os.listdir(tmp_path) == []
