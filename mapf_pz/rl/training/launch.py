"""The processes of data-parallel training: started here, or by `torchrun` on any number of machines.

torch.distributed connects them: Gloo on CPUs, NCCL on GPUs. Rank 0 writes the run's folder.
"""

from __future__ import annotations

import logging
import os
import signal
import sys
import time
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from multiprocessing import get_context, resource_tracker
from multiprocessing.process import BaseProcess
from multiprocessing.synchronize import Semaphore
from pathlib import Path
from tempfile import TemporaryDirectory

import torch
import torch.distributed as dist

from mapf_pz._internal.interrupts import unheard_by_children
from mapf_pz.rl.ranks import Ranks

SECONDS_TO_END = 10.0
"""Seconds after which ranks are killed that do not end by themselves when rank 0 has ended."""


def is_first() -> bool:
    """Return whether this process is rank 0, or not one of several that `torchrun` has started."""
    return not dist.is_torchelastic_launched() or int(os.environ["RANK"]) == 0


def launched_size() -> int | None:
    """Return the number of processes that `torchrun` has started, or None if this process was started otherwise."""
    return int(os.environ["WORLD_SIZE"]) if dist.is_torchelastic_launched() else None


def local_rank(rank: int) -> int:
    """Return the number of a rank on its machine, which selects its GPU."""
    return int(os.environ.get("LOCAL_RANK", rank))


@contextmanager
def connecting(size: int, work: Callable[[Ranks], None]) -> Generator[Ranks]:
    """Connect `size` ranks, of which this process is one; the others end when the context does.

    Under `torchrun` the others have been started already, and connect by themselves. Otherwise this is rank 0, and the
    others are started on this machine.

    Args:
        size: number of processes; under `torchrun` that of `launched_size`.
        work: what the other ranks do, if they are started here; must be picklable.

    Raises:
        ChildProcessError: a rank that was started here has ended before its work was done.
        ConnectionError: the connection to a rank has been lost.
    """
    if launched_size() is not None:
        dist.init_process_group(_backends())
        try:
            yield Ranks(dist.get_rank(), size)
        finally:
            dist.destroy_process_group()
    elif size == 1:
        yield Ranks()
    else:
        yield from _started_here(size, work)


def _started_here(size: int, work: Callable[[Ranks], None]) -> Generator[Ranks]:
    _start_tracker()
    spawn = get_context("spawn")
    loaded = spawn.Semaphore(0)
    with TemporaryDirectory() as folder:
        meeting = Path(folder, "meeting").as_uri()
        shared = meeting, loaded, logging.getLogger("torchrl").level, work
        others = [spawn.Process(target=_be_rank, args=(Ranks(rank, size), *shared)) for rank in range(1, size)]
        try:
            with unheard_by_children():
                for process in others:
                    process.start()
            _wait_until_loaded(loaded, others)
            dist.init_process_group(_backends(), meeting, rank=0, world_size=size)
            yield Ranks(0, size)
            _wait_for(others, SECONDS_TO_END)
        except ConnectionError as error:
            _wait_for(others, 1.0)  # the one that has been lost may still be ending
            raise ChildProcessError(_lost(others) or str(error)) from None
        finally:
            _kill(others)
            if dist.is_initialized():
                dist.destroy_process_group()


def _start_tracker() -> None:
    """Start multiprocessing's tracker of resources such that it does not warn of what a killed rank leaves behind."""
    name = "PYTHONWARNINGS"
    before = os.environ.get(name)
    os.environ[name] = ",".join(filter(None, (before, "ignore::UserWarning:multiprocessing.resource_tracker")))
    try:
        resource_tracker.ensure_running()
    finally:
        if before is None:
            del os.environ[name]
        else:
            os.environ[name] = before


def _be_rank(ranks: Ranks, meeting: str, loaded: Semaphore, torchrl_level: int, work: Callable[[Ranks], None]) -> None:
    """Do the work of a rank other than 0, in a process that was started for it."""
    logging.getLogger("torchrl").setLevel(torchrl_level)  # as in rank 0
    for number in (signal.SIGINT, signal.SIGTERM):  # rank 0 handles them
        signal.signal(number, signal.SIG_IGN)
    loaded.release()
    try:
        dist.init_process_group(_backends(), meeting, rank=ranks.rank, world_size=ranks.size)
        work(ranks)
    except (ConnectionError, dist.DistError):  # rank 0 has ended, or reports what has
        sys.exit(1)
    dist.destroy_process_group()


def _wait_until_loaded(loaded: Semaphore, others: Sequence[BaseProcess]) -> None:
    """Wait until the other processes are ready to connect."""
    for _ in others:
        while not loaded.acquire(timeout=0.1):
            if lost := _lost(others):
                raise ChildProcessError(lost)


def _lost(others: Sequence[BaseProcess]) -> str | None:
    """Return which of the processes have failed, or None."""
    ended = [(rank, process.exitcode) for rank, process in enumerate(others, 1) if process.exitcode]
    killed = [(rank, code) for rank, code in ended if code < 0]  # the cause, if others have lost their connection
    for rank, code in killed or ended:
        reason = f"killed by {signal.Signals(-code).name}" if code < 0 else f"exit status {code}"
        return f"learner {rank} of {len(others) + 1} (from 0) has ended: {reason}"
    return None


def _wait_for(processes: Sequence[BaseProcess], seconds: float) -> None:
    """Wait until processes have ended, at most `seconds`."""
    deadline = time.monotonic() + seconds
    for process in processes:
        process.join(max(0.0, deadline - time.monotonic()))


def _kill(processes: Sequence[BaseProcess]) -> None:
    """Kill those of the processes that are running."""
    for process in processes:
        if process.is_alive():
            process.kill()
            process.join()


def _backends() -> str:
    return "cpu:gloo,cuda:nccl" if torch.cuda.is_available() else "gloo"
