"""The report's experiment with its library, Stable-Baselines3: `pip install stable-baselines3`.

The environment, the sizes of the network and PPO's settings are those of `mapf-pz train PRESET`: `report-repaired`, or
`report`, which does not learn. Stable-Baselines3 has one advantage for the team, while `report-repaired` has one for
each agent.
"""

import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
import tyro
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.logger import configure
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import VecMonitor
from torch import Tensor, nn

from mapf_pz.rl.config import TrainConfig
from mapf_pz.rl.presets import PRESETS
from mapf_pz.wrappers import CentralizedVectorEnv
from mapf_pz.wrappers.sb3 import CentralizedVecEnv

REPORT = PRESETS["report"]
EVALUATION_SEED = 2_000_000  # that of the validation of `mapf-pz train`


@dataclass(frozen=True)
class Example:
    """Ten agents in the report's warehouse."""

    preset: Literal["report", "report-repaired"] = "report-repaired"
    """The preset with the settings."""
    steps: int = 200_000
    """Length of training in environment steps."""
    episodes: int = 32
    """Number of evaluation episodes."""
    seed: int = 0
    """Random seed of weights, exploration and instances."""
    output: Path = Path("runs/centralized_sb3")
    """Folder of `progress.csv` (the logger's) and `results.json`."""


class ReportCNN(BaseFeaturesExtractor):
    """The report's two convolutions, 8 x 8 with stride 4 and 4 x 4 with stride 2, and its linear layer."""

    def __init__(self, observation_space: spaces.Space[Any], features_dim: int, dropout: float = 0.0) -> None:
        """Build the layers for images (N * K, h, w), at least 20 x 20, or a Dict of such images and features."""
        super().__init__(observation_space, features_dim)
        spaces_by_name = (
            dict(observation_space) if isinstance(observation_space, spaces.Dict) else {"image": observation_space}
        )
        example = {name: torch.zeros(1, *(space.shape or ())) for name, space in spaces_by_name.items()}
        first, second = REPORT.model.conv_channels
        self.convolutions = nn.Sequential(
            nn.Conv2d(example["image"].shape[1], first, kernel_size=8, stride=4),
            nn.ReLU(),
            nn.Conv2d(first, second, kernel_size=4, stride=2),
            nn.ReLU(),
            nn.Flatten(),
        )
        size = self._inputs(example).shape[1]
        self.layers = nn.Sequential(nn.Linear(size, features_dim), nn.Dropout(dropout), nn.ReLU())

    def forward(self, observations: Tensor | dict[str, Tensor]) -> Tensor:
        """Return the features (B, features_dim)."""
        return self.layers(self._inputs(observations if isinstance(observations, dict) else {"image": observations}))

    def _inputs(self, observations: dict[str, Tensor]) -> Tensor:
        """Return what the convolutions see in the image, and the features if there are any."""
        seen = self.convolutions(observations["image"])
        return torch.cat([seen, observations["features"]], dim=1) if "features" in observations else seen


def keywords(config: TrainConfig) -> dict[str, Any]:
    """Return the keywords of the centralized environment."""
    return config.task.env.keywords() | {"action_mode": config.task.action_mode}


def make_model(config: TrainConfig, seed: int) -> PPO:
    """Return PPO with the report's network and the settings of a preset, and its environments."""
    optimization, ppo, head = config.optimization, config.ppo, list(config.model.head)
    return PPO(
        "MultiInputPolicy" if config.task.env.features else "CnnPolicy",
        VecMonitor(CentralizedVecEnv(optimization.num_envs, **keywords(config))),
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
            "features_extractor_kwargs": {"features_dim": config.model.hidden},
            "net_arch": {"pi": head, "vf": head},
            "activation_fn": nn.GELU if config.model.activation == "gelu" else nn.ReLU,
            "log_std_init": -0.5,
        },
        seed=seed,
        device="cpu",
    )


def evaluate(model: PPO, config: TrainConfig, episodes: int) -> dict[str, float]:
    """Return the mean CSR, ISR and reward (the sum over agents) of episodes with sampled actions."""
    envs = CentralizedVectorEnv(num_envs=episodes, **keywords(config))
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
    config = PRESETS[example.preset]
    model = make_model(config, example.seed)
    model.set_logger(configure(str(example.output), ["csv"]))
    before, began = evaluate(model, config, example.episodes), time.process_time()
    model.learn(example.steps)
    seconds = time.process_time() - began
    model.logger.close()
    after = evaluate(model, config, example.episodes)
    results = {"before": before, "after": after, "cpu_seconds": seconds}
    (example.output / "results.json").write_text(json.dumps(results, indent=2) + "\n")
    for when, means in (("before", before), ("after", after)):
        print(f"{when} training:", ", ".join(f"{name} {value:.3f}" for name, value in means.items()))


if __name__ == "__main__":
    main(tyro.cli(Example))
