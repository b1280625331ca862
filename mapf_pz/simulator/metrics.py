"""The metrics of one episode, with POGEMA's names and definitions (POGEMA 1.4.0, `wrappers/metrics.py`).

Those of a guidance graph, `WEIGHTED_METRICS`, are not in POGEMA.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mapf_pz._internal.arrays import Floats, Ints
from mapf_pz.simulator.config import OnTarget

WEIGHTED_METRICS = ("weighted_cost", "weighted_cost_ratio")
"""The metrics of episodes with one goal and other edge weights than `uniform`, with which they equal those of SoC."""


@dataclass(frozen=True, eq=False)
class WeightedCosts:
    """The costs of N agents in the weights of a guidance graph."""

    costs: Floats
    """(N,) float64: the sum of the weights of each agent's steps until the step since which it has been at its goal
    (or has disappeared there), or of all its steps if it is not there."""
    cheapest: Floats
    """(N,): the cost of each agent if it were alone, at least that of one wait; `inf` if there is no path of finite
    cost."""


@dataclass(frozen=True, eq=False)
class EpisodeRecord:
    """The data that metrics are computed from: N agents after `num_steps` steps."""

    on_target: OnTarget
    """The mode, which determines the metrics."""
    num_steps: int
    """Number of steps taken so far."""
    max_steps: int
    """Maximum number of steps of the episode."""
    resting_since: Ints
    """(N,): the step since which each agent has been at its goal (or has disappeared there); -1 if it is not there."""
    arrivals: Ints
    """(N,): number of goals that each agent has reached."""
    goal_counts: Ints
    """(N,): length of each agent's goal sequence, after which the sequence starts over."""
    shortest: Ints
    """(N,): length in steps of each agent's shortest path to its goal; -1 if there is none. Not read with `restart`."""
    weighted: WeightedCosts | None = None
    """The costs in edge weights; None with `uniform` weights, and with `restart`."""


def metric_names(on_target: OnTarget, weighted: bool = False) -> tuple[str, ...]:
    """Return the names of the metrics that `episode_metrics` computes.

    Args:
        on_target: the behavior at the goal.
        weighted: whether the edge weights are other than `uniform`.
    """
    if on_target == "restart":
        return "avg_throughput", "ep_length", "exhausted_agents"
    return "CSR", "ISR", "SoC", "makespan", "ep_length", "SoC_ratio", *(WEIGHTED_METRICS if weighted else ())


def episode_metrics(record: EpisodeRecord) -> dict[str, float]:
    """Return the metrics as if the episode ended now.

    `CSR`: 1 if all agents are at their goals (`finish`: have reached them), else 0. `ISR`: the fraction of agents that
    are. `SoC`: the sum over agents of the step since which they have been at their goals, at least 1, or of all steps
    for agents that are not; `makespan`: the maximum of these. `ep_length`: number of steps taken (`finish`: mean step
    of arrival). `SoC_ratio`: SoC divided by its value if each agent were alone: the sum of the shortest paths, each of
    which counts as at least 1. `avg_throughput`: goals reached, divided by the maximum number of steps (`restart`
    only).

    `weighted_cost` and `weighted_cost_ratio` (with `EpisodeRecord.weighted`): like SoC, but each step costs the weight
    of the edge that the agent took, or of waiting if it waited, turned or was blocked; an agent that starts at its goal
    and stays costs one wait. The lower bound is the sum of the cheapest costs of agents that are alone. A move along an
    edge of infinite weight makes both infinite.

    `exhausted_agents` (`restart` only; not in POGEMA): number of agents that reached the end of their instance's goal
    sequence and started it over. If it is not 0, the throughput is not that of the instance.
    """
    if record.on_target == "restart":
        return {
            "avg_throughput": float(record.arrivals.sum() / record.max_steps),
            "ep_length": float(record.num_steps),
            "exhausted_agents": float((record.arrivals >= record.goal_counts).sum()),
        }
    solved = record.resting_since >= 0
    costs = np.where(solved, record.resting_since, record.num_steps)
    shortest = np.maximum(record.shortest, 1)[record.shortest >= 0]
    metrics = {
        "CSR": float(solved.all()),
        "ISR": float(solved.mean()),
        "SoC": float(costs.sum()),
        "makespan": float(costs.max()),
        "ep_length": float(costs.mean()) if record.on_target == "finish" else float(record.num_steps),
        "SoC_ratio": _ratio(costs, shortest),
    }
    if record.weighted is None:
        return metrics
    costs, cheapest = record.weighted.costs, record.weighted.cheapest
    ratio = _ratio(costs, cheapest[np.isfinite(cheapest)])
    return metrics | dict(zip(WEIGHTED_METRICS, (float(costs.sum()), ratio), strict=True))


def _ratio(costs: Ints | Floats, least: Ints | Floats) -> float:
    """Return the sum of the costs over the sum of the least costs of the agents that have a path; 1 if none has."""
    return float(costs.sum() / least.sum(dtype=np.float64)) if least.size else 1.0
