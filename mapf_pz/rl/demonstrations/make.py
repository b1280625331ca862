"""Make a dataset: run the planner in all episodes, and write the demonstrations and a card."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

from mapf_pz._internal.atomic import write_whole
from mapf_pz._internal.lock import locked
from mapf_pz.planners import planner_of
from mapf_pz.planners.deadline import WorkClock
from mapf_pz.planners.named import import_code
from mapf_pz.rl.demonstrations.card import card
from mapf_pz.rl.demonstrations.config import DatasetConfig
from mapf_pz.rl.demonstrations.demonstration import Demonstration, demonstrate
from mapf_pz.rl.demonstrations.folder import CARD_FILE, ShardJob, inputs_digest, open_folder, shard_jobs
from mapf_pz.rl.demonstrations.shard import write_shard
from mapf_pz.simulator.simulator import Simulator


class FinishedShard(NamedTuple):
    """The demonstrations of a shard."""

    file: str
    """The name of its file."""
    shape: tuple[int, int]
    """(H, W) of the maps."""
    num_agents: int
    """N, the number of agents."""
    demonstrations: list[Demonstration]


RunJobs = Callable[[Callable[[ShardJob], FinishedShard], Sequence[ShardJob]], Iterable[FinishedShard]]
"""A function that calls another one with each job, and returns the results in any order."""


def make_dataset(
    config: DatasetConfig,
    folder: str | Path,
    run: RunJobs = map,
    show: Callable[[int], object] = lambda left: None,
    command: str = "",
) -> None:
    """Make demonstrations, and write them to a folder with a card. Finished shards in the folder are kept.

    The result depends neither on interruptions nor on the number of processes, except with planners whose decisions
    depend on a time limit.

    Args:
        config: the planner and the episodes.
        folder: the folder.
        run: how jobs are run: `map`, sequentially in this process, or a function like it, such as
            `ProcessPoolExecutor().map`. The order of the results does not matter.
        show: called with the number of shards that are left, at first and after each one.
        command: the command for the card; empty: none.

    Raises:
        BlockingIOError: another process is writing to the folder.
        ValueError: a setting is invalid, the folder contains a dataset with other settings or inputs, or a file was
            replaced meanwhile.
        FileNotFoundError, FormatError: the file of a map or scenario is missing or malformed.
    """
    folder = Path(folder)
    with locked(folder):
        settings = open_folder(folder, config)
        left = [job for job in shard_jobs(config) if not (folder / job.file).exists()]
        show(len(left))
        for number, shard in enumerate(run(partial(make_shard, inputs=settings["inputs"]), left), 1):
            write_shard(folder / shard.file, shard.demonstrations, shard.shape, shard.num_agents)
            show(len(left) - number)
        write_whole(folder / CARD_FILE, card(folder, settings, config, command).encode())


def make_shard(job: ShardJob, inputs: str) -> FinishedShard:
    """Run the planner in the episodes of a shard.

    Raises `ValueError` unless the digest of the dataset's inputs, which are read from their files, is `inputs`.
    """
    config = job.config
    simulator = Simulator(config.env_config(job.num_agents))
    import_code(config.planner)  # in another process, it is not imported yet
    planner = planner_of(config.planner, config.seed)
    if not isinstance(planner.clock, WorkClock):
        planner.clock = time.thread_time
    planner.compile(config.env.action_model)
    episodes = range(job.first, job.first + job.episodes)
    made = [demonstrate(simulator, planner, config.seed + episode) for episode in episodes]
    if inputs_digest(config) != inputs:
        raise ValueError("a map, scenario or edge weights differ from the start; expected files that do not change")
    kept = [d for d in made if not config.solved_only or d.metrics.get("CSR", 1) == 1]
    return FinishedShard(job.file, simulator.shape, job.num_agents, kept)
