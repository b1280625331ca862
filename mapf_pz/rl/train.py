"""The training loop, shared by all algorithms: collect or replay a batch, learn, log."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from tensordict import TensorDictBase

from mapf_pz.errors import FormatError
from mapf_pz.interrupts import interrupts_deferred
from mapf_pz.io.atomic import naming
from mapf_pz.rl.algorithm import Algorithm
from mapf_pz.rl.algorithms import algorithm_of
from mapf_pz.rl.checkpoint import read_position
from mapf_pz.rl.config import TrainConfig
from mapf_pz.rl.config_file import CONFIG, config_files, load_config
from mapf_pz.rl.learner import Learner
from mapf_pz.rl.networks import Actor
from mapf_pz.rl.policy import load_policy
from mapf_pz.rl.run import RunFolder
from mapf_pz.rl.stopwatch import Stopwatch
from mapf_pz.rl.validation import Validation, episode_means

Progress = Callable[[dict[str, float]], None]
MakeAlgorithm = Callable[[TrainConfig], Algorithm]


def _named_algorithm(config: TrainConfig) -> Algorithm:
    return algorithm_of(config.algorithm)(config)


def train(
    config: TrainConfig,
    output: str | Path,
    on_progress: Progress | None = None,
    make_algorithm: MakeAlgorithm = _named_algorithm,
    overwrite: bool = False,
) -> Path:
    """Train a policy, and return the folder that holds the policy, its configuration and its progress.

    Args:
        config: the configuration of the run.
        output: the run's folder.
        on_progress: called after each update with the row that is written to `progress.csv`.
        make_algorithm: creates the algorithm, if it is not the one named by the configuration; `load_policy` always
            uses the network of the named algorithm.
        overwrite: replace an existing run in `output`.

    Nothing is written before the networks and the environments have been created, so an invalid configuration leaves
    the folder unchanged.

    An interrupt (Ctrl-C, SIGTERM) ends the run after the current update, and a second one immediately. A checkpoint is
    saved before the interrupt is raised, and `resume` continues from it.

    Raises:
        FileExistsError: The folder holds a run, and `overwrite` is False.
        FileNotFoundError: There is no such map.
        FormatError: The map's file is malformed.
        ValueError: The configuration is not valid, or there is no GPU for `device="cuda"`.
    """
    run = RunFolder(Path(output))
    if not overwrite:
        run.check_unused()
    return _run(config, run, None, on_progress, make_algorithm)


def resume(
    folder: str | Path,
    agent_steps: int | None = None,
    on_progress: Progress | None = None,
    make_algorithm: MakeAlgorithm = _named_algorithm,
) -> Path:
    """Continue a run that was interrupted or killed from its latest checkpoint, and return its folder.

    Args:
        folder: the run's folder.
        agent_steps: minimum length of the whole run, in steps of all agents together; None keeps the run's own value.
        on_progress: as in `train`.
        make_algorithm: as in `train`.

    Checkpoints do not contain the environments: these start new episodes, with seeds that the run has not used before.

    Raises:
        FileNotFoundError: The folder has no configuration, no progress or no checkpoint.
        FormatError: One of them is damaged, or they do not belong together.
        ValueError: The run is already longer than `agent_steps`.
    """
    run = RunFolder(Path(folder))
    checkpoint = run.checkpoints.latest()
    config = load_config(run.path / CONFIG)
    position = read_position(checkpoint)
    if position.agent_steps != position.updates * config.steps_per_update:
        raise FormatError(checkpoint, f"not a checkpoint of the run that {CONFIG} describes")
    if agent_steps is not None:
        if agent_steps < position.agent_steps:
            raise ValueError(
                f"agent_steps={agent_steps}: the run in {str(folder)!r} has already reached {position.agent_steps}"
            )
        config = replace(config, agent_steps=agent_steps)
    return _run(config, run, checkpoint, on_progress, make_algorithm)


def _run(
    config: TrainConfig, run: RunFolder, checkpoint: Path | None, on_progress: Progress | None, make: MakeAlgorithm
) -> Path:
    """Train from the start or from a checkpoint."""
    config_files(config)  # raises for a configuration that cannot be saved, before workers start
    torch.manual_seed(config.seed)
    torch.set_num_threads(config.num_threads)
    with _device(config):
        algorithm = make(config)
        if config.initial_policy is not None:
            _start_from(config.initial_policy, config.initial_temperature, algorithm)
    learner = algorithm.make_learner()
    done = 0 if checkpoint is None else run.restore(checkpoint, learner)
    with interrupts_deferred() as check, _batches(config, algorithm, done) as batches:
        with naming(run.path):
            run.prepare(config)
        try:
            for row in _updates(config, algorithm, learner, batches, done, run.seconds):
                with naming(run.path):
                    run.log(row)
                    run.save(learner, config.checkpoint_interval)
                if on_progress is not None:
                    on_progress(row)
                check()
            with naming(run.path):
                run.save(learner)
        except KeyboardInterrupt:
            with naming(run.path):
                run.save(learner)
            raise
        finally:
            with naming(run.path):
                run.finish(algorithm.network)
    return run.path


def _start_from(policy: str, temperature: float, algorithm: Algorithm) -> None:
    """Start from a trained policy."""
    network = load_policy(policy).network
    if temperature != 1:
        if not isinstance(network, Actor):
            raise ValueError(f"initial_temperature={temperature}: expected 1, since the initial policy has no logits")
        network.divide_logits(temperature)
    algorithm.start_from(network.to(next(algorithm.network.parameters()).device))


def _device(config: TrainConfig) -> torch.device:
    """Return the device of the networks; raises `ValueError` for `cuda` if there is no GPU."""
    present = torch.cuda.is_available()
    if config.device == "cuda" and not present:
        raise ValueError("device='cuda': torch finds no GPU; expected 'auto' or 'cpu'")
    return torch.device("cuda" if present and config.device != "cpu" else "cpu")


def _batches(config: TrainConfig, algorithm: Algorithm, done: int) -> AbstractContextManager[Iterator[TensorDictBase]]:
    """Return the context of the batches for the updates from `done` on."""
    left = config.num_updates - done
    if left <= 0:
        return nullcontext(iter(()))
    seed = config.seed if done == 0 else int(np.random.SeedSequence([config.seed, done]).generate_state(1)[0])
    return algorithm.batches(seed, left)


def _updates(
    config: TrainConfig,
    algorithm: Algorithm,
    learner: Learner,
    batches: Iterator[TensorDictBase],
    done: int,
    seconds_before: float,
) -> Iterator[dict[str, float]]:
    """Run the training loop from update `done` on, and yield a row of progress after each update."""
    watch, validation = Stopwatch(), Validation(algorithm, config)
    began = time.perf_counter() - seconds_before
    for update in range(done, config.num_updates):
        with watch.time("collecting"), watch.calls(algorithm.actor, "acting"):
            batch = next(batches)
        with watch.time("learning"):
            losses = learner.learn(batch, update / config.num_updates)
        agent_steps, seconds = (update + 1) * config.steps_per_update, time.perf_counter() - began
        yield {
            "agent_steps": agent_steps,
            "seconds": seconds,
            "agent_steps_per_second": agent_steps / seconds,
            **_shares(watch.lap()),
            **_episode_means(config, batch),
            **losses,
            **validation.after(agent_steps, last=update + 1 == config.num_updates),
        }


def _episode_means(config: TrainConfig, batch: TensorDictBase) -> dict[str, float]:
    """Return the statistics of the episodes that end in a batch; nothing for data without episodes."""
    after = batch.get("next", None)
    return {} if after is None else episode_means(config.task, after, after.get("done"))


def _shares(seconds: dict[str, float]) -> dict[str, float]:
    """Return the fractions of an update's time: environments and collector, the policy during collection, and learning.

    Waiting for workers counts as collecting.
    """
    total, acting = seconds["collecting"] + seconds["learning"], seconds.get("acting", 0.0)
    return {
        "collecting_share": (seconds["collecting"] - acting) / total,
        "acting_share": acting / total,
        "learning_share": seconds["learning"] / total,
    }
