"""Train IPPO of XuanCe with action masks: `pip install xuance==1.4.4`."""

# pyright: reportMissingImports=false, reportUntypedBaseClass=false

import sys
from argparse import Namespace
from pathlib import Path
from typing import Any

import numpy as np
import torch
import xuance
from gymnasium import spaces
from xuance.common import load_yaml
from xuance.environment import REGISTRY_MULTI_AGENT_ENV, RawMultiAgentEnv, make_envs
from xuance.torch.agents import IPPO_Agents

import mapf_pz
from mapf_pz.wrappers import FlatObservations

MAPS = mapf_pz.RandomObstacles(height=8, width=8, density=0.1, num_agents=4)


class XuanCeMapf(RawMultiAgentEnv):
    """The environment with XuanCe's interface: flat observations and a flat state."""

    def __init__(self, config: Namespace) -> None:
        """Create the environment."""
        super().__init__()
        self.env = FlatObservations(mapf_pz.parallel_env(source=MAPS, max_steps=32, **mapf_pz.RECOMMENDED))
        self.agents = self.env.possible_agents
        self.num_agents, self.agent_groups, self.max_episode_steps = len(self.agents), [self.agents], 32
        self.observation_space = {agent: self.env.observation_space(agent) for agent in self.agents}
        self.action_space = {agent: self.env.action_space(agent) for agent in self.agents}
        size = int(np.prod(self.env.state_space.shape))
        self.state_space = spaces.Box(-1, 1, (size,), np.float32)
        self._seed = config.env_seed

    def reset(self, seed: int | None = None) -> tuple[dict[str, Any], dict[str, Any]]:
        """Start an episode."""
        observations, self._infos = self.env.reset(seed=self._seed if seed is None else seed)
        self._seed = None
        return observations, {}

    def step(self, actions: dict[str, int]) -> tuple[dict[str, Any], dict[str, float], dict[str, bool], bool, dict]:
        """Take a step; XuanCe's `truncated` is one for all agents."""
        observations, rewards, terminated, truncated, self._infos = self.env.step(
            {agent: int(action) for agent, action in actions.items()}
        )
        return observations, rewards, terminated, any(truncated.values()), {}

    def state(self) -> np.ndarray:
        """Return the global state."""
        return self.env.state().ravel()

    def avail_actions(self) -> dict[str, np.ndarray]:
        """Return the action masks."""
        return {agent: self._infos[agent]["action_mask"] > 0 for agent in self.agents}

    def render(self, *_: Any) -> Any:
        """Draw nothing."""

    def close(self) -> None:
        """Close the environment."""
        self.env.close()


def main(steps: int) -> None:
    """Train on random maps, and print the CSR of episodes on others."""
    torch.set_num_threads(1)
    REGISTRY_MULTI_AGENT_ENV["mapf"] = XuanCeMapf
    folder = Path(str(xuance.__file__)).parent / "configs"
    settings = load_yaml(folder / "basic.yaml") | load_yaml(folder / "ippo" / "mpe" / "simple_spread_v3.yaml")
    settings |= {"env_name": "mapf", "env_id": "mapf", "policy": "Categorical_MAAC_Policy", "continuous_action": False}
    settings |= {"use_actions_mask": True, "gamma": 0.98, "buffer_size": 2048, "n_minibatch": 8, "n_epochs": 4}
    settings |= {name: [128] for name in ("representation_hidden_size", "actor_hidden_size", "critic_hidden_size")}
    settings |= {"parallels": 16, "vectorize": "DummyVecMultiAgentEnv", "device": "cpu", "seed": 0, "env_seed": 0}
    settings |= {"render": False, "log_dir": "runs/xuance", "running_steps": steps, "use_linear_lr_decay": True}
    config = Namespace(**settings)
    agents = IPPO_Agents(config, make_envs(config))
    agents.train(steps // config.parallels)

    unseen, solved = XuanCeMapf(config), []
    for seed in range(1_000_000, 1_000_050):
        observations, _ = unseen.reset(seed)
        while unseen.env.agents:
            masks = [unseen.avail_actions()]
            chosen = agents.get_actions([observations], avail_actions_dict=masks, test_mode=True, deterministic=True)
            observations, *_ = unseen.step(chosen["actions"][0])
        solved.append(unseen.env.metrics()["CSR"])
    print(f"CSR on {len(solved)} unseen maps: {np.mean(solved):.2f}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 33_000)
