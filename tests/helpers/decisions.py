"""Recorded decisions of planners in small cases: `python -m tests.helpers.decisions` records them again.

Published results of a planner are valid for these decisions. After a change of decisions, measure the results again.
"""

from functools import partial
from itertools import product
from pathlib import Path

import numpy as np

import mapf_pz
from mapf_pz.instances import RandomObstacles
from mapf_pz.instances.instance import Instance
from mapf_pz.planners import EPIBT, PIBT, LaCAM, PrioritizedSIPP, Shield
from mapf_pz.planners.deadline import Deadline
from mapf_pz.planners.sipp.refine import NeighborhoodSearch
from tests.helpers.text_instances import drawn, problem

RECORDING = Path(__file__).parents[1] / "recordings" / "decisions.npz"
MODELS = ("cardinal", "rotate")
WEIGHTS = ("uniform", "crisscross", "random")
MODES = ("nothing", "restart", "finish")
FIRST_LACAM, FIRST_PRIORITIZED = (partial(planner, anytime=False) for planner in (LaCAM, PrioritizedSIPP))


class RandomPreferences:
    """A policy with random preferences."""

    def __init__(self, env):
        self.num_actions, self.rng = env.action_space("agent_0").n, np.random.default_rng(0)

    def preferences(self, observations):
        return {name: self.rng.integers(5, size=self.num_actions) for name in observations}

    def reset_states(self):
        pass


STEP_PLANNERS = {
    "pibt": PIBT,
    "epibt": partial(EPIBT, depth=3),
    "shield": lambda env: Shield(RandomPreferences(env), env),
}


def episode(planner_in, model, weights, on_target, seed, num_agents=10, max_steps=20):
    """Return the decisions in an episode (T, N), and the number of arrivals."""
    env = mapf_pz.parallel_env(
        source=RandomObstacles(6, 6, 0.2, num_agents),
        action_model=model,
        edge_weights=weights,
        on_target=on_target,
        max_steps=max_steps,
    )
    observations, _ = env.reset(seed=seed)
    planner, decisions = planner_in(env), []
    while env.agents:
        actions = planner.act(observations)
        decisions.append([actions.get(name, -1) for name in env.possible_agents])
        observations = env.step(actions)[0]
    return np.array(decisions), int(env.simulator.agents[0]["arrivals"].sum())


def obstacles(model, seed, size=6, num_agents=10, density=0.15):
    """Return an instance with random obstacles."""
    rng = np.random.default_rng(seed)
    return facing(RandomObstacles(size, size, density, num_agents).sample(rng), model, rng)


def facing(instance, model, rng):
    """Return the instance with random headings for agents that turn."""
    headings = rng.integers(4, size=instance.num_agents) if model == "rotate" else None
    return Instance(instance.grid, instance.scenario, headings)


def solution(planner, instance, weights="uniform"):
    """Return a plan (T + 1, N, 3), and its sum of costs."""
    plan = planner.solve(instance, time_limit=1000.0, edge_weights=weights)
    headings = np.zeros(plan.positions.shape[:2]) if plan.headings is None else plan.headings
    return np.dstack([plan.positions, headings]), plan.sum_of_costs


def refined(model, weights, seed):
    """Return the numbers of missing paths, costs and complete paths during a search, and the final cost."""
    instance = obstacles(model, seed)
    search = NeighborhoodSearch(problem(instance, weights), np.random.default_rng(seed))
    search.plan_all(np.arange(instance.num_agents), Deadline(np.inf))
    seen = []
    for _ in range(8):
        search.improve(work=70)
        seen += [[search.missing, search.sum_of_costs], [] if search.missing else search.path().cells.ravel()]
    return np.concatenate(seen), search.sum_of_costs


def cases():
    """Return the recorded cases by name, which starts with the planner's name."""
    found = {}
    for model, (k, weights) in product(MODELS, enumerate(WEIGHTS)):
        for name, planner in STEP_PLANNERS.items():
            on_target = MODES[(k + MODELS.index(model)) % 3]
            found[f"{name} {model} {weights}"] = partial(episode, planner, model, weights, on_target, seed=k)
        found[f"lacam {model} {weights}"] = partial(solution, FIRST_LACAM(), obstacles(model, k), weights)
        instance = obstacles(model, seed=(0, 4, 7)[k])
        found[f"prioritized {model} {weights}"] = partial(solution, FIRST_PRIORITIZED(), instance, weights)
        for seed in (6, 7):
            found[f"refine {model} {weights} {seed}"] = partial(refined, model, weights, seed)
    for model in MODELS:
        for text in (
            "abc..CBA ####.###",
            "aB.bA .....",
            "abcd DCBA",
            "#c#d#e# a..f..b B.....A #g#h#F#",
            "abA B#. ...",
            "a# b# c# .# .. C# B# A#",
        ):
            instance = facing(drawn(text), model, np.random.default_rng(0))
            found[f"lacam {model} {text}"] = partial(solution, FIRST_LACAM(), instance)
        for size, num_agents, density in ((4, 14, 0.0), (5, 12, 0.3), (7, 32, 0.2)):
            instance = obstacles(model, 0, size, num_agents, density)
            found[f"lacam {model} {num_agents} agents"] = partial(solution, FIRST_LACAM(), instance)
        lifelong = partial(episode, model=model, weights="uniform", on_target="restart", seed=0)
        found[f"lacam {model} follows"] = partial(lifelong, FIRST_LACAM, num_agents=8, max_steps=15)
        found[f"pibt {model} stays"] = partial(
            episode, PIBT, model, "uniform", "nothing", seed=0, num_agents=20, max_steps=40
        )
        found[f"epibt {model} improves"] = partial(lifelong, partial(EPIBT, depth=2, rounds=2), num_agents=16)
    return found


def decided(case):
    """Return the decisions of a case, int32, one row for each step; the last row starts with arrivals or cost."""
    decisions, figure = case()
    rows = decisions.astype(np.int32).reshape(len(decisions), -1)
    return np.vstack([rows, np.full((1, rows.shape[1]), figure, np.int32)])


def difference(recorded, now):
    """Return a line on the first step that differs, or None."""
    for step, (before, after) in enumerate(zip(recorded[:-1], now[:-1], strict=False)):
        if before.shape != after.shape or (before != after).any():
            return f"step {step}: recorded {before.tolist()}, now {after.tolist()}"
    if recorded.shape != now.shape:
        return f"recorded {len(recorded) - 1} steps, now {len(now) - 1}"
    if recorded[-1, 0] != now[-1, 0]:
        return f"arrivals or cost: recorded {recorded[-1, 0]}, now {now[-1, 0]}"
    return None


def main():
    np.savez_compressed(RECORDING, **{name: decided(case) for name, case in cases().items()})


if __name__ == "__main__":
    main()
