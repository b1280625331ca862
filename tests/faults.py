"""Kill evaluations and trainings at random times, and resume them: `python -m tests.faults --rounds 50`.

A round is a kill and a resumption in the same folder, until the work is finished. It raises `AssertionError` if
anything written is lost, duplicated, or different from a run without kills.
"""

from __future__ import annotations

import argparse
import csv
import io
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from pathlib import Path
from signal import Signals

from mapf_pz.commands.main import main
from mapf_pz.evaluation.results import COLUMNS, EPISODES_FILE
from tests.evaluation.test_parallel import children_of, is_alive, wait_for

SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
TIMES = {"runtime", "step_ms", "agent_us"}
"""The columns of an episode that differ between runs."""
EVALUATE = "evaluate --policy pibt --policy random --map room-20-20-5 --num-agents 5"
SMALL = "--num-envs 4 --steps-per-batch 8 --minibatch-size 8 --num-epochs 1 --num-agents 3 --height 7 --width 7"
STEPS_PER_UPDATE = 4 * 8 * 3
INTERVAL = 4 * STEPS_PER_UPDATE
"""Agent steps between checkpoints."""
STARTING = 0.2
"""Fraction of kills that are sent while the command is still importing modules."""


@dataclass
class Tally:
    """Counts of kills, resumptions and rows."""

    kills: Counter[tuple[str, str, str]] = field(default_factory=Counter)
    """By kind of work, target, and signal."""
    resumes: int = 0
    written: int = 0
    """Episodes, or rows of progress up to a checkpoint, that were in the file before a kill."""

    def of(self, kind: str) -> int:
        """Return the number of kills of a kind of work."""
        return sum(count for key, count in self.kills.items() if key[0] == kind)

    def table(self) -> str:
        """Return a table with the kills by kind, and the sums."""
        lines = [f"{'killed':12}{'who':10}" + "".join(f"{sent.name:>9}" for sent in SIGNALS)]
        for kind, whom in sorted({key[:2] for key in self.kills}):
            counts = (self.kills[kind, whom, sent.name] for sent in SIGNALS)
            lines.append(f"{kind:12}{whom:10}" + "".join(f"{count:9}" for count in counts))
        sums = f"{self.kills.total()} kills, {self.resumes} resumes; {self.written} rows written before a kill"
        return "\n".join([*lines, sums])


@dataclass(frozen=True)
class End:
    """How a command ended."""

    status: int
    killed: bool
    """Whether the signal was sent; otherwise it had finished before."""
    lines: list[str]
    """Lines of its standard error."""


# Processes.


def command(words: Sequence[object]) -> list[str]:
    """Return the command line of `mapf-pz`."""
    return [sys.executable, "-m", "mapf_pz", *map(str, words)]


def complete(words: Sequence[object], room: int | None = None) -> End:
    """Run `mapf-pz` to its end; with `room`, the size of its files is limited to this many bytes, as on a full disk."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    if room is not None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (room, limits[1]))
    try:
        with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()) as message:
            status = main([str(word) for word in words])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    return End(status, False, message.getvalue().splitlines())


def kill(
    words: Sequence[object], ready: Callable[[int], bool], after: float, sent: Signals, whom: str = "group"
) -> End:
    """Run `mapf-pz`, and send a signal `after` seconds after it is ready; return when all its processes have ended.

    Args:
        words: the command.
        ready: whether the process with this number is ready to be killed.
        after: delay of the signal in seconds.
        sent: the signal.
        whom: `group` for all processes, or `worker` for one of those that the command has started.
    """
    with (
        tempfile.TemporaryFile("w+") as message,
        subprocess.Popen(command(words), stdout=-3, stderr=message, start_new_session=True) as running,
    ):
        wait_for(lambda: ready(running.pid) or running.poll() is not None)
        time.sleep(after)
        others = children_of(running.pid)
        workers = [running.pid]
        if whom == "worker":  # one that is between two jobs cannot be identified
            workers = []
            wait_for(lambda: running.poll() is not None or workers.extend(workers_of(running.pid)) or workers)
        killed = running.poll() is None and bool(workers)
        if killed:
            (os.kill if whom == "worker" else os.killpg)(workers[0], sent)
        status = running.wait(600)  # a hang is an error
        wait_for(lambda: not any(map(is_alive, others)))
        message.seek(0)
        return End(status, killed, message.read().splitlines())


def workers_of(process_id: int) -> list[int]:
    """Return the processes that work for a command: direct ones, or those of Ray, which are children of a child."""
    found = []
    for child in filter(is_alive, children_of(process_id)):
        words = Path(f"/proc/{child}/cmdline").read_text()
        found += [child] if "spawn_main" in words or words.startswith("ray::_run") else workers_of(child)
    return found


def check_end(name: str, end: End, sent: Signals, whom: str) -> None:
    """Check the output of a killed command: one line, none after SIGKILL, and anything during its imports."""
    if whom == "starting":
        assert end.status in (1, 130, -sent), end
        return
    if whom == "worker":
        expected = (1, 1)
        assert end.lines[0].startswith(f"mapf-pz {name}: "), end
    elif sent == signal.SIGKILL:
        expected = (-signal.SIGKILL, 0)
    else:
        expected = (130, 1)
        assert end.lines == [f"mapf-pz {name}: interrupted"], end
    assert (end.status, len(end.lines)) == expected, end


# Evaluation.


def episode_lines(folder: Path) -> list[str]:
    """Return the complete lines of the file of episodes, without its header."""
    file = folder / EPISODES_FILE
    return [line for line in file.read_text().splitlines(True)[1:] if line.endswith("\n")] if file.exists() else []


def untimed(lines: Sequence[str]) -> dict[tuple[str, ...], dict[str, str]]:
    """Return the episodes by key, without the times; checks that the keys are unique."""
    rows = list(csv.DictReader(lines, COLUMNS))
    found = {
        (row["policy"], row["task"], row["num_agents"], row["episode"]): {
            name: value for name, value in row.items() if name not in TIMES
        }
        for row in rows
    }
    assert len(found) == len(rows)
    return found


def evaluate_words(folder: Path, episodes: int, jobs: int | str = 1, max_steps: int = 64) -> list[object]:
    """Return the words of an evaluation."""
    length = ["--episodes", episodes, "--max-steps", max_steps]
    return [*EVALUATE.split(), *length, "--jobs", jobs, "--output", folder]


def kill_evaluations(folder: Path, kills: int, episodes: int, draw: random.Random, counters: Tally) -> None:
    """Kill and resume an evaluation repeatedly, and compare its results with those of one that is not killed."""
    out, whole = folder / "killed", folder / "whole"
    assert complete(evaluate_words(whole, episodes)).status == 0
    before: list[str] = []
    for number in range(kills):
        sent, jobs = SIGNALS[number % 3], draw.choice([1, 2])
        whom = draw.choice(["group", "worker"]) if jobs == 2 and sent != signal.SIGINT else "group"
        wanted = len(before) + draw.randint(1, 40)
        words = evaluate_words(out, episodes, jobs)
        if draw.random() < STARTING:
            whom = "starting"
            end = kill(words, lambda _: True, draw.uniform(0, 3), sent, whom)
        else:
            end = kill(words, lambda _: len(episode_lines(out)) >= wanted, draw.uniform(0, 0.05), sent, whom)  # noqa: B023
        now = episode_lines(out)
        counters.resumes += number > 0
        assert now[: len(before)] == before
        # It was over before, or it went on without a worker that had nothing left to do.
        if not end.killed or (whom == "worker" and end.status == 0):
            assert (end.status, len(now)) == (0, len(episode_lines(whole))), end
            break
        check_end("evaluate", end, sent, whom)
        counters.kills["evaluation", whom, sent.name] += 1
        counters.written += len(now) - len(before)
        before = now
    assert complete(evaluate_words(out, episodes, 2)).status == 0
    counters.resumes += 1
    now = episode_lines(out)
    assert now[: len(before)] == before
    assert untimed(now) == untimed(episode_lines(whole))
    assert (out / "evaluation.md").exists()


# Training.


def progress_lines(folder: Path) -> list[str]:
    """Return the complete lines of the progress file, without its header; checks the numbers of agent steps."""
    file = folder / "progress.csv"
    lines = file.read_bytes().decode().splitlines(True) if file.exists() else []
    rows = [line for line in lines[1:] if line.endswith("\r\n")]
    assert [int(row.partition(",")[0]) for row in rows] == [STEPS_PER_UPDATE * (i + 1) for i in range(len(rows))]
    assert all(row.count(",") == lines[0].count(",") for row in rows)
    return rows


def changed(file: Path) -> tuple[int, int]:
    """Return a key that changes whenever a file is written."""
    return (file.stat().st_ino, file.stat().st_mtime_ns) if file.exists() else (0, 0)


def updates_kept(folder: Path) -> int:
    """Return the number of updates of the latest checkpoint, or 0; checks that all checkpoints are readable."""
    from mapf_pz.rl import load_policy
    from mapf_pz.rl.policies.folder import WEIGHTS
    from mapf_pz.rl.training.checkpoint import read_position

    if (folder / WEIGHTS).exists():
        load_policy(folder)
    files = sorted((folder / "checkpoints").glob("checkpoint-*"))
    return [0, *(read_position(file).updates for file in files)][-1]


def train_words(folder: Path, updates: int, num_learners: int = 1) -> list[object]:
    """Return the words that start a training."""
    length = ["--agent-steps", updates * STEPS_PER_UPDATE, "--checkpoint-interval", INTERVAL]
    learners = ["--num-learners", num_learners, "--evaluate", "none"]
    return ["train", "quickstart", *SMALL.split(), *length, *learners, "--output", folder, "--overwrite"]


def resume_words(folder: Path, num_learners: int) -> list[object]:
    """Return the words that continue a training."""
    return ["train", "resume", folder, "--num-learners", num_learners, "--evaluate", "none"]


def kill_trainings(folder: Path, kills: int, updates: int, draw: random.Random, counters: Tally) -> None:
    """Kill and resume a training repeatedly; check its files after each kill and at the end."""
    run, twin = folder / "run", folder / "twin"
    kept = 0
    before: list[str] = []
    for number in range(kills):
        sent = SIGNALS[number % 3]
        wanted = kept + draw.randint(1, 6)
        num_learners = draw.choice([1, 2])
        words = resume_words(run, num_learners) if kept else train_words(run, updates, num_learners)
        counters.resumes += kept > 0
        stale = changed(run / "progress.csv")
        ready = lambda _: changed(run / "progress.csv") != stale and len(progress_lines(run)) >= wanted  # noqa: B023, E731
        whom = "worker" if num_learners == 2 and sent == signal.SIGKILL and draw.random() < 0.5 else "group"
        if draw.random() < STARTING:
            whom = "starting"
            end = kill(words, lambda _: True, draw.uniform(0, 8), sent, whom)
        else:
            end = kill(words, ready, draw.uniform(0, 0.4), sent, whom)
        now, kept_before = progress_lines(run), kept
        assert now[:kept_before] == before[:kept_before]
        kept = updates_kept(run)
        if not end.killed:
            assert end.status == 0, end
            break
        check_end("train", end, sent, whom)
        counters.kills["training", whom, sent.name] += 1
        counters.written += kept - kept_before
        lost_rank_0 = (sent == signal.SIGKILL and whom == "group") or whom == "starting"
        since = INTERVAL // STEPS_PER_UPDATE if lost_rank_0 else 1
        assert kept_before <= kept <= len(now) <= kept + since, f"{len(now)} updates, {kept} of them kept"
        before = now
    if not kept:
        [message] = complete(resume_words(run, 1)).lines
        assert message.startswith("mapf-pz train: no checkpoint in "), message
        assert complete(train_words(run, updates)).status == 0
        kept = updates
    shutil.copytree(run, twin)
    for name in (run, twin):
        assert complete(resume_words(name, 1)).status == 0
    counters.resumes += 1
    now = progress_lines(run)
    assert now[: len(before[:kept])] == before[:kept]
    assert len(now) == updates == updates_kept(run)
    assert not list((run / "checkpoints").glob(".*"))
    weights = [(name / "policy.safetensors").read_bytes() for name in (run, twin)]
    assert weights[0] == weights[1]  # the same checkpoint leads to the same policy


# The command.


def do_rounds() -> None:
    """Run the rounds and print the table, also after an error or Ctrl-C."""
    parser = argparse.ArgumentParser(description="Kill evaluations and trainings at random moments; let them go on.")
    parser.add_argument("--rounds", type=int, default=50, help="number of kills")
    parser.add_argument("--trainings", type=int, help="number of kills of trainings (default: a fifth)")
    parser.add_argument("--episodes", type=int, default=400, help="number of episodes of each policy in an evaluation")
    parser.add_argument("--updates", type=int, default=40, help="number of updates of a training")
    parser.add_argument("--seed", type=int, default=0, help="random seed of the times")
    options = parser.parse_args()
    trainings = options.rounds // 5 if options.trainings is None else options.trainings
    # Processes that a shell starts in the background ignore Ctrl-C, and so would their children.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    start, draw, counters = time.monotonic(), random.Random(options.seed), Tally()
    try:
        while (left := options.rounds - trainings - counters.of("evaluation")) > 0:
            with tempfile.TemporaryDirectory() as folder:
                kill_evaluations(Path(folder), min(left, 12), options.episodes, draw, counters)
        while (left := trainings - counters.of("training")) > 0:
            with tempfile.TemporaryDirectory() as folder:
                kill_trainings(Path(folder), min(left, 6), options.updates, draw, counters)
    finally:
        print(counters.table())
        print(f"{time.monotonic() - start:.0f} seconds")


if __name__ == "__main__":
    do_rounds()
