"""How many agents one stacked policy can control: `python -m experiments.ideas.capacity`.

The network of the report's policy learns, with labels instead of rewards, the action that is best for each agent alone,
which its features show (`action_advantage`). This is an upper bound of what it can learn from rewards. Observations are
of agents in the report's warehouse that take that action with a probability of 0.8, and a random one otherwise. The
images are left out. It prints a table.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
import torch
import tyro
from torch import Tensor, nn

from experiments.pages import FILES, PAGES, spread, write_table
from experiments.study import Study, StudyOptions
from mapf_pz.rl.networks.actors import TeamActor
from mapf_pz.rl.networks.observation_shape import ObservationShape
from mapf_pz.rl.presets import PRESETS
from mapf_pz.simulator.config import EnvConfig
from mapf_pz.simulator.simulator import Simulator

PAGE = PAGES / "report.md"

PRESET = PRESETS["report-repaired"]
NUM_AGENTS = (10, 20, 50, 100)
WIDTHS = {"128, 64, 64": (128, (64, 64)), "512, 512, 512": (512, (512, 512))}
"""The sizes of the embedding and the policy head: those of the report, and larger ones (idea 6)."""
NUM_ENVS, BATCH, HELD_OUT = 16, 256, 50
"""Environments, states of a gradient step, and batches that accuracy is measured on."""
STUDY = Study(FILES / "capacity.csv", ("agents", "network", "seed"), ("accuracy", "most_frequent"))
"""The shares of agents whose best action is the one that the network has learned, and the most frequent one."""


@dataclass(frozen=True)
class Options(StudyOptions):
    """Options of the experiment."""

    seeds: tuple[int, ...] = (0, 1, 2)
    """Random seeds of the instances and the networks."""
    steps: int = 2000
    """Number of gradient steps."""


def env_config(num_agents: int) -> EnvConfig:
    """Return the preset's environment without images, and with costs in steps, which take less time to compute."""
    costs = {"edge_weights": "uniform", "around_agents_at_goals": False}
    return replace(PRESET.task.env, num_agents=num_agents, view_size=(3, 3), channels=("view",), **costs)


def batches(config: EnvConfig, seed: int) -> Iterator[tuple[Tensor, Tensor]]:
    """Yield features (BATCH, N * F) and the best actions (BATCH, N), without end."""
    simulator, rng = Simulator(config, NUM_ENVS), np.random.default_rng(seed)
    simulator.reset(seeds={b: seed * NUM_ENVS + b for b in range(NUM_ENVS)})
    features, labels = [], []
    while True:
        for _ in range(BATCH // NUM_ENVS):
            seen = simulator.observe().features
            best = seen[..., : simulator.num_actions].argmax(-1)  # `action_advantage` is the first feature
            features.append(seen.reshape(NUM_ENVS, -1))
            labels.append(best)
            randomly = rng.random(best.shape) < 0.2
            simulator.step(np.where(randomly, rng.integers(simulator.num_actions, size=best.shape), best))
            simulator.reset(np.flatnonzero(simulator.over).tolist())
        yield torch.from_numpy(np.concatenate(features)), torch.from_numpy(np.concatenate(labels))
        features, labels = [], []


def measures(num_agents: int, widths: tuple[int, tuple[int, ...]], seed: int, steps: int) -> dict[str, str]:
    """Return the measures of a network after a training."""
    config = env_config(num_agents)
    torch.manual_seed(seed)
    model = replace(PRESET.model, hidden=widths[0], head=widths[1])
    shape = ObservationShape.of_task(replace(PRESET.task, env=config))
    actor = TeamActor(shape, num_agents, model)
    image = torch.zeros(BATCH, num_agents * shape.image[0], *shape.image[1:])
    optimizer = torch.optim.Adam(actor.parameters(), lr=1e-3)
    schedule = torch.optim.lr_scheduler.LinearLR(optimizer, 1.0, 0.1, steps)
    states = batches(config, seed)
    for _ in range(steps):
        features, labels = next(states)
        means, _ = actor(image, features)
        loss = nn.functional.cross_entropy(means.flatten(0, 1), labels.flatten())
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
    held_out = list(islice(states, HELD_OUT))
    labels = torch.stack([labels for _, labels in held_out])
    with torch.no_grad():
        learned = torch.stack([actor(image, features)[0].argmax(-1) for features, _ in held_out])
    shares = {"accuracy": learned == labels, "most_frequent": labels == labels.flatten().mode().values}
    return {name: f"{right.double().mean():.4f}" for name, right in shares.items()}


def main(options: Options) -> None:
    """Train the missing networks in sequence, write the results after each, and the table at the end."""
    torch.set_num_threads(1)
    if not options.write:
        runs = ((n, network, seed) for seed in options.seeds for n in NUM_AGENTS for network in WIDTHS)
        for n, network, seed in STUDY.missing(runs):
            STUDY.add((n, network, seed), measures(n, WIDTHS[network], seed, options.steps))
    write()


def write() -> None:
    """Write the table: means over seeds, with minimum and maximum."""
    write_table(PAGE, "capacity", table(STUDY.rows()))


def table(rows: Sequence[Mapping[str, str]]) -> Iterator[str]:
    """Yield the lines of the table in Markdown."""
    yield f"| agents | the most frequent action | {' | '.join(WIDTHS)} |"
    yield "| --- | --- |" + " --- |" * len(WIDTHS)
    for n in NUM_AGENTS:
        chosen = [row for row in rows if row["agents"] == str(n)]
        shares = [[float(row["most_frequent"]) for row in chosen]]
        shares += [[float(row["accuracy"]) for row in chosen if row["network"] == network] for network in WIDTHS]
        yield f"| {n} | {' | '.join(spread(each, 3) for each in shares)} |"


if __name__ == "__main__":
    main(tyro.cli(Options))
