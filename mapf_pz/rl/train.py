"""The training loop: collect, estimate advantages, update; the same for all algorithms."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path

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
from mapf_pz.rl.config import PPOConfig, TrainConfig
from mapf_pz.rl.run import RunFolder

Progress = Callable[[dict[str, float]], None]


def train(config: TrainConfig, output: Path, on_progress: Progress | None = None) -> Path:
    """Train a policy and return the folder that it, its configuration and its progress were written to.

    Args:
        config: the run.
        output: the run's folder.
        on_progress: called after each update with the row that goes to `progress.csv`.

    An interrupt (Ctrl-C) ends the run early: what was learnt until then is saved before it is raised again.
    """
    torch.manual_seed(config.seed)
    torch.set_num_threads(config.num_threads)
    base = BatchedMapfEnv(config.ppo.num_envs, config.num_threads, **config.task.env_keywords())
    base.set_seed(config.seed)
    layout = base.simulator.layout
    algorithm = ALGORITHMS[config.algorithm](layout, config)
    run = RunFolder(output)
    try:
        for row in _updates(config, algorithm, base):
            run.log(row)
            if on_progress is not None:
                on_progress(row)
    finally:
        run.finish(algorithm.network, config)
    return output


def _updates(config: TrainConfig, algorithm: Algorithm, env: EnvBase) -> Iterator[dict[str, float]]:
    """Run the loop; yield a row of progress after each update."""
    ppo, num_agents, loss = config.ppo, config.task.num_agents, algorithm.loss
    reward_sum = RewardSum(
        in_keys=[("agents", "reward")], out_keys=[("agents", "episode_reward")], reset_keys=["_reset"]
    )
    transforms = [*algorithm.transforms(), reward_sum]
    frames = ppo.num_envs * ppo.steps_per_batch
    num_updates = max(1, config.agent_steps // (frames * num_agents))
    collector = Collector(
        TransformedEnv(env, Compose(*transforms)),  # pyright: ignore[reportArgumentType] (annotated as lists of them)
        algorithm.actor,
        frames_per_batch=frames,
        total_frames=frames * num_updates,
        auto_register_policy_transforms=False,
    )
    buffer = TensorDictReplayBuffer(
        storage=LazyTensorStorage(frames), sampler=SamplerWithoutReplacement(), batch_size=ppo.minibatch_size
    )
    optimizer = torch.optim.Adam(loss.parameters(), ppo.learning_rate, eps=1e-5)
    began = time.perf_counter()
    for update, batch in enumerate(collector):
        _anneal(optimizer, loss, ppo, update / num_updates)
        with torch.no_grad():
            loss.value_estimator(
                batch, params=loss.critic_network_params, target_params=loss.target_critic_network_params
            )
        buffer.empty()
        buffer.extend(batch.reshape(-1))
        losses = [_improve(loss, optimizer, part, ppo) for _ in range(ppo.num_epochs) for part in buffer]
        agent_steps = (update + 1) * frames * num_agents
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
