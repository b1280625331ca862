"""The metrics of one episode, with POGEMA's names and definitions (POGEMA 1.4.0, `wrappers/metrics.py`)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mapf_pz.arrays import Ints
from mapf_pz.config import OnTarget


@dataclass(frozen=True, eq=False)
class EpisodeRecord:
    """What the metrics are computed from: N agents after `num_steps` steps."""

    on_target: OnTarget
    """The mode: which metrics there are."""
    num_steps: int
    """Steps taken so far."""
    max_steps: int
    """The episode's limit."""
    resting_since: Ints
    """(N,): the step since which the agent is on its goal (or has disappeared there); -1 where it is not."""
    arrivals: Ints
    """(N,): goals reached."""
    goal_counts: Ints
    """(N,): goals of each agent's sequence, after which it starts over."""
    shortest: Ints
    """(N,): length of each agent's own shortest path from start to goal, in steps; -1 where there is none."""


def episode_metrics(record: EpisodeRecord) -> dict[str, float]:
    """Return the metrics as if the episode ended now.

    `CSR`: 1 if all agents are on their goals (`finish`: have reached them), else 0. `ISR`: the share who are. `SoC`:
    sum over agents of the step since which they stay on their goals, unsolved ones counting all steps; `makespan`: the
    latest of these. `ep_length`: steps taken (`finish`: mean step of arrival). `SoC_ratio`: SoC over the sum of the
    agents' shortest paths. `avg_throughput`: goals reached per step of the limit (`restart` only).

    `exhausted_agents` (`restart` only; not POGEMA's): agents that reached the end of the goal sequence that their
    instance gave them, and started it over. Above 0, the throughput is not that of the instance.
    """
    if record.on_target == "restart":
        return {
            "avg_throughput": float(record.arrivals.sum() / record.max_steps),
            "ep_length": float(record.num_steps),
            "exhausted_agents": float((record.arrivals >= record.goal_counts).sum()),
        }
    solved = record.resting_since >= 0
    costs = np.where(solved, record.resting_since, record.num_steps)
    bound = int(np.maximum(record.shortest, 0).sum())
    return {
        "CSR": float(solved.all()),
        "ISR": float(solved.mean()),
        "SoC": float(costs.sum()),
        "makespan": float(costs.max()),
        "ep_length": float(costs.mean()) if record.on_target == "finish" else float(record.num_steps),
        "SoC_ratio": float(costs.sum() / bound) if bound else 1.0,
    }
