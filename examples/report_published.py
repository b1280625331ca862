"""The report's experiment as its authors ran it, with Stable-Baselines3: `pip install stable-baselines3`.

The settings are those of their runs 21 and 23; with `--actions weights`, those of 24 and 25.

Their environment with its defects (`report_env.py`), their network, and PPO with their settings. `--repair` repairs
defects, one or several; `--repair all` all of them, except for those that `--keep` names. A stopped run goes on from
its last evaluation.
"""

import csv
import io
import pickle
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
import torch
import tyro
from centralized_sb3 import ReportCNN
from numpy.typing import NDArray
from report_env import Actions, Defects, ReportEnv
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.preprocessing import is_image_space
from stable_baselines3.common.vec_env import VecEnv
from torch import nn
from torch.nn.utils import convert_conv2d_weight_memory_format

CHECKPOINT = "checkpoint.pickle"
DEFECTS = tuple(field.name for field in fields(Defects))
COLUMNS: tuple[str, ...] = (
    *("env_steps", "mean_reward", "min_reward", "max_reward", "finished"),
    *("fresh_reward", "fresh_finished"),
)
"""Environment steps; the reward of an episode in the one environment of evaluations, and how many agents have finished
there; the mean reward of an episode in new environments, in which no agent has finished yet, and how many agents finish
in it."""


@dataclass(frozen=True)
class Example:
    """One run."""

    steps: int = 500_000
    """Length of training in environment steps, rounded up to whole evaluation intervals."""
    repair: tuple[str, ...] = ()
    """The repaired defects, or `all`."""
    keep: tuple[str, ...] = ()
    """Defects that are kept although `repair` names them or `all`."""
    actions: Actions = "number"
    """Each agent's action: a `number` in runs until December 5, 2023, four `weights` from December 6 on."""
    gsde: bool = True
    """Whether exploration depends on the state (gSDE); otherwise, noise is independent in each step."""
    dropout: float = 0.1
    """Dropout of the features. The authors' runs with 8 and 16 environments have 0.1, the others 0."""
    num_envs: int = 8
    """Number of environments, with 512 steps each in a batch."""
    interval: int = 25_000
    """Environment steps between evaluations."""
    episodes: int = 5
    """Episodes of an evaluation."""
    seed: int = 0
    """Random seed."""
    output: Path = Path("runs/report_published")
    """Folder of `curve.csv` and of the checkpoint."""


@dataclass
class Run:
    """A run in progress. The environments are part of it, since finished agents stay finished in the published ones."""

    model: PPO
    """PPO with the environments that it is trained in."""
    evaluation: VecEnv
    """The environment of evaluations."""
    rows: list[dict[str, float]]
    """The evaluations up to now: see `COLUMNS`."""

    def save(self, folder: Path) -> None:
        """Write the evaluations and the checkpoint."""
        folder.mkdir(parents=True, exist_ok=True)
        with (folder / "curve.csv").open("w", newline="") as file:
            writer = csv.DictWriter(file, COLUMNS)
            writer.writeheader()
            writer.writerows(self.rows)
        model = io.BytesIO()
        self.model.save(model)
        parts = (model.getvalue(), self.model.get_env(), self.evaluation, self.rows, torch.get_rng_state())
        (folder / "checkpoint.new").write_bytes(pickle.dumps(parts))
        (folder / "checkpoint.new").replace(folder / CHECKPOINT)


def start(example: Example) -> Run:
    """Return a new run with the authors' settings."""
    return Run(make_model(example), make_vec_env(lambda: make_env(example), 1, seed=example.seed + 1000), [])


def resume(folder: Path) -> Run:
    """Return the run in a folder, which must be one of your own: the checkpoint is executed like a program."""
    model, envs, evaluation, rows, state = pickle.loads((folder / CHECKPOINT).read_bytes())
    torch.set_rng_state(state)
    return Run(PPO.load(io.BytesIO(model), envs, device="cpu", force_reset=False), evaluation, rows)


def make_env(example: Example) -> ReportEnv:
    """Return the environment; raises `ValueError` for an unknown defect."""
    if unknown := ({*example.repair} - {"all"} | {*example.keep}) - {*DEFECTS}:
        raise ValueError(f"{' '.join(sorted(unknown))}: no defect; expected all, or some of {', '.join(DEFECTS)}")
    repaired = replace(Defects(), **dict.fromkeys(DEFECTS if "all" in example.repair else example.repair, False))
    return ReportEnv(replace(repaired, **dict.fromkeys(example.keep, True)), example.actions)


def make_model(example: Example) -> PPO:
    """Return PPO with the authors' settings."""
    envs = make_vec_env(lambda: make_env(example), example.num_envs, seed=example.seed)
    policy = {
        "normalize_images": is_image_space(envs.observation_space),  # bytes up to 255 are divided by 255
        "features_extractor_class": ReportCNN,
        "features_extractor_kwargs": {"features_dim": 128, "dropout": example.dropout},
        "activation_fn": nn.GELU,
        "log_std_init": -2,
    }
    return PPO(
        "CnnPolicy",
        envs,
        learning_rate=2.5e-4,
        n_steps=512,
        batch_size=128,
        n_epochs=10,
        gamma=0.9999,
        gae_lambda=0.95,
        clip_range=0.2,
        ent_coef=0.0,
        vf_coef=0.19,
        max_grad_norm=5,
        use_sde=example.gsde,
        policy_kwargs=policy,
        seed=example.seed,
        device="cpu",
    )


def evaluate(run: Run, example: Example) -> dict[str, float]:
    """Return the team's rewards in episodes without exploration: see `COLUMNS`."""
    played = [play(run.model, run.evaluation) for _ in range(example.episodes)]
    returns = [float(rewards[0]) for rewards, _ in played]
    fresh = make_vec_env(lambda: make_env(example), example.episodes, seed=example.seed + 2000)
    rewards, finished = play(run.model, fresh)
    numbers = (
        *(run.model.num_timesteps, float(np.mean(returns)), min(returns), max(returns), int(played[-1][1][0])),
        *(float(rewards.mean()), float(finished.mean())),
    )
    return dict(zip(COLUMNS, numbers, strict=True))


def play(model: PPO, envs: VecEnv) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Play an episode in each environment; return the rewards and the numbers of finished agents, both (B,)."""
    observations, totals, over = envs.reset(), np.zeros(envs.num_envs), False
    finished = np.zeros(envs.num_envs, np.int64)
    while not over:
        actions, _ = model.predict(observations, deterministic=True)  # pyright: ignore[reportArgumentType]
        observations, rewards, ends, infos = envs.step(actions)
        totals, over = totals + rewards, bool(ends.all())
        finished = np.array([info["finished"] for info in infos])
    return totals, finished


def main(example: Example) -> None:
    """Train, and evaluate at regular intervals."""
    torch.set_num_threads(1)
    run = resume(example.output) if (example.output / CHECKPOINT).exists() else start(example)
    convert_conv2d_weight_memory_format(run.model.policy, torch.channels_last)  # a fifth less time on a CPU
    while run.model.num_timesteps < example.steps:
        run.model.learn(example.interval, reset_num_timesteps=run.model.num_timesteps == 0)
        run.rows.append(evaluate(run, example))
        run.save(example.output)
        print(", ".join(f"{name} {value:,.1f}" for name, value in run.rows[-1].items()), flush=True)


if __name__ == "__main__":
    main(tyro.cli(Example))
