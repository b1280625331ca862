"""Data collection: in this process, in several processes on this machine, or on a Ray cluster."""

from __future__ import annotations

import os
from collections.abc import Callable, Generator, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any, Protocol

import torch
from pettingzoo import ParallelEnv
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.collectors import BaseCollector, Collector, MultiSyncCollector
from torchrl.envs import Compose, EnvBase, PettingZooWrapper, RewardSum, StepCounter, Transform, TransformedEnv

from mapf_pz._internal.interrupts import unheard_by_children
from mapf_pz.rl.config import CollectorName, TrainConfig
from mapf_pz.rl.environments.batched_env import BatchedMapfEnv
from mapf_pz.simulator.simulator import Simulator

CPU = torch.device("cpu")


class Collecting(Protocol):
    """What collects data in environments, such as an algorithm."""

    actor: TensorDictModuleBase
    """The policy, whose output includes the actions."""

    def transforms(self, seed: int) -> list[Transform]:
        """Return the transforms of environments."""
        ...

    def training_transforms(self, seed: int) -> list[Transform]:
        """Return the transforms of environments in which training data is collected."""
        ...


@dataclass(frozen=True)
class MakeEnv:
    """Creates batched environments with an algorithm's transforms."""

    algorithm: Collecting
    """The algorithm."""
    config: TrainConfig
    """The run's configuration."""
    seed: int
    """Environment `b` starts with the episode of seed `seed + b`."""
    number: int
    """Number of environments."""
    training: bool = True
    """Whether training data is collected in them."""
    device: torch.device = CPU
    """Device of all tensors that they return."""

    def __call__(self) -> TransformedEnv:
        """Return the environments as one batch."""
        env = BatchedMapfEnv(
            self.number,
            self.config.num_threads,
            self.device,
            observation_precision=self.config.observation_precision,
            **self.config.task.env_keywords(),
        )
        env.set_seed(self.seed)
        reward_sum = RewardSum(
            in_keys=[("agents", "reward")], out_keys=[("agents", "episode_reward")], reset_keys=["_reset"]
        )
        make_transforms = self.algorithm.training_transforms if self.training else self.algorithm.transforms
        transforms = [*make_transforms(self.seed), reward_sum, StepCounter()]
        return TransformedEnv(env, Compose(*transforms))  # pyright: ignore[reportArgumentType] (annotated as lists)


@dataclass(frozen=True)
class MakeWorkerEnv(MakeEnv):
    """Creates environments in a worker, another process or machine, which needs a separate seed to sample actions."""

    def __call__(self) -> TransformedEnv:
        """Seed torch in the worker, and return the environments."""
        torch.manual_seed(self.seed)
        torch.set_num_threads(self.config.num_threads)
        return super().__call__()


@contextmanager
def collecting(algorithm: Collecting, config: TrainConfig, seed: int, updates: int) -> Generator[BaseCollector]:
    """Yield a collector of `updates` batches of B x T steps, sampled with the algorithm's current actor.

    The environments start with the episodes of the seeds `seed`, `seed + 1`, ... With W workers, batches have the shape
    W x (B / W) x T, and `update_policy_weights_` sends them the new weights. The next batch may overwrite a batch.

    Raises:
        ImportError: The collector is `ray`, and Ray is not installed.
    """
    with ExitStack() as afterwards:
        with unheard_by_children():  # workers continue until the update is complete
            collector = _COLLECTORS[config.collector](algorithm, config, seed, updates, afterwards)
        afterwards.callback(collector.shutdown)
        yield collector


def _in_this_process(
    algorithm: Collecting, config: TrainConfig, seed: int, updates: int, _: ExitStack
) -> BaseCollector:
    # On a GPU, observations are copied there once, both for acting and for learning.
    device = _policy_device(algorithm)
    env = MakeEnv(algorithm, config, seed, config.optimization.num_envs, device=device)()
    return Collector(env, algorithm.actor, **_frames(config, updates), device=device, **_OPTIONS)


def _in_processes(algorithm: Collecting, config: TrainConfig, seed: int, updates: int, _: ExitStack) -> BaseCollector:
    return MultiSyncCollector(
        _shares(algorithm, config, seed),
        algorithm.actor,
        **_keywords(algorithm, config, updates),
        cat_results="stack",
        num_threads=config.num_threads,
        num_sub_threads=config.num_threads,
        auto_register_policy_transforms=False,
    )


def _on_ray(
    algorithm: Collecting, config: TrainConfig, seed: int, updates: int, afterwards: ExitStack
) -> BaseCollector:
    try:
        import ray
        from torchrl.collectors.distributed import RayCollector
    except ImportError as error:
        raise ImportError(f"collector='ray': {error}: pip install 'mapf-pz[ray]'") from error
    if not ray.is_initialized():
        # RAY_ADDRESS names a cluster; without it, Ray starts one on this machine.
        resources: dict[str, Any] = {} if "RAY_ADDRESS" in os.environ else {"num_cpus": config.num_workers}
        ray.init(include_dashboard=False, log_to_driver=False, **resources)
        afterwards.callback(ray.shutdown)
    collector = RayCollector(
        _shares(algorithm, config, seed),
        algorithm.actor,
        **_keywords(algorithm, config, updates),
        collector_kwargs={"auto_register_policy_transforms": False},
        num_collectors=config.num_workers,
        remote_configs={"num_cpus": 1, "num_gpus": 0},
        sync=True,
    )
    send_weights(collector)
    return collector


_COLLECTORS: dict[CollectorName, Callable[[Collecting, TrainConfig, int, int, ExitStack], BaseCollector]] = {
    "single": _in_this_process,
    "processes": _in_processes,
    "ray": _on_ray,
}


def _shares(algorithm: Collecting, config: TrainConfig, seed: int) -> list[MakeWorkerEnv]:
    """Divide the environments evenly among the workers."""
    number = config.optimization.num_envs // config.num_workers
    MakeEnv(algorithm, config, seed, 1)().reset()  # errors are raised here, not as a worker's traceback
    return [MakeWorkerEnv(algorithm, config, seed + w * number, number) for w in range(config.num_workers)]


def send_weights(collector: BaseCollector) -> None:
    """Give the current weights of the policy to a collector."""
    collector.update_policy_weights_()  # pyright: ignore[reportCallIssue] (annotated without the usual call)


def _policy_device(algorithm: Collecting) -> torch.device:
    """Return the device of the networks."""
    return next(algorithm.actor.parameters()).device


def _frames(config: TrainConfig, updates: int) -> dict[str, int]:
    """Return the numbers of steps of all environments in a batch and in all batches, a collector's keywords."""
    frames = config.optimization.num_envs * config.optimization.steps_per_batch
    return {"frames_per_batch": frames, "total_frames": frames * updates}


def _keywords(algorithm: Collecting, config: TrainConfig, updates: int) -> dict[str, Any]:
    """Return the keywords of the collectors with workers, whose batches are in the CPU's memory."""
    devices = {"policy_device": _policy_device(algorithm), "env_device": CPU, "storing_device": CPU}
    return {**_frames(config, updates), **devices}


def _shallow_copy(batch: TensorDictBase) -> TensorDictBase:
    """Return a batch with the same tensors, to which entries can be added."""
    return batch.copy()


_OPTIONS: dict[str, Any] = {
    # The tensors of a batch are overwritten by the next batch, instead of being copied.
    "return_same_td": True,
    "postproc": _shallow_copy,
    # A GPU does all work in order, and copies to the CPU wait for it.
    "no_cuda_sync": True,
    "track_traj_ids": False,
    "auto_register_policy_transforms": False,
}
"""Options of collectors in this process."""


class RandomActions(TensorDictModuleBase):
    """A policy of uniform random actions; much faster than TorchRL's `RandomPolicy`."""

    def __init__(self, num_agents: int, num_actions: int) -> None:
        """Create the policy for N agents with A actions."""
        super().__init__()
        self.in_keys, self.out_keys = [], [("agents", "action")]  # pyright: ignore[reportAttributeAccessIssue]
        self._num_agents, self._num_actions = num_agents, num_actions

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Sample actions (..., N)."""
        shape = (*tensordict.batch_size, self._num_agents)
        return tensordict.set(("agents", "action"), torch.randint(self._num_actions, shape))


def random_batches(
    env: EnvBase | ParallelEnv[str, Any, Any], simulator: Simulator, frames: int
) -> Iterator[TensorDictBase]:
    """Yield batches of `frames` steps of random actions, without end; each batch overwrites the one before.

    A PettingZoo environment is wrapped by TorchRL's wrapper; `simulator` is the environment's simulator.
    """
    if not isinstance(env, EnvBase):
        env = PettingZooWrapper(env, group_map={"agents": env.possible_agents})
    policy = RandomActions(simulator.num_agents, simulator.num_actions)
    # With a device, the collector does not look for tensors on other devices in each step.
    options: dict[str, Any] = {"device": env.device, "trust_policy": True, **_OPTIONS}
    return iter(Collector(env, policy, frames_per_batch=frames, total_frames=-1, **options))
