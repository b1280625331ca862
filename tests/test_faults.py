"""A few kills, full disks and wrong folders; `python -m tests.faults` does many more."""

import os
import random
import signal
from itertools import count

import pytest

from mapf_pz.instances import load_map, write_map
from tests import faults
from tests.faults import (
    Tally,
    complete,
    episode_lines,
    evaluate_words,
    kill,
    kill_evaluations,
    kill_trainings,
    progress_lines,
    train_words,
    untimed,
    updates_kept,
    workers_of,
)

LONG = 4000
"""A number of steps of an episode that keeps a worker busy for a tenth of a second."""
pytestmark = pytest.mark.skipif(not os.path.isdir("/proc/self"), reason="looks up processes in /proc")


@pytest.fixture(autouse=True)
def only_kills_at_work(monkeypatch):
    monkeypatch.setattr(faults, "STARTING", 0)


def until_killed(kill_some, kills, size, folder):
    """Kill work of this size; if it ends before, as on a fast machine, kill work that is longer."""
    for number in count():
        counters = Tally()
        (folder / str(number)).mkdir()
        kill_some(folder / str(number), kills, size * 4**number, random.Random(0), counters)
        if counters.kills.total() == kills:
            return counters


@pytest.mark.slow
def test_a_killed_evaluation_resumes(tmp_path):
    counters = until_killed(kill_evaluations, 2, 400, tmp_path)
    assert counters.resumes == 2
    assert counters.written >= 2


@pytest.mark.slow
def test_a_killed_training_run_resumes(tmp_path):
    pytest.importorskip("torchrl")
    until_killed(kill_trainings, 1, 20, tmp_path)


@pytest.mark.slow
def test_ctrl_c_while_processes_start(tmp_path):
    """They are still loading Python when it comes, and must not tell of it."""
    words = evaluate_words(tmp_path / "out", 50, 2)
    end = kill(words, lambda process_id: len(workers_of(process_id)) == 2, 0, signal.SIGINT)
    assert (end.status, end.lines) == (130, ["mapf-pz evaluate: interrupted"])


@pytest.mark.parametrize("jobs", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_an_evaluation_resumes_after_a_full_disk(tmp_path, jobs):
    words = evaluate_words(tmp_path / "out", 20, jobs)
    end = complete(words, room=3000)
    told = f"mapf-pz evaluate: [Errno 27] File too large: '{tmp_path / 'out' / 'episodes.csv'}'"
    assert (end.status, end.lines) == (1, [told])
    before = episode_lines(tmp_path / "out")
    assert len(before) > 10
    assert complete(words).status == 0
    assert episode_lines(tmp_path / "out")[: len(before)] == before
    assert complete(evaluate_words(tmp_path / "whole", 20)).status == 0
    assert untimed(episode_lines(tmp_path / "out")) == untimed(episode_lines(tmp_path / "whole"))


def test_a_line_cut_within_a_character(tmp_path):
    write_map(load_map("empty-8-8"), tmp_path / "größe.map")
    words = ["evaluate", "--policy", "pibt", "--map", tmp_path / "größe.map", "--episodes", 3, "--output", tmp_path]
    assert complete(words).status == 0
    file = tmp_path / "episodes.csv"
    before = file.read_bytes()
    file.write_bytes(before[: before.rindex("ö".encode()) + 1])
    assert complete(words).status == 0
    assert untimed(episode_lines(tmp_path)) == untimed(before.decode().splitlines(True)[1:])


@pytest.mark.slow
def test_training_starts_on_a_full_disk(tmp_path):
    pytest.importorskip("torchrl")
    end = complete(train_words(tmp_path, 5), room=100_000)  # less than a checkpoint, and than the policy
    assert (end.status, len(end.lines)) == (1, 1)
    assert end.lines[0].startswith(f"mapf-pz train: [Errno 27] File too large: '{tmp_path}")
    assert "File too large" in end.lines[0]
    assert updates_kept(tmp_path) == 0
    assert complete(train_words(tmp_path, 5)).status == 0
    assert len(progress_lines(tmp_path)) == updates_kept(tmp_path) == 5


@pytest.mark.slow
def test_training_resumes_after_a_full_disk(tmp_path):
    pytest.importorskip("torchrl")
    assert complete(train_words(tmp_path, 5)).status == 0
    rows, kept = progress_lines(tmp_path), max((tmp_path / "checkpoints").iterdir())
    content = kept.read_bytes()
    longer = ["train", "resume", tmp_path, "--agent-steps", 10 * faults.STEPS_PER_UPDATE, "--evaluate", "none"]
    for missing in (500, 100_000):  # room for a checkpoint's parts and not the whole, and not for its parts either
        end = complete(longer, room=len(content) - missing)
        assert (end.status, len(end.lines)) == (1, 1)
        assert "File too large" in end.lines[0]
        assert "delete it" not in end.lines[0]
        assert kept.read_bytes() == content
        assert progress_lines(tmp_path)[:5] == rows
        assert updates_kept(tmp_path) == 5
    assert complete(longer).status == 0
    assert len(progress_lines(tmp_path)) == updates_kept(tmp_path) == 10
    assert progress_lines(tmp_path)[:5] == rows


@pytest.mark.parametrize("name", ["evaluate", "train"])
def test_a_folder_that_cannot_be_written(tmp_path, name):
    if name == "train":
        pytest.importorskip("torchrl")
    (tmp_path / "file").write_text("kept")
    folder = tmp_path / "file" / "out"
    end = complete(evaluate_words(folder, 1) if name == "evaluate" else train_words(folder, 1))
    assert (end.status, end.lines) == (1, [f"mapf-pz {name}: [Errno 20] Not a directory: '{folder}'"])
    assert (tmp_path / "file").read_text() == "kept"


@pytest.mark.slow
def test_a_ray_worker_that_dies(tmp_path, monkeypatch):
    pytest.importorskip("ray")
    monkeypatch.setenv("RAY_AUTH_MODE", "disabled")
    monkeypatch.setenv("RAY_worker_niceness", "0")  # on a busy machine, its workers would never get their turn
    for number in count():  # the evaluation can be over before a worker is found at work: then a longer one
        out, episodes = tmp_path / str(number), 40 * 4**number
        words = evaluate_words(out, episodes, "ray", LONG)
        end = kill(words, lambda _: episode_lines(out), 0, signal.SIGKILL, "worker")  # noqa: B023
        if end.killed:
            break
        assert end.status == 0
    assert end.status == 0 or end.lines[-1].startswith("mapf-pz evaluate: Ray: "), end
    before = episode_lines(out)
    assert complete(evaluate_words(out, episodes, 1, LONG)).status == 0
    assert episode_lines(out)[: len(before)] == before
    assert complete(evaluate_words(tmp_path / "whole", episodes, 1, LONG)).status == 0
    assert untimed(episode_lines(out)) == untimed(episode_lines(tmp_path / "whole"))
