"""Validation on held-out instances."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase, cat
from torchrl.envs import EnvBase, ExplorationType, set_exploration_type

from mapf_pz.rl.algorithms.algorithm import Algorithm
from mapf_pz.rl.config import TrainConfig
from mapf_pz.rl.environments.collect import MakeEnv
from mapf_pz.rl.ranks import Ranks
from mapf_pz.rl.training.episodes import LAST_STEP, MEANS, episode_means
from mapf_pz.simulator.seeds import FIRST_VALIDATION_SEED


class Validation:
    """Validation episodes: every validation uses the same instances and the same random seed."""

    def __init__(self, algorithm: Algorithm, config: TrainConfig, ranks: Ranks) -> None:
        """Keep the actor; the environments, one per episode of this rank, are created at the first validation."""
        self._config = config
        self._ranks = ranks
        first, last = (config.validation_episodes * rank // ranks.size for rank in (ranks.rank, ranks.rank + 1))
        self._seed, self._episodes = FIRST_VALIDATION_SEED + first, last - first
        self._algorithm = algorithm
        self._env: EnvBase | None = None
        self._due = config.validation_interval

    def after(self, agent_steps: int, last: bool) -> dict[str, float]:
        """Return the results of `measure` if a validation is due, otherwise the same names with NaN.

        With an interval of 0, the result is empty.
        """
        if not self._config.validation_interval:
            return {}
        if agent_steps < self._due and not last:
            return {f"validation_{name}": float("nan") for name in MEANS[self._config.task.env.on_target]}
        self._due = agent_steps + self._config.validation_interval
        return self.measure()

    def measure(self) -> dict[str, float]:
        """Run the episodes of all ranks and return the means in `MEANS` under the names `validation_...`."""
        if self._env is None:
            self._env = MakeEnv(self._algorithm, self._config, self._seed, self._episodes, training=False)()
        self._env.set_seed(self._seed)
        device = next(self._algorithm.actor.parameters()).device
        gpus = [device] if device.type == "cuda" else []
        with torch.random.fork_rng(gpus), torch.no_grad(), set_exploration_type(ExplorationType.RANDOM):
            torch.manual_seed(self._seed)
            means = self._ranks.mean(self._play(self._env, device), weight="episodes")
        return {f"validation_{name}": means[name] for name in MEANS[self._config.task.env.on_target]}

    def _play(self, env: EnvBase, device: torch.device) -> dict[str, float]:
        """Return the means over each environment's first episode; the actor is on `device`."""
        now = env.reset()
        over = torch.zeros(*env.batch_size, 1, dtype=torch.bool)
        last: list[TensorDictBase] = []
        for _ in range(self._config.task.env.max_steps):
            step, now = env.step_and_maybe_reset(self._algorithm.actor(now.to(device)).to(env.device))
            done = step["next", "done"]
            last.append(step["next"].select(*LAST_STEP)[(done & ~over).squeeze(-1)])
            over = over | done
        return episode_means(self._config.task, cat(last))
