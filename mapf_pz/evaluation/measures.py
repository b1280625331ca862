"""What an evaluation measures in an episode, in addition to the metrics of `mapf_pz.simulator.metrics`."""

from __future__ import annotations

import math
from dataclasses import dataclass

Metrics = dict[str, float]


@dataclass
class Measures:
    """Totals of an episode, from which its rates are computed."""

    num_steps: int = 0
    """Number of steps."""
    runtime: float = 0.0
    """Runtime of the policy in seconds; NaN: unknown."""
    agent_steps: int = 0
    """Number of steps of all agents together, other than those that have disappeared."""
    blocked: int = 0
    """Number of agent steps with a move that an obstacle or another agent blocked."""

    def add_step(self, agent_steps: int, blocked: int) -> None:
        """Add a step of the episode, with the numbers of agents that took it and that were blocked."""
        self.num_steps += 1
        self.agent_steps += agent_steps
        self.blocked += blocked

    def added_to(self, metrics: Metrics, best: float | None) -> Metrics:
        """Return the metrics of the episode, and those of `run_episodes`.

        Args:
            metrics: the metrics of the episode.
            best: the best known throughput, or the best known sum of costs; None: not known.
        """
        agent_steps = max(self.agent_steps, 1)
        added = {"collisions": self.blocked / agent_steps}
        if not math.isnan(self.runtime):
            step_ms, agent_us = 1e3 * self.runtime / max(self.num_steps, 1), 1e6 * self.runtime / agent_steps
            added |= {"runtime": self.runtime, "step_ms": step_ms, "agent_us": agent_us}
        if best and "avg_throughput" in metrics:
            added["best_ratio"] = metrics["avg_throughput"] / best
        elif best and metrics["CSR"] == 1:
            added["best_ratio"] = metrics["SoC"] / best
        return metrics | added
