"""Candidates in which a team is one environment: this package's vector environment, and Gymnasium's with processes."""

from __future__ import annotations

import time
from functools import partial
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AsyncVectorEnv, VectorEnv

from experiments.speed.runs import Run, Timing, timed
from experiments.speed.workload import Workload
from mapf_pz._internal.arrays import Floats
from mapf_pz.wrappers.centralized import centralized_env
from mapf_pz.wrappers.centralized_vector import CentralizedVectorEnv

MOST_PROCESSES = 8
"""Number of environments of `AsyncVectorEnv`, each in a process; at most those of the workload."""


def team_run(workload: Workload) -> Run:
    """Step the teams of a batch."""
    env = CentralizedVectorEnv(workload.num_envs, num_threads=workload.num_threads, **workload.env_config().keywords())
    env.reset(seed=workload.seed)
    play = partial(_play, env, _random_values(workload, env))
    return timed(lambda: play() * workload.num_agents, workload.observation_bytes)


class ProcessorTime(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Adds the CPU seconds of its process to the infos."""

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode; a vector environment does this in a step."""
        observation, info = super().reset(seed=seed, options=options)
        return observation, info | {"cpu": time.process_time()}

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Take a step."""
        observation, reward, terminated, truncated, info = super().step(action)
        return observation, float(reward), terminated, truncated, info | {"cpu": time.process_time()}


def async_run(workload: Workload) -> Run:
    """Step teams in processes by Gymnasium's `AsyncVectorEnv`, whose CPU seconds include those of its processes."""
    keywords = workload.env_config().keywords()
    env = AsyncVectorEnv([lambda: ProcessorTime(centralized_env(**keywords))] * min(workload.num_envs, MOST_PROCESSES))
    values = _random_values(workload, env)
    env.reset(seed=workload.seed)

    def seconds() -> float:
        return float(env.step(values[0])[-1]["cpu"].sum()) + time.process_time()

    def run() -> Timing:
        cpu, wall = seconds(), time.perf_counter()
        steps = _play(env, values)
        wall = time.perf_counter() - wall
        return Timing(steps * workload.num_agents, wall, seconds() - cpu, workload.observation_bytes)

    return run


def _play(env: VectorEnv[Any, Any, Any], values: Floats) -> int:
    """Step with `values` (T, B, N, A); return the number of the environments' steps."""
    for action in values:
        env.step(action)
    return len(values) * env.num_envs


def _random_values(workload: Workload, env: VectorEnv[Any, Any, Any]) -> Floats:
    rng = np.random.default_rng(workload.seed)
    shape = (workload.env.max_steps, *(env.action_space.shape or ()))
    return rng.uniform(-1, 1, shape).astype(np.float32)
