"""Compare CBS with a brute-force search: `python -m experiments.planners.optimality`.

On random instances of 2 and 3 agents on maps of 2 x 2 to 4 x 4 cells, with both action models, the sums of costs must
be equal, also where there is no solution. Prints the differences, and the CPU times of CBS.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np
import tyro

from mapf_pz.instances import RandomObstacles
from mapf_pz.instances.instance import Instance
from mapf_pz.planners import CBS, validate
from tests.helpers.joint_search import lowest_cost

DENSITIES = (0.0, 0.2, 0.35)


@dataclass(frozen=True)
class Comparison:
    """Compare CBS with a brute-force search on random instances."""

    instances: int = 5000
    """Number of instances."""
    seed: int = 0
    """Seed of the instances."""


def sample(rng: np.random.Generator, cardinal: bool) -> Instance | None:
    """Return a random instance, or None if the sampled map has no room for its agents."""
    height, width = rng.integers(2, 5, size=2).tolist()
    num_agents = int(rng.integers(2, 4))
    try:
        drawn = RandomObstacles(height, width, float(rng.choice(DENSITIES)), num_agents).sample(rng)
    except ValueError:
        return None
    return Instance(drawn.grid, drawn.scenario, None if cardinal else rng.integers(4, size=num_agents))


def main(comparison: Comparison) -> None:
    """Compare, and print the differences and the times."""
    rng = np.random.default_rng(comparison.seed)
    planner = CBS()
    planner.compile("cardinal")
    planner.compile("rotate")
    seconds: list[float] = []
    unsolvable = different = 0
    while len(seconds) < comparison.instances:
        instance = sample(rng, cardinal=len(seconds) % 2 == 0)
        if instance is None:
            continue
        start = time.thread_time()
        plan = planner.solve(instance, math.inf)
        seconds.append(time.thread_time() - start)
        cost = None if plan is None or validate(instance, plan) else plan.sum_of_costs
        expected = lowest_cost(instance)
        unsolvable += expected is None
        if cost != expected:
            different += 1
            print(f"instance {len(seconds) - 1}: sum of costs {cost}, but {expected} by brute force: {instance}")
    print(f"{len(seconds)} instances, {unsolvable} without a solution: {different} with another sum of costs")
    print(f"CPU time of CBS: median {np.median(seconds):.4f} s, maximum {max(seconds):.3f} s")


if __name__ == "__main__":
    main(tyro.cli(Comparison))
