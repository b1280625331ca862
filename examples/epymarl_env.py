r"""The environment for EPyMARL, a clone of github.com/uoe-agents/epymarl, which trains IPPO, MAPPO, QMIX and others.

In the clone, with this folder in `PYTHONPATH`:

    python src/main.py --config=ippo --env-config=gymma with env_args.key=epymarl_env:Mapf-EPyMARL-v0 \
        env_args.time_limit=32 t_max=40000 lr=0.0007 gamma=0.98 use_cuda=False seed=0

EPyMARL sums the agents' rewards. Its `time_limit` must be `max_steps`.
"""

from typing import Any

import gymnasium
from gymnasium import spaces

import mapf_pz
from mapf_pz.wrappers import FlatObservations


class EPyMARLEnv(gymnasium.Env[Any, Any]):
    """Four agents on random maps, with tuples of observations, actions and rewards."""

    def __init__(self, max_steps: int = 32) -> None:
        """Create the environment."""
        maps = mapf_pz.RandomObstacles(height=8, width=8, density=0.1, num_agents=4)
        self._env = FlatObservations(mapf_pz.parallel_env(source=maps, max_steps=max_steps, **mapf_pz.RECOMMENDED))
        self._agents = self._env.possible_agents
        self.n_agents = len(self._agents)
        self.observation_space = spaces.Tuple([self._env.observation_space(agent) for agent in self._agents])
        self.action_space = spaces.Tuple([self._env.action_space(agent) for agent in self._agents])

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode."""
        observations, _ = self._env.reset(seed=seed)
        return tuple(observations.values()), {}

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Take a step; EPyMARL logs the mean of what the info has at the end."""
        actions = dict(zip(self._agents, map(int, action), strict=True))
        observations, rewards, terminated, truncated, _ = self._env.step(actions)
        info = {} if self._env.agents else {"CSR": self._env.metrics()["CSR"]}
        ends = all(terminated.values()), any(truncated.values())
        return tuple(observations.values()), list(rewards.values()), *ends, info


gymnasium.register("Mapf-EPyMARL-v0", entry_point="epymarl_env:EPyMARLEnv")
