"""The metrics of one episode, with POGEMA's names and definitions (POGEMA 1.4.0, `wrappers/metrics.py`).

Those of a guidance graph, `WEIGHTED_METRICS`, and of delays are not in POGEMA.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mapf_pz._internal.arrays import Bools, Floats, Ints
from mapf_pz.simulator.config import OnTarget

WEIGHTED_METRICS = ("weighted_cost", "weighted_cost_ratio")
"""The metrics of episodes with one goal and other edge weights than `uniform`, with which they equal those of SoC."""

DELAY_METRICS = ("delay_share", "delayed_SoC_ratio")
"""The metrics of episodes with delays; lifelong ones have only the first."""


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
    delayed: Bools | None = None
    """(num_steps, N): in which steps which agents were delayed; None if there are no delays."""


def metric_names(on_target: OnTarget, weighted: bool = False, delayed: bool = False) -> tuple[str, ...]:
    """Return the names of the metrics that `episode_metrics` computes.

    Args:
        on_target: the behavior at the goal.
        weighted: whether the edge weights are other than `uniform`.
        delayed: whether there are delays.
    """
    delays = DELAY_METRICS if delayed else ()
    if on_target == "restart":
        return "avg_throughput", "ep_length", "exhausted_agents", *delays[:1]
    weights = WEIGHTED_METRICS if weighted else ()
    return "CSR", "ISR", "SoC", "makespan", "ep_length", "SoC_ratio", *weights, *delays


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

    `delay_share` (with `EpisodeRecord.delayed`): the fraction of the steps of agents that had not disappeared in which
    they were delayed. `delayed_SoC_ratio`: SoC divided by its value if each agent were alone, with its delays: the step
    in which it has made as many steps without a delay as its shortest path has, or all steps if that is later.

    `exhausted_agents` (`restart` only; not in POGEMA): number of agents that reached the end of their instance's goal
    sequence and started it over. If it is not 0, the throughput is not that of the instance.
    """
    share = {} if record.delayed is None else {DELAY_METRICS[0]: _delay_share(record, record.delayed)}
    if record.on_target == "restart":
        return {
            "avg_throughput": float(record.arrivals.sum() / record.max_steps),
            "ep_length": float(record.num_steps),
            "exhausted_agents": float((record.arrivals >= record.goal_counts).sum()),
            **share,
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
    if record.weighted is not None:
        weighted, cheapest = record.weighted.costs, record.weighted.cheapest
        ratio = _ratio(weighted, cheapest[np.isfinite(cheapest)])
        metrics |= dict(zip(WEIGHTED_METRICS, (float(weighted.sum()), ratio), strict=True))
    if record.delayed is not None:
        alone = np.minimum(costs_alone(record.shortest, record.delayed), max(record.num_steps, 1))
        metrics |= share | {DELAY_METRICS[1]: _ratio(costs, alone[record.shortest >= 0])}
    return metrics


def _delay_share(record: EpisodeRecord, delayed: Bools) -> float:
    """Return the fraction of the agents' steps in which they were delayed; 0 before the first step."""
    present = np.ones_like(delayed)
    if record.on_target == "finish":  # an agent disappears after the step in which it arrives
        ends = np.where(record.resting_since >= 0, record.resting_since, record.num_steps)
        present = np.arange(len(delayed))[:, None] < ends
    return float(delayed[present].mean()) if present.any() else 0.0


def costs_alone(num_actions: Ints, delayed: Bools) -> Ints:
    """Return the step (N,) int64 after which each agent has acted `num_actions` (N,) times, at least 1.

    Args:
        num_actions: the number of actions.
        delayed: (T, N): in which steps which agents do not act. It is T + 1 for an agent that needs more steps.
    """
    acted = np.cumsum(~delayed, axis=0, dtype=np.int64)
    return (acted < num_actions).sum(axis=0) + 1


def _ratio(costs: Ints | Floats, least: Ints | Floats) -> float:
    """Return the sum of the costs over the sum of the least costs of the agents that have a path; 1 if none has."""
    return float(costs.sum() / least.sum(dtype=np.float64)) if least.size else 1.0
