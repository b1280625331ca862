"""Candidates: the interfaces of this package, parts of the simulator, a memory copy of the observations, and peers.

Every run has the length of one episode; the candidates alternate.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import numpy as np
from rich.table import Table

from experiments.speed.peers import SIMILAR, Peers, peer_runs
from experiments.speed.runs import Measurement, Run, measure, timed
from experiments.speed.teams import async_run, team_run
from experiments.speed.workload import Workload
from mapf_pz._internal.arrays import Ints
from mapf_pz.environment.mapf_env import parallel_env
from mapf_pz.wrappers.agent_vector import AgentVectorEnv

SIMULATOR, COPY = "simulator", "memory copy"


def simulator_run(workload: Workload) -> Run:
    """Step the simulator: all agents observe after every step, and finished environments are reset."""
    simulator = workload.simulator()
    actions = _random_actions(workload, simulator.num_actions)

    def play() -> int:
        for step in range(workload.env.max_steps):
            simulator.step(actions[step])
            simulator.reset(simulator.over.nonzero()[0].tolist())
            simulator.observe()
        return actions.size

    return timed(play, workload.observation_bytes)


def stepping_run(workload: Workload) -> Run:
    """Step without observations and resets, even after the end of an episode."""
    simulator = workload.simulator()
    actions = _random_actions(workload, simulator.num_actions)

    def play() -> int:
        for step in range(workload.env.max_steps):
            simulator.step(actions[step])
        return actions.size

    return timed(play)


def observing_run(workload: Workload) -> Run:
    """Observe without stepping."""
    simulator = workload.simulator()

    def play() -> int:
        for _ in range(workload.env.max_steps):
            simulator.observe()
        return workload.env.max_steps * workload.num_envs * workload.num_agents

    return timed(play, workload.observation_bytes)


def copy_run(workload: Workload) -> Run:
    """Copy the observations of all agents instead of computing them."""
    observation = workload.simulator().observe()

    def play() -> int:
        for _ in range(workload.env.max_steps):
            for array in observation:
                array.copy()
        return workload.env.max_steps * workload.num_envs * workload.num_agents

    return timed(play, workload.observation_bytes)


def pettingzoo_run(workload: Workload) -> Run:
    """Step one PettingZoo environment."""
    env = parallel_env(**workload.env_config().keywords())
    rng = np.random.default_rng(workload.seed)
    actions = rng.integers(env.simulator.num_actions, size=(workload.env.max_steps, workload.num_agents)).tolist()
    env.reset(seed=workload.seed)

    def play() -> int:
        for numbers in actions:
            env.step(dict(zip(env.possible_agents, numbers, strict=True)))
            if not env.agents:
                env.reset()
        return workload.env.max_steps * workload.num_agents

    return timed(play, workload.observation_bytes)


def vector_run(workload: Workload) -> Run:
    """Step all agents as environments of a Gymnasium vector environment."""
    env = AgentVectorEnv(workload.num_envs, num_threads=workload.num_threads, **workload.env_config().keywords())
    actions = _random_actions(workload, env.simulator.num_actions).reshape(-1, env.num_envs)
    env.reset(seed=workload.seed)
    return _vector_run(env.step, actions, workload)


def sb3_run(workload: Workload) -> Run:
    """Step all agents as environments of Stable-Baselines3; raises `ImportError` without it."""
    from mapf_pz.wrappers.sb3 import AgentVecEnv

    env = AgentVecEnv(workload.num_envs, num_threads=workload.num_threads, **workload.env_config().keywords())
    actions = _random_actions(workload, env.env.simulator.num_actions).reshape(-1, env.num_envs)
    env.seed(workload.seed)
    env.reset()
    return _vector_run(env.step, actions, workload)


def supersuit_run(workload: Workload) -> Run:
    """Step all agents as environments by SuperSuit, an eighth of an episode; raises `ImportError` without it."""
    import supersuit

    agents: Any = supersuit.pettingzoo_env_to_vec_env_v1(parallel_env(**workload.env_config().keywords()))
    env: Any = supersuit.concat_vec_envs_v1(agents, workload.num_envs, base_class="stable_baselines3")
    actions = _random_actions(workload, env.action_space.n).reshape(-1, env.num_envs)
    env.reset()
    return _vector_run(env.step, actions[: max(1, len(actions) // 8)], workload)


def _vector_run(step: Callable[[Ints], object], actions: Ints, workload: Workload) -> Run:
    """Step with actions (T, B * N)."""

    def play() -> int:
        for numbers in actions:
            step(numbers)
        return actions.size

    return timed(play, workload.observation_bytes)


def torchrl_run(workload: Workload) -> Run:
    """Collect with TorchRL and a random policy; raises `ImportError` without TorchRL."""
    from mapf_pz.rl import BatchedMapfEnv

    env = BatchedMapfEnv(workload.num_envs, workload.num_threads, **workload.env_config().keywords())
    env.set_seed(workload.seed)
    return _collector_run(env, workload.num_envs, workload)


def wrapper_run(workload: Workload) -> Run:
    """Collect from the PettingZoo environment with TorchRL's wrapper; raises `ImportError` without TorchRL."""
    return _collector_run(parallel_env(**workload.env_config().keywords()), 1, workload)


def _collector_run(env: Any, num_envs: int, workload: Workload) -> Run:
    from mapf_pz.rl.environments.collect import random_batches

    batches = random_batches(env, env.simulator, num_envs * workload.env.max_steps)

    def play() -> int:
        return next(batches).numel() * workload.num_agents

    return timed(play, workload.observation_bytes)


CANDIDATES: dict[str, Callable[[Workload], Run]] = {
    SIMULATOR: simulator_run,
    "  stepping": stepping_run,
    "  observing": observing_run,
    COPY: copy_run,
    "PettingZoo": pettingzoo_run,
    "Gymnasium, agents": vector_run,
    "Gymnasium, teams": team_run,
    "  AsyncVectorEnv": async_run,
}
OPTIONAL: dict[str, dict[str, Callable[[Workload], Run]]] = {
    "stable_baselines3": {"Stable-Baselines3, agents": sb3_run},
    "supersuit": {"  SuperSuit": supersuit_run},
    "torchrl": {"TorchRL": torchrl_run, "  PettingZooWrapper": wrapper_run},
}
"""Candidates by the module that they need."""


def candidates(workload: Workload, peers: Peers) -> dict[str, Run]:
    """Return the runs of all available candidates."""
    makers = dict(CANDIDATES)
    for module, others in OPTIONAL.items():
        makers |= others if find_spec(module) else {}
    return {name: make(workload) for name, make in makers.items()} | peer_runs(workload, peers)


def candidate_table(workload: Workload, peers: Peers, seconds: float) -> Table:
    """Measure all candidates: see `as_table`."""
    return as_table(measure(candidates(workload, peers), seconds))


def as_table(measured: dict[str, Measurement]) -> Table:
    """Return a table with a row per candidate.

    `bytes` is what each agent observes per step. The last columns compare with the memory copy and with POGEMA.
    """
    missing = [name.strip() for module, names in OPTIONAL.items() if not find_spec(module) for name in names]
    caption = f"not measured, as not installed: {', '.join(missing)}" if missing else None
    table = Table(title="thousands of agent steps, medians of runs", caption=caption)
    table.add_column("")
    peers = [peer for peer in SIMILAR if peer in measured]
    for heading in ["bytes", "per s", "per CPU s", "runs", "of copy"] + [f"x {peer.strip()}" for peer in peers]:
        table.add_column(heading, justify="right")
    for one in measured.values():
        row = [
            "" if one.observation is None else f"{one.observation:,}",
            f"{one.rate / 1000:,.0f}",
            f"{one.cpu_rate / 1000:,.0f}",
            str(one.num_runs),
            f"{one.rate / measured[COPY].rate:.1%}",
        ]
        row += [f"{one.cpu_rate / measured[peer].cpu_rate:.1f}" for peer in peers]
        table.add_row(one.name, *row)
    return table


def _random_actions(workload: Workload, num_actions: int) -> Ints:
    rng = np.random.default_rng(workload.seed)
    return rng.integers(num_actions, size=(workload.env.max_steps, workload.num_envs, workload.num_agents))
