"""Train with your own channel, reward and encoder: `python examples/custom_parts.py`.

On the command line: `mapf-pz train mappo --channels view cost_to_go custom_parts:congestion --reward custom_parts:pace
--encoder custom_parts:Pooled`, in this folder.
"""

from pathlib import Path

import numpy as np
import torch
import tyro
from torch import Tensor, nn

from mapf_pz import Channel, EnvConfig, Transition
from mapf_pz.rl import load_policy, train
from mapf_pz.rl.config import ModelConfig, OptimizationConfig, TaskConfig, TrainConfig
from mapf_pz.rl.networks.observation_shape import ObservationShape
from mapf_pz.simulator.kernels.observation.inputs import ObservationInputs


def draw_congestion(inputs: ObservationInputs, image: np.ndarray, plane: int) -> None:
    """Draw how crowded the view is: the fraction of its cells that other agents are on, in every cell."""
    image[:, :, plane] = (inputs.others.count / image[0, 0, plane].size)[..., None, None]


congestion = Channel(draw_congestion, symmetry="cells")


def pace(transition: Transition) -> np.ndarray:
    """Reward each agent for the decrease of its cost to go, and for staying at its goal."""
    gain = transition.cost_to_go_before - transition.cost_to_go
    return np.where(np.isfinite(gain), gain, 0) + 0.1 * transition.at_goal


class Pooled(nn.Module):
    """Encode the image by its mean over cells and the cells around the agent."""

    def __init__(self, shape: ObservationShape, config: ModelConfig) -> None:
        """Take the shapes of an observation and the `ModelConfig`."""
        super().__init__()
        size = shape.image[0] * 10 + shape.features
        self.layer = nn.Sequential(nn.Linear(size, config.hidden), nn.ReLU())

    def forward(self, image: Tensor, features: Tensor | None = None) -> Tensor:
        """Return embeddings `(..., hidden)` of images `(..., K, h, w)`."""
        h, w = image.shape[-2] // 2, image.shape[-1] // 2
        near = image[..., h - 1 : h + 2, w - 1 : w + 2].flatten(-3)
        parts = [image.mean((-2, -1)), near] + ([] if features is None else [features])
        return self.layer(torch.cat(parts, -1))


def main(algorithm: str = "mappo", agent_steps: int = 200_000, output: Path = Path("runs/custom-parts")) -> None:
    """Train, and load the policy."""
    channels = ("view", "cost_to_go", "custom_parts:congestion")
    env = EnvConfig(num_agents=4, view_size=(5, 5), view="centered", channels=channels, reward="custom_parts:pace")
    model = ModelConfig(encoder="custom_parts:Pooled")
    config = TrainConfig(TaskConfig(env), algorithm, model, OptimizationConfig(num_envs=16), agent_steps=agent_steps)
    train(config, output)
    print(load_policy(output, trust_remote_code=True).config.model.encoder)


if __name__ == "__main__":
    tyro.cli(main)
