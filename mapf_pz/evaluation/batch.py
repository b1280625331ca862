"""Episodes of a policy that acts in several environments at the same time."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from mapf_pz._internal.arrays import Ints
from mapf_pz.environment.policy import PolicyInBatch
from mapf_pz.evaluation.measures import Measures, Metrics
from mapf_pz.evaluation.task import EvaluationTask
from mapf_pz.instances import InstanceList
from mapf_pz.simulator.kernels.cost_tables import CACHE_BYTES
from mapf_pz.simulator.simulator import Simulator

MAX_AGENTS = 256
"""Maximum number of agents of a batch, unless an episode alone has more. More agents are hardly faster."""
CELL_BYTES, GOAL_BYTES = 128, 20
"""Maximum memory of an environment for each cell: for the map, and for the cost to go to each agent's goal."""


class EpisodeBatch:
    """Runs episodes of a task in the environments of one simulator, several at the same time.

    An episode that is over is followed by the next one in the same environment. Its metrics other than the runtime are
    those of the same episode in a single environment.
    """

    def __init__(self, simulator: Simulator, policy: PolicyInBatch, task: EvaluationTask) -> None:
        """Keep the parts.

        Args:
            simulator: the B environments; none of them has to be reset.
            policy: the policy in these environments.
            task: the task.
        """
        self._simulator = simulator
        self._policy = policy
        self._task = task
        self._measures = [Measures() for _ in range(simulator.num_envs)]

    def run(self, episodes: Sequence[int]) -> dict[int, Metrics]:
        """Return the metrics of B or more episodes, as `run_episodes` does."""
        first, waiting = episodes[: self._simulator.num_envs], deque(episodes[self._simulator.num_envs :])
        running = dict(enumerate(first))
        self._start(running)
        self._step(list(running))  # so that compilation and loading are not measured
        self._start(running)
        metrics: dict[int, Metrics] = {}
        while running:
            self._step(list(running))
            over = self._simulator.over
            for b in [b for b in running if over[b]]:
                best = self._task.best_result(running[b], self._simulator.config)
                metrics[running[b]] = self._measures[b].added_to(self._simulator.metrics(b), best)
                if waiting:
                    running[b] = waiting.popleft()
                    self._start({b: running[b]})
                else:
                    del running[b]
        return metrics

    def _start(self, episodes: Mapping[int, int]) -> None:
        """Start episodes, which are given by environment."""
        instances = {b: instance for b, e in episodes.items() if (instance := self._task.instance(e)) is not None}
        self._simulator.reset(episodes, {b: self._task.seed + e for b, e in episodes.items()}, instances)
        for b in episodes:
            self._policy.reset(b)
            self._measures[b] = Measures()

    def _step(self, envs: Sequence[int]) -> None:
        """Take a step, and measure it in the environments `envs`, among which the policy's runtime is divided."""
        observation = self._simulator.observe()
        start = time.process_time()
        actions = self._policy.actions(observation, envs)
        runtime = (time.process_time() - start) / len(envs)
        self._simulator.step(self._checked(actions))
        acting, blocked = (self._simulator.agents[name].sum(1).tolist() for name in ("was_active", "blocked"))
        for b in envs:
            self._measures[b].runtime += runtime
            self._measures[b].add_step(acting[b], blocked[b])

    def _checked(self, actions: Ints) -> Ints:
        """Return the actions as int64; raises `ValueError` unless they are whole numbers (B, N) from 0 to A - 1."""
        numbers, expected, last = np.asarray(actions), self._simulator.agents.shape, self._simulator.num_actions - 1
        if numbers.shape != expected or not np.issubdtype(numbers.dtype, np.integer):
            got = f"{numbers.dtype} of shape {numbers.shape}"
            raise ValueError(f"actions of a policy in a batch: expected integers of shape {expected}, got {got}")
        if numbers.min() < 0 or numbers.max() > last:
            got = f"{numbers.min()} to {numbers.max()}"
            raise ValueError(f"actions of a policy in a batch: expected numbers from 0 to {last}, got {got}")
        return np.ascontiguousarray(numbers, np.int64)


def batch_of(single: Simulator, task: EvaluationTask, episodes: Sequence[int]) -> Simulator:
    """Return a simulator of several environments for episodes of a task whose maps have the same size.

    Args:
        single: the simulator of one environment for one of the episodes.
        task: the task.
        episodes: the episodes.
    """
    config = single.config
    instances = [instance for instance in map(task.instance, episodes) if instance is not None]
    if instances:
        config = replace(config, source=InstanceList(instances))
    height, width = single.shape
    needed = height * width * (CELL_BYTES + GOAL_BYTES * single.num_agents)
    most = min(MAX_AGENTS // single.num_agents, (config.distance_bytes or CACHE_BYTES) // needed, len(episodes))
    return Simulator(config, max(1, most))
