"""A BenchMARL task, trained with MAPPO. It requires an older TorchRL than `mapf_pz.rl`: use a separate environment.

`pip install -r examples/benchmarl-requirements.txt .`; it runs with gymnasium 1.4.0, pettingzoo 1.27.0 and
torchvision 0.28.0. If torchvision fails to import with torch's CPU build, uninstall it. CSR was 0.96 and 0.90 in the
last two of 30 iterations, which took eleven minutes on a busy core.
"""
# pyright: reportMissingImports=false, reportUntypedBaseClass=false

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import tyro
from benchmarl.algorithms import MappoConfig
from benchmarl.environments.pettingzoo.common import PettingZooClass
from benchmarl.experiment import Experiment, ExperimentConfig
from benchmarl.models import MlpConfig
from torchrl.envs import FlattenObservation, PettingZooWrapper, TransformedEnv

import mapf_pz
from mapf_pz import RandomObstacles


@dataclass(frozen=True)
class Example:
    """Two agents on small random maps; `collection_CSR.csv` contains the learning curve."""

    iterations: int = 30
    """Number of iterations, each of which collects 2,000 environment steps and learns from them."""
    output: Path = Path("runs/example-benchmarl")
    """Folder of BenchMARL's logs."""


class Mapf(PettingZooClass):
    """A task, whose configuration is the keyword arguments of `parallel_env`."""

    def get_env_fun(self, num_envs: int, continuous_actions: bool, seed: int | None, device: Any) -> Any:
        """Return a function that creates an environment with flat observations, as BenchMARL's networks require."""
        flatten = partial(FlattenObservation, -3, -1, in_keys=[("agent", "observation", "image")])
        wrap = partial(PettingZooWrapper, categorical_actions=True, seed=seed, device=device)
        return lambda: TransformedEnv(wrap(mapf_pz.parallel_env(**self.config)), flatten())

    def supports_discrete_actions(self) -> bool:
        """Return True: the action space is `Discrete(4)`."""
        return True

    def max_steps(self, env: Any) -> int:
        """Return the length of an episode."""
        return self.config["max_steps"]

    @staticmethod
    def log_info(batch: Any) -> dict[str, float]:
        """Return the fraction of episodes that ended with all agents at their goals."""
        return {"collection/CSR": batch["next", "terminated"][batch["next", "done"]].float().mean().item()}


def main(example: Example) -> None:
    """Train the policy."""
    maps = RandomObstacles(height=6, width=6, density=0.1, num_agents=2)
    seen = {"channels": ("view", "cost_to_go", "others_next"), "features": ("action_advantage",)}
    task = Mapf("mapf", {"source": maps, "max_steps": 32, "reward": "progress", **seen})
    config = replace(ExperimentConfig.get_from_yaml(), lr=3e-4, gamma=0.98, evaluation=False, loggers=["csv"])
    config.max_n_iters, config.on_policy_collected_frames_per_batch = example.iterations, 2000
    config.max_n_frames, config.on_policy_n_minibatch_iters, config.save_folder = None, 10, example.output
    example.output.mkdir(parents=True, exist_ok=True)
    Experiment(task, MappoConfig.get_from_yaml(), MlpConfig.get_from_yaml(), seed=0, config=config).run()


if __name__ == "__main__":
    main(tyro.cli(Example))
