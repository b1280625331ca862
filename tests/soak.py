"""Endurance: `python -m tests.soak` steps environments of all kinds on and on, and checks each step.

What is checked is written anew here, in one kernel that shares nothing with those of the package.
"""

from __future__ import annotations

import argparse
import itertools
import random
import sys
import time
from pathlib import Path

import numba
import numpy as np

from mapf_pz.instances import FixedMap, RandomObstacles
from mapf_pz.simulator import Simulator
from mapf_pz.simulator.config import EnvConfig

RULES = (
    "",
    "an agent in an obstacle",
    "two agents on one cell",
    "the occupancy is not where the agents are",
    "a claim is left",
    "a move of more than one cell",
    "a move that is not ahead",
    "a move and a turn at once",
    "a swap",
    "an agent that has gone moves",
    "an agent has terminated and goes on",
)
KINDS = tuple(
    itertools.product(("rotate", "cardinal"), ("soft", "priority", "block_both"), ("nothing", "finish", "restart"))
)


@numba.njit
def broken_rule(cardinal, free, width, agents, occupant, claim):
    """Return the number of the first rule that is broken, the environment and the agent; 0: none is."""
    for b in range(agents.shape[0]):
        standing = 0
        for i in range(agents.shape[1]):
            agent = agents[b, i]
            if not free[b, agent.cell]:
                return 1, b, i
            rows, cols = agent.cell // width - agent.was_cell // width, agent.cell % width - agent.was_cell % width
            if abs(rows) + abs(cols) > 1:
                return 5, b, i
            moved, turned = agent.cell != agent.was_cell, agent.heading != agent.was_heading
            if moved and not agent.was_active:
                return 9, b, i
            if not cardinal and moved:
                ahead = (cols == 1, rows == 1, cols == -1, rows == -1)  # east, south, west, north
                if not ahead[agent.heading]:
                    return 6, b, i
                if turned:
                    return 7, b, i
            if agent.active:
                standing += 1
                if occupant[b, agent.cell] != i:
                    return (2 if occupant[b, agent.cell] >= 0 else 3), b, i
                other = occupant[b, agent.was_cell]
                if moved and other >= 0 and agents[b, other].was_cell == agent.cell:
                    return 8, b, i
            elif agent.was_active and not agent.terminated:
                return 10, b, i
        for cell in range(occupant.shape[1]):
            standing -= occupant[b, cell] >= 0
            if claim[b, cell] != -1:
                return 4, b, -1
        if standing != 0:
            return 3, b, -1
    return 0, -1, -1


def soak(agent_steps, seed=0, show=print):
    """Step at least so many times in all, and return how many steps, episodes and seconds it took.

    Raises `AssertionError` that says how to see it again.
    """
    draw = random.Random(seed)
    done, resets, began = 0, 0, time.monotonic()
    for number in itertools.count():
        if done >= agent_steps:
            return done, resets, time.monotonic() - began
        kind = KINDS[number % len(KINDS)]
        steps, episodes = play(kind, draw.randrange(2**32), agent_steps / len(KINDS) / 4)
        done, resets = done + steps, resets + episodes
        show(f"{done:.3g} agent steps, {resets} episodes, {time.monotonic() - began:.0f} s, {resident():.0f} MiB")


def play(kind, seed, agent_steps):
    """Step environments of one kind, on one map or on new ones in every episode."""
    draw = random.Random(seed)
    action_model, collision_system, on_target = kind
    height, width = draw.randint(3, 32), draw.randint(3, 32)
    num_agents = draw.randint(1, max(1, height * width // 4))
    agent_steps = min(agent_steps, 50_000 * num_agents)  # where few agents meet, resets take most of the time
    num_envs = max(1, 4096 // num_agents)
    source = RandomObstacles(height, width, draw.choice([0, 0.1, 0.3]), num_agents)
    if draw.random() < 0.9:  # new maps take most of the time
        source = FixedMap(source.sample(np.random.default_rng(seed)).grid, num_agents)
    config = EnvConfig(
        source=source,
        action_model=action_model,
        collision_system=collision_system,
        on_target=on_target,
        max_steps=draw.choice([64, 256, 1024]),
        view_size=(1, 1),
        reward=draw.choice(["report", "report", "report", "progress"]),
    )
    simulator = Simulator(config, num_envs, draw.choice([1, 2]))
    simulator.reset(seeds={b: seed + b for b in range(num_envs)})
    free = np.stack([simulator.grid(b).free.reshape(-1) for b in range(num_envs)])
    rng = np.random.default_rng(seed)
    state, done, episodes = simulator.state, 0, num_envs
    while done < agent_steps:
        simulator.step(rng.integers(simulator.num_actions, size=(num_envs, num_agents)))
        done += num_envs * num_agents
        rule, b, i = broken_rule(action_model == "cardinal", free, width, state.agents, state.occupant, state.claim)
        assert not rule, f"{RULES[rule]}: play({kind}, {seed}), environment {b}, agent {i}, after {done} agent steps"
        over = np.flatnonzero(simulator.over).tolist()
        simulator.reset(over)
        for b in over:
            free[b] = simulator.grid(b).free.reshape(-1)
        episodes += len(over)
    return done, episodes


def reset_again_and_again(number):
    """Return the growth of resident memory in MiB over so many resets, after a tenth as many to update_goals."""
    config = EnvConfig(source=RandomObstacles(12, 12, 0.2, 6), reward="progress", features=("action_advantage",))
    simulator = Simulator(config, num_envs=16)
    for _ in range(number // 160):
        simulator.reset()
    before = resident()
    for _ in range(number // 16):
        simulator.reset()
        simulator.step(np.zeros((16, 6), np.int64))
        simulator.observe()
    return resident() - before


def resident():
    """Return this process's resident memory in MiB."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 2**20


def main():
    """Soak, then reset, and tell the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--agent-steps", type=float, default=1e9)
    parser.add_argument("--resets", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    steps, episodes, seconds = soak(options.agent_steps, options.seed, lambda line: print(line, file=sys.stderr))
    print(f"{steps} agent steps in {episodes} episodes, {seconds:.0f} s: every rule held after every step")
    print(f"{options.resets} resets: resident memory grew by {reset_again_and_again(options.resets):.1f} MiB")


if __name__ == "__main__":
    main()
