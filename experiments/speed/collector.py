"""TorchRL's collector and `rollout` on `BatchedMapfEnv` and on an environment that does nothing."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import torch
from tensordict import TensorDictBase

from experiments.speed.runs import Run, measure, timed
from experiments.speed.workload import Workload
from mapf_pz.rl import BatchedMapfEnv
from mapf_pz.rl.environments.collect import RandomActions, random_batches


class IdleEnv(BatchedMapfEnv):
    """Returns the tensors of its first reset in every step."""

    def _reset(self, tensordict: TensorDictBase | None = None, **_: Any) -> TensorDictBase:
        if not hasattr(self, "_first"):
            self._first = super()._reset()
            self._reward = torch.zeros(*self._first.get(("agents", "at_goal")).shape)
        return self._first.copy()

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        agents = self._first.get("agents").copy().set("reward", self._reward)
        return self._first.copy().set("agents", agents)


def main(num_envs: int = 256, num_agents: int = 8, steps: int = 64, seconds: float = 40) -> None:
    """Print thousands of agent steps per CPU second.

    Args:
        num_envs: number of environments.
        num_agents: number of agents in each.
        steps: steps of a batch or rollout.
        seconds: duration of the measurement.
    """
    torch.set_num_threads(1)
    workload = Workload(num_envs=num_envs).with_env(num_agents=num_agents)
    runs: dict[str, Run] = {}
    for name, kind in {"BatchedMapfEnv": BatchedMapfEnv, "idle": IdleEnv}.items():
        collected, rolled = (kind(num_envs, **workload.env_config().keywords()) for _ in range(2))
        for env in (collected, rolled):
            env.set_seed(workload.seed)
        batches = random_batches(collected, collected.simulator, num_envs * steps)
        policy = RandomActions(num_agents, rolled.simulator.num_actions)
        rollout = partial(rolled.rollout, steps, policy, break_when_any_done=False)
        runs[f"collector, {name}"] = timed(_counting(partial(next, batches), num_agents))
        runs[f"rollout, {name}"] = timed(_counting(rollout, num_agents))
    for one in measure(runs, seconds).values():
        print(f"{one.name:28} {one.cpu_rate / 1000:8,.0f}")


def _counting(collect: Callable[[], TensorDictBase], num_agents: int) -> Callable[[], int]:
    return lambda: collect().numel() * num_agents
