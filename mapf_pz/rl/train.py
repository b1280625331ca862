"""The training loop: collect, estimate advantages, update; the same for all algorithms."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.data.replay_buffers.samplers import SamplerWithoutReplacement
from torchrl.envs import Compose, EnvBase, RewardSum, TransformedEnv
from torchrl.objectives import PPOLoss

from mapf_pz.rl.algorithms import ALGORITHMS, Algorithm
from mapf_pz.rl.batched_env import BatchedMapfEnv
from mapf_pz.rl.checkpoint import Learner, read_position
from mapf_pz.rl.config import PPOConfig, TrainConfig
from mapf_pz.rl.policy import CONFIG, load_config
from mapf_pz.rl.run import RunFolder
from mapf_pz.types import FormatError

Progress = Callable[[dict[str, float]], None]


def train(config: TrainConfig, output: Path, on_progress: Progress | None = None) -> Path:
    """Train a policy and return the folder that it, its configuration and its progress were written to.

    Args:
        config: the run.
        output: the run's folder; an earlier run in it is replaced.
        on_progress: called after each update with the row that goes to `progress.csv`.

    An interrupt (Ctrl-C) ends the run early: what was learnt until then is saved before it is raised again, and
    `resume` continues from there.
    """
    return _run(config, RunFolder(output), None, on_progress)


def resume(folder: Path, agent_steps: int | None = None, on_progress: Progress | None = None) -> Path:
    """Continue a run that was interrupted or killed from its latest checkpoint, and return its folder.

    Args:
        folder: the run's folder.
        agent_steps: length of the whole run instead of the one that it was begun with, in steps of all agents.
        on_progress: as in `train`.

    Environments are not in a checkpoint: they begin new episodes, with seeds that the run has not used before.

    Raises:
        FileNotFoundError: The folder has no configuration, no progress or no checkpoint.
        FormatError: One of them is damaged, or they do not belong together.
        ValueError: The run is longer than `agent_steps` already.
    """
    run = RunFolder(folder)
    checkpoint = run.checkpoints.latest()
    config = load_config(folder / CONFIG)
    position = read_position(checkpoint)
    if position.agent_steps != position.updates * _steps_per_update(config):
        raise FormatError(checkpoint, f"not a checkpoint of the run that {CONFIG} describes")
    if agent_steps is not None:
        if agent_steps < position.agent_steps:
            raise ValueError(
                f"agent_steps={agent_steps}: the run in {str(folder)!r} has come to {position.agent_steps} already"
            )
        config = replace(config, agent_steps=agent_steps)
    return _run(config, run, checkpoint, on_progress)


def _run(config: TrainConfig, run: RunFolder, checkpoint: Path | None, on_progress: Progress | None) -> Path:
    """Train from the beginning, or from the checkpoint on."""
    torch.manual_seed(config.seed)
    torch.set_num_threads(config.num_threads)
    done = 0 if checkpoint is None else read_position(checkpoint).updates
    seed = _seed(config.seed, done)
    env = BatchedMapfEnv(config.ppo.num_envs, config.num_threads, **config.task.env_keywords())
    env.set_seed(seed)
    algorithm = ALGORITHMS[config.algorithm](replace(config, seed=seed))
    optimizer = torch.optim.Adam(algorithm.loss.parameters(), config.ppo.learning_rate, eps=1e-5)
    learner = Learner(algorithm.loss, optimizer)
    if checkpoint is None:
        run.begin(config)
    else:
        run.resume(checkpoint, learner, config)
    try:
        for row in _updates(config, algorithm, env, optimizer, done, run.seconds):
            run.log(row)
            run.save(learner, config.checkpoint_interval)
            if on_progress is not None:
                on_progress(row)
        run.save(learner)
    except KeyboardInterrupt:
        run.save(learner)
        raise
    finally:
        run.finish(algorithm.network)
    return run.path


def _seed(seed: int, done: int) -> int:
    """Return the seed of the environments after `done` updates: the run's own at its beginning."""
    return seed if done == 0 else int(np.random.SeedSequence([seed, done]).generate_state(1)[0])


def _steps_per_update(config: TrainConfig) -> int:
    """Return the steps of all agents between two updates."""
    return config.ppo.num_envs * config.ppo.steps_per_batch * config.task.num_agents


def _updates(
    config: TrainConfig,
    algorithm: Algorithm,
    env: EnvBase,
    optimizer: torch.optim.Optimizer,
    done: int,
    seconds_before: float,
) -> Iterator[dict[str, float]]:
    """Run the loop from update `done` on; yield a row of progress after each update."""
    ppo, loss = config.ppo, algorithm.loss
    frames = ppo.num_envs * ppo.steps_per_batch
    num_updates = max(1, config.agent_steps // _steps_per_update(config))
    if done >= num_updates:
        return
    reward_sum = RewardSum(
        in_keys=[("agents", "reward")], out_keys=[("agents", "episode_reward")], reset_keys=["_reset"]
    )
    transforms = [*algorithm.transforms(), reward_sum]
    collector = Collector(
        TransformedEnv(env, Compose(*transforms)),  # pyright: ignore[reportArgumentType] (annotated as lists of them)
        algorithm.actor,
        frames_per_batch=frames,
        total_frames=frames * (num_updates - done),
        auto_register_policy_transforms=False,
    )
    buffer = TensorDictReplayBuffer(
        storage=LazyTensorStorage(frames), sampler=SamplerWithoutReplacement(), batch_size=ppo.minibatch_size
    )
    began = time.perf_counter() - seconds_before
    for update, batch in enumerate(collector, done):
        _anneal(optimizer, loss, ppo, update / num_updates)
        with torch.no_grad():
            loss.value_estimator(
                batch, params=loss.critic_network_params, target_params=loss.target_critic_network_params
            )
        buffer.empty()
        buffer.extend(batch.reshape(-1))
        losses = [_improve(loss, optimizer, part, ppo) for _ in range(ppo.num_epochs) for part in buffer]
        agent_steps = (update + 1) * _steps_per_update(config)
        seconds = time.perf_counter() - began
        yield {
            "agent_steps": agent_steps,
            "seconds": seconds,
            "agent_steps_per_second": agent_steps / seconds,
            **_episode_means(batch),
            **{key: float(torch.stack([part[key] for part in losses]).mean()) for key in losses[0]},
        }
    collector.shutdown()


def _anneal(optimizer: torch.optim.Optimizer, loss: PPOLoss, ppo: PPOConfig, done: float) -> None:
    """Lower the step size and the entropy bonus linearly to a tenth; `done` in [0, 1]."""
    share = 1 - 0.9 * done
    for group in optimizer.param_groups:
        group["lr"] = ppo.learning_rate * share
    entropy_coeff: Tensor = loss.get_buffer("entropy_coeff")
    entropy_coeff.fill_(ppo.entropy_coeff * share)


def _improve(
    loss: PPOLoss, optimizer: torch.optim.Optimizer, part: TensorDictBase, ppo: PPOConfig
) -> dict[str, Tensor]:
    """Take one gradient step on a minibatch; return what the loss reports."""
    terms = loss(part)
    optimizer.zero_grad()
    (terms["loss_objective"] + terms["loss_critic"] + terms["loss_entropy"]).backward()
    torch.nn.utils.clip_grad_norm_(loss.parameters(), ppo.max_grad_norm)
    optimizer.step()
    return {key: terms[key].detach() for key in ("loss_objective", "loss_critic", "entropy", "kl_approx")}


def _episode_means(batch: TensorDictBase) -> dict[str, float]:
    """Return the means over the episodes that ended in the batch; nan where none did."""
    ended = batch["next", "done"].squeeze(-1)
    return {
        "episodes": float(ended.sum()),
        "CSR": float(batch["next", "terminated"][ended].float().mean()),
        "ISR": float(batch["next", "agents", "at_goal"][ended].float().mean()),
        "return": float(batch["next", "agents", "episode_reward"][ended].mean()),
    }
