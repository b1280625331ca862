"""The report's experiment with its library, Stable-Baselines3: `pip install stable-baselines3`.

The environment, the sizes of the network and PPO's settings are those of `mapf-pz train report`.
"""

import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.logger import configure
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import Tensor, nn

from mapf_pz.rl.presets import PRESETS
from mapf_pz.wrappers import CentralizedEnv, CentralizedVectorEnv, centralized_env

REPORT = PRESETS["report"]
SETTING: dict[str, Any] = REPORT.task.env.keywords() | {"action_mode": REPORT.task.action_mode}
NUM_AGENTS = REPORT.task.num_agents
EVALUATION_SEED = 2_000_000  # that of the validation of `mapf-pz train`


@dataclass(frozen=True)
class Example:
    """Ten agents in the report's warehouse."""

    steps: int = REPORT.agent_steps // NUM_AGENTS
    """Length of training in environment steps."""
    episodes: int = REPORT.validation_episodes
    """Number of evaluation episodes."""
    seed: int = 0
    """Random seed of weights, exploration and instances."""
    output: Path = Path("runs/report_sb3")
    """Folder of `progress.csv` (the logger's) and `results.json`."""


class ReportCNN(BaseFeaturesExtractor):
    """The report's two convolutions, 8 x 8 with stride 4 and 4 x 4 with stride 2, and its linear layer."""

    def __init__(self, observation_space: spaces.Box, features_dim: int, dropout: float = 0.0) -> None:
        """Build the layers for images (N * K, h, w), at least 20 x 20."""
        super().__init__(observation_space, features_dim)
        first, second = REPORT.model.conv_channels
        convolutions = nn.Sequential(
            nn.Conv2d(observation_space.shape[0], first, kernel_size=8, stride=4),
            nn.ReLU(),
            nn.Conv2d(first, second, kernel_size=4, stride=2),
            nn.ReLU(),
            nn.Flatten(),
        )
        size = convolutions(torch.zeros(1, *observation_space.shape)).shape[1]
        self.layers = nn.Sequential(convolutions, nn.Linear(size, features_dim), nn.Dropout(dropout), nn.ReLU())

    def forward(self, observations: Tensor) -> Tensor:
        """Return the features (B, features_dim)."""
        return self.layers(observations)


def make_env() -> CentralizedEnv:
    """Return the report's environment: observations (70, 20, 20), actions (10, 4) in [-1, 1]."""
    return centralized_env(**SETTING)


def make_model(seed: int) -> PPO:
    """Return PPO with the report's network, and its environments."""
    optimization, ppo, head = REPORT.optimization, REPORT.ppo, list(REPORT.model.head)
    return PPO(
        "CnnPolicy",
        make_vec_env(make_env, n_envs=optimization.num_envs, seed=seed),
        learning_rate=lambda left: optimization.learning_rate * (0.1 + 0.9 * left),
        n_steps=optimization.steps_per_batch,
        batch_size=optimization.minibatch_size,
        n_epochs=optimization.num_epochs,
        gamma=ppo.gamma,
        gae_lambda=ppo.lmbda,
        clip_range=ppo.clip_epsilon,
        ent_coef=ppo.entropy_coeff,
        vf_coef=ppo.critic_coeff,
        max_grad_norm=optimization.max_grad_norm,
        stats_window_size=16,
        policy_kwargs={
            "normalize_images": False,  # observations are not bytes
            "features_extractor_class": ReportCNN,
            "features_extractor_kwargs": {"features_dim": REPORT.model.hidden},
            "net_arch": {"pi": head, "vf": head},
            "activation_fn": nn.ReLU,
            "log_std_init": -0.5,
        },
        seed=seed,
        device="cpu",
    )


def evaluate(model: PPO, episodes: int) -> dict[str, float]:
    """Return the mean CSR, ISR and reward (the sum over agents) of episodes with sampled actions."""
    envs = CentralizedVectorEnv(num_envs=episodes, **SETTING)
    observations, _ = envs.reset(seed=EVALUATION_SEED)
    over, reward, isr, csr = np.zeros(episodes, np.bool_), *np.zeros((3, episodes))
    while not over.all():
        actions, _ = model.predict(observations)  # pyright: ignore[reportArgumentType] (annotated without dicts)
        observations, rewards, terminated, truncated, infos = envs.step(actions)
        reward += np.where(over, 0, rewards)
        ending = (terminated | truncated) & ~over
        isr[ending], csr[ending] = infos["ISR"][ending], infos["is_success"][ending]
        over |= ending
    return {"CSR": float(csr.mean()), "ISR": float(isr.mean()), "reward": float(reward.mean())}


def main(example: Example) -> None:
    """Train, and evaluate the policy before and after."""
    torch.set_num_threads(1)
    model = make_model(example.seed)
    model.set_logger(configure(str(example.output), ["csv"]))
    before, began = evaluate(model, example.episodes), time.process_time()
    model.learn(example.steps)
    seconds = time.process_time() - began
    model.logger.close()
    after = evaluate(model, example.episodes)
    results = {"before": before, "after": after, "cpu_seconds": seconds}
    (example.output / "results.json").write_text(json.dumps(results, indent=2) + "\n")
    for when, means in (("before", before), ("after", after)):
        print(f"{when} training:", ", ".join(f"{name} {value:.3f}" for name, value in means.items()))


if __name__ == "__main__":
    main(tyro.cli(Example))
