"""Training runs of all algorithms, in one or several processes: start, continue, and end them."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from tensordict import TensorDictBase

from mapf_pz._internal.atomic import naming
from mapf_pz._internal.interrupts import interrupts_deferred
from mapf_pz._internal.lock import locked
from mapf_pz._internal.machine import usable_cores
from mapf_pz.errors import FormatError
from mapf_pz.rl.algorithms.algorithm import Algorithm
from mapf_pz.rl.algorithms.learner import Learner
from mapf_pz.rl.algorithms.named import algorithm_of
from mapf_pz.rl.config import DeviceName, TrainConfig
from mapf_pz.rl.config_file import CONFIG, config_files, load_config
from mapf_pz.rl.networks.actors import Actor
from mapf_pz.rl.policies.load import load_policy, policy_config
from mapf_pz.rl.ranks import Ranks
from mapf_pz.rl.training.checkpoint import read_position
from mapf_pz.rl.training.launch import connecting, is_first, launched_size, local_rank
from mapf_pz.rl.training.loggers import check_loggers
from mapf_pz.rl.training.run import RunFolder, inputs_digest
from mapf_pz.rl.training.updates import updates
from mapf_pz.simulator.seeds import FIRST_RESUMED_SEED

LOGGER = logging.getLogger(__name__)

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
    trust_remote_code: bool = False,
) -> Path:
    """Train a policy, and return the folder that holds the policy, its configuration and its progress.

    Args:
        config: the configuration of the run.
        output: the run's folder.
        on_progress: called after each update with the row that is written to `progress.csv`.
        make_algorithm: creates the algorithm, if it is not the one named by the configuration; `load_policy` always
            uses the network of the named algorithm.
        overwrite: replace an existing run in `output`.
        trust_remote_code: load an `initial_policy`, or a run as `dataset`, whose configuration names code outside this
            package.

    Nothing is written before the networks and the environments have been created, so an invalid configuration leaves
    the folder unchanged.

    An interrupt (Ctrl-C, SIGTERM) ends the run after the current update, and a second one immediately. A checkpoint is
    saved before the interrupt is raised, and `resume` continues from it.

    With `num_learners`, this process is rank 0 and starts the others; under `torchrun`, all processes call this
    function, and only rank 0 uses `output` and calls `on_progress`.

    Raises:
        BlockingIOError: Another process is writing to the folder.
        ChildProcessError: Another learner has ended, for example because it was killed; `resume` continues.
        ConnectionError: The same under `torchrun`.
        FileExistsError: The folder holds a run, and `overwrite` is False.
        FileNotFoundError: There is no such map.
        FormatError: The map's file is malformed.
        ImportError: The package of a logger is not installed.
        ValueError: The configuration is not valid, or there is no GPU for `device="cuda"`.
    """
    run = RunFolder(Path(output))
    with locked(run.path if is_first() else None):
        if is_first() and not overwrite:
            run.check_unused()
        _check_trusted_inputs(config, trust_remote_code)
        return _run(config, run, None, on_progress, make_algorithm)


def resume(
    folder: str | Path,
    agent_steps: int | None = None,
    on_progress: Progress | None = None,
    make_algorithm: MakeAlgorithm = _named_algorithm,
    num_learners: int | Literal["auto"] | None = None,
    device: DeviceName | None = None,
    trust_remote_code: bool = False,
) -> Path:
    """Continue a run that was interrupted or killed from its latest checkpoint, and return its folder.

    Args:
        folder: the run's folder.
        agent_steps: minimum length of the whole run, in steps of all agents together; None keeps the run's own value.
        on_progress: as in `train`.
        make_algorithm: as in `train`.
        num_learners: number of processes that train together, as in `TrainConfig`; None keeps the run's own value.
        device: device of the networks, as in `TrainConfig`; None keeps the run's own value.
        trust_remote_code: continue a run whose configuration names code outside this package.

    Under `torchrun`, all machines must see the folder.

    Checkpoints do not contain the environments: these start new episodes, with seeds that the run has not used before.

    Raises:
        BlockingIOError: Another process is writing to the folder.
        FileNotFoundError: The folder has no configuration, no progress or no checkpoint.
        FormatError: One of them is damaged, or they do not belong together; or a file that the run reads has changed:
            a map, a scenario, demonstrations, or the initial policy.
        ValueError: The run is already longer than `agent_steps`.
    """
    run = RunFolder(Path(folder))
    with locked(run.path if is_first() else None):
        checkpoint = run.checkpoints.latest()
        config = load_config(run.path / CONFIG, trust_remote_code)
        _check_trusted_inputs(config, trust_remote_code)
        position = read_position(checkpoint)
        if position.agent_steps != position.updates * config.steps_per_update:
            raise FormatError(checkpoint, f"not a checkpoint of the run that {CONFIG} describes")
        if position.inputs not in ("", inputs_digest(config)):
            expected = "those of its run, of which a file has changed: maps, scenarios, demonstrations, initial policy"
            raise FormatError(checkpoint, f"expected the inputs to be {expected}")
        if agent_steps is not None:
            if agent_steps < position.agent_steps:
                raise ValueError(
                    f"agent_steps={agent_steps}: the run in {str(folder)!r} has already reached {position.agent_steps}"
                )
            config = replace(config, agent_steps=agent_steps)
        if num_learners is not None:
            config = replace(config, num_learners=num_learners)
        if device is not None:
            config = replace(config, device=device)
        return _run(config, run, checkpoint, on_progress, make_algorithm)


def _run(
    config: TrainConfig, run: RunFolder, checkpoint: Path | None, on_progress: Progress | None, make: MakeAlgorithm
) -> Path:
    """Train from the start or from a checkpoint."""
    config_files(config)  # raises for a configuration that cannot be saved, before workers start
    check_loggers(config)
    config = _with_learners(config)
    with connecting(int(config.num_learners), partial(_follow, config, make)) as ranks:
        if ranks.rank == 0:
            _lead(config, run, checkpoint, on_progress, make, ranks)
        else:
            _follow(config, make, ranks)
    return run.path


def _with_learners(config: TrainConfig) -> TrainConfig:
    """Return the configuration with the number of learners that the run has."""
    if (size := launched_size()) is not None:
        return replace(config, num_learners=size)
    if config.num_learners == "auto":
        return config.with_learners(torch.cuda.device_count() if _uses_gpu(config) else usable_cores())
    return config


def _lead(
    config: TrainConfig,
    run: RunFolder,
    checkpoint: Path | None,
    on_progress: Progress | None,
    make: MakeAlgorithm,
    ranks: Ranks,
) -> None:
    """Train as rank 0, which writes the run's folder."""
    algorithm, learner = _prepare(config, make, ranks)
    done = 0 if checkpoint is None else run.restore(checkpoint, learner)
    _synchronize(learner, done)
    with interrupts_deferred(_announce_end) as interrupted, _batches(config, algorithm, done, ranks) as batches:
        with naming(run.path):
            run.prepare(config)
        try:
            for row in updates(config, algorithm, learner, batches, done, run.seconds):
                with naming(run.path):
                    run.log(row)
                    run.save(learner, config.checkpoint_interval)
                if on_progress is not None:
                    on_progress(row)
                if ranks.any(interrupted()):
                    raise KeyboardInterrupt
            with naming(run.path):
                run.save(learner)
        except (KeyboardInterrupt, ConnectionError):
            with naming(run.path):
                run.save(learner)
            raise
        finally:
            with naming(run.path):
                run.finish(algorithm.network, config)


def _announce_end() -> None:
    LOGGER.info("stopping after this update")


def _follow(config: TrainConfig, make: MakeAlgorithm, ranks: Ranks) -> None:
    """Train as another rank, which writes nothing."""
    algorithm, learner = _prepare(config, make, ranks)
    done = _synchronize(learner)
    torch.manual_seed(int(np.random.SeedSequence([config.seed, done, ranks.rank]).generate_state(1)[0]))
    with interrupts_deferred() as interrupted, _batches(config, algorithm, done, ranks) as batches:
        for _ in updates(config, algorithm, learner, batches, done):
            if ranks.any(interrupted()):
                return


def _prepare(config: TrainConfig, make: MakeAlgorithm, ranks: Ranks) -> tuple[Algorithm, Learner]:
    """Return a rank's algorithm and its learner, for its share of each batch."""
    torch.manual_seed(config.seed)
    torch.set_num_threads(config.num_threads)
    with _device(config, ranks):
        algorithm = make(config.share(ranks.size))
        if config.initial_policy is not None:
            _start_from(config.initial_policy, config.initial_temperature, algorithm)
    learner = algorithm.make_learner()
    learner.ranks = ranks
    return algorithm, learner


def _synchronize(learner: Learner, done: int = 0) -> int:
    """Copy the state of rank 0's learner to all ranks, and return the number of updates that rank 0 has done."""
    ranks = learner.ranks
    if ranks.size == 1:
        return done
    tensors, done = ranks.from_first((learner.tensors(), done))
    if ranks.rank > 0:
        learner.restore(tensors)
    return done


def _check_trusted_inputs(config: TrainConfig, trust_remote_code: bool) -> None:
    """Raise `FormatError` if a policy or run that this one starts from names code without `trust_remote_code`."""
    if config.initial_policy is not None:
        policy_config(config.initial_policy, trust_remote_code)
    if config.algorithm == "dagger" and config.imitation.dataset is not None:
        load_config(Path(config.imitation.dataset) / CONFIG, trust_remote_code)


def _start_from(policy: str, temperature: float, algorithm: Algorithm) -> None:
    """Start from a trained policy."""
    network = load_policy(policy, trust_remote_code=True).network  # has been checked at the start of the run
    if temperature != 1:
        if not isinstance(network, Actor):
            raise ValueError(f"initial_temperature={temperature}: expected 1, since the initial policy has no logits")
        network.divide_logits(temperature)
    algorithm.start_from(network.to(next(algorithm.network.parameters()).device))


def _uses_gpu(config: TrainConfig) -> bool:
    """Return whether the networks are on a GPU; raises `ValueError` for `cuda` if there is no GPU."""
    present = torch.cuda.is_available()
    if config.device == "cuda" and not present:
        raise ValueError("device='cuda': torch finds no GPU; expected 'auto' or 'cpu'")
    return present and config.device != "cpu"


def _device(config: TrainConfig, ranks: Ranks) -> torch.device:
    """Return the device of a rank's networks."""
    if not _uses_gpu(config):
        return torch.device("cpu")
    device = torch.device("cuda", local_rank(ranks.rank) % torch.cuda.device_count())
    torch.cuda.set_device(device)
    return device


def _batches(
    config: TrainConfig, algorithm: Algorithm, done: int, ranks: Ranks
) -> AbstractContextManager[Iterator[TensorDictBase]]:
    """Return the context of a rank's batches for the updates from `done` on.

    Together, the environments of all ranks start with the episodes that those of a single process would.
    """
    left = config.num_updates - done
    if left <= 0:
        return nullcontext(iter(()))
    seed = config.seed
    if done:
        seed = FIRST_RESUMED_SEED + int(np.random.SeedSequence([seed, done]).generate_state(1)[0]) % FIRST_RESUMED_SEED
    return algorithm.batches(seed + ranks.rank * algorithm.config.optimization.num_envs, left)
