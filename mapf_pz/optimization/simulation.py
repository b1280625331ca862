"""An episode under a guidance graph: its score, and how its edges were used."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mapf_pz.environment.policy import simulator_of
from mapf_pz.evaluation.episodes import rollout
from mapf_pz.evaluation.policies import policy_factory
from mapf_pz.guidance import GuidanceGraph
from mapf_pz.optimization.task import GuidanceTask
from mapf_pz.optimization.usage import Usage
from mapf_pz.planners import Planner, planner_of
from mapf_pz.planners.base import run_episode
from mapf_pz.planners.named import import_code
from mapf_pz.simulator.config import EnvConfig
from mapf_pz.simulator.simulator import Simulator


@dataclass(frozen=True, eq=False)
class Simulation:
    """The result of an episode."""

    score: float
    """The task's score: higher is better."""
    usage: Usage
    """How often each edge was used."""


def simulate(task: GuidanceTask, graph: GuidanceGraph, seed: int, num_steps: int | None = None) -> Simulation:
    """Run an episode.

    Args:
        task: The task.
        graph: The guidance graph.
        seed: Seed of the instance and of the planner.
        num_steps: Maximum number of steps; None: the task's.

    Returns:
        The score and the usage of edges.
    """
    import_code(task.planner)  # in another process, it is not imported yet
    keywords = task.with_graph(graph, num_steps)
    usage = Usage.empty(graph.shape)
    simulator = (_plan if task.is_planner else _roll_out)(task, keywords, seed, usage)
    return Simulation(_score(simulator), usage)


def _plan(task: GuidanceTask, keywords: dict[str, Any], seed: int, usage: Usage) -> Simulator:
    """Let a planner act in a simulator, without observations."""
    config = EnvConfig(**(keywords | Planner.env_kwargs))
    simulator = Simulator(config)
    simulator.reset(seeds={0: seed})
    simulator.prepare_cost_to_go(1 + _typical_goals(config, simulator.shape))
    planner = planner_of(task.planner, seed)
    planner.compile(config.action_model)
    run_episode(simulator, planner, lambda _: usage.add(simulator.agents[0]))
    return simulator


def _typical_goals(config: EnvConfig, shape: tuple[int, int]) -> int:
    """Return about how many goals an agent reaches in an episode: a third of the map's sides is a typical distance."""
    return 3 * config.max_steps // sum(shape) if config.on_target == "restart" else 0


def _roll_out(task: GuidanceTask, keywords: dict[str, Any], seed: int, usage: Usage) -> Simulator:
    """Let a policy act on observations, with the settings that it requires."""
    make = policy_factory(task.planner, seed, trust_remote_code=task.trust_remote_code)
    env, policy = make(keywords)
    simulator = simulator_of(env)

    def count() -> None:
        if env.step_count:
            usage.add(simulator.agents[0])

    rollout(env, policy, seed, on_step=count)
    return simulator


def _score(simulator: Simulator) -> float:
    metrics = simulator.metrics(0)
    if simulator.config.on_target == "restart":
        return metrics["avg_throughput"]
    missing = (1 - metrics["ISR"]) * simulator.config.max_steps  # SoC counts them with the steps taken
    return -(metrics["SoC"] / simulator.num_agents + missing)
