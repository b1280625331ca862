"""Does a policy use the channels of edge weights? `python -m experiments.ideas.observed_weights`.

Agents pay the weight of each step. The cost to go that they observe counts steps, so that only the channels
`edge_weights` show the weights: random ones, and those of `crisscross`, whose directions depend on the parity of rows
and columns, which agents do not observe. Policies with these channels and without them learn by PPO with three seeds.
`docs/results/observed-weights.csv` gets the results on held-out instances, which are not repeated, and
`docs/explanation/report-ideas.md` the table.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from experiments.pages import FILES, PAGES, setting_lines, write_table
from experiments.study import Study, StudyOptions, folder
from mapf_pz import parallel_env
from mapf_pz._internal.arrays import Floats, Ints
from mapf_pz._internal.jit import Array
from mapf_pz.evaluation import EvaluationTask, evaluate, policy_factory
from mapf_pz.evaluation.episodes import rollout
from mapf_pz.guidance import GuidanceGraph
from mapf_pz.guidance.library import EdgeWeights
from mapf_pz.instances import InstanceList
from mapf_pz.instances.heading import Heading
from mapf_pz.instances.instance import Instance, Scenario
from mapf_pz.instances.mixture import MapMixture
from mapf_pz.planners import Planner, planner_of
from mapf_pz.planners.plans.plan import Plan
from mapf_pz.rl.config import ModelConfig, TrainConfig
from mapf_pz.rl.presets import PRESETS
from mapf_pz.rl.training.train import train
from mapf_pz.simulator.actions import Action
from mapf_pz.simulator.kernels.cost_lookup import LEAST_BIT, UNREACHABLE
from mapf_pz.simulator.kernels.cost_to_go import count_steps
from mapf_pz.simulator.kernels.observation.channels import Channel
from mapf_pz.simulator.kernels.observation.features import Feature
from mapf_pz.simulator.kernels.observation.inputs import ObservationInputs
from mapf_pz.simulator.kernels.reward import RewardConfig
from mapf_pz.simulator.kernels.world import allocate, set_map
from mapf_pz.simulator.seeds import FIRST_EVALUATION_SEED

PAGE = PAGES / "report-ideas.md"

WEIGHTS = ("crisscross", "random")
CHANNELS = {"without edge weights": (), "with edge weights": ("edge_weights",)}
"""Channels that are observed in addition to the others."""
REFERENCES = {"the planner without the weights": False, "the planner with the weights": True}
"""Whether a planner knows the weights, by its name in the table."""
SOLVED = "weighted_cost_ratio (solved)"
METRICS = {"CSR": 3, "ISR": 3, SOLVED: 3}
"""Metrics and their digits in the table."""
TEMPERATURES = (0.5, 0.0)
"""Temperatures of the evaluated policies. At 0.5, fewer agents block each other forever; at 0, paths are shorter."""
STUDY = Study(FILES / "observed-weights.csv", ("setting", "seed"), tuple(METRICS))
NUM_AGENTS, MAX_STEPS, MAPS = 4, 64, MapMixture(height=10, width=10, density=0.1)
REWARD = RewardConfig(forward=0.0, rotate=0.0, goal=2.0, weighted_step_cost=0.2)
"""No term but `weighted_step_cost` depends on the weights."""


@dataclass(frozen=True)
class Options(StudyOptions):
    """Options of the experiment."""

    output: Path = Path("runs/observed-weights")
    """Folder of all runs."""
    seeds: tuple[int, ...] = (0, 1, 2)
    """Random seeds."""
    agent_steps: int = 1_000_000
    """Length of each training."""
    episodes: int = 256
    """Number of episodes of each evaluation."""


# What agents observe: the number of steps to their goals, whatever these cost.


@lru_cache(2**14)
def steps_to(obstacles: bytes, shape: tuple[int, int], goal: int) -> Floats:
    """Return the steps (C + 1, 4) from each cell and heading to a goal by breadth-first search; inf: no path.

    `obstacles` are the bytes of (C + 1) float32, as in `World`.
    """
    free = np.frombuffer(obstacles, np.float32)[:-1].reshape(shape) == 0
    world = allocate(1, shape)
    set_map(world, 0, free, GuidanceGraph.uniform(free))
    packed = np.empty(free.size + 1, np.uint32)
    count_steps(world.leads_to[0], goal, len(Heading), packed, np.empty(4 * packed.size, np.int32))
    excess = packed[:, None] >> 2 * np.arange(len(Heading), dtype=np.uint32) & 3
    steps = (packed[:, None] >> LEAST_BIT) + excess
    return np.where(packed[:, None] == UNREACHABLE, np.inf, steps).astype(np.float32)


def steps_to_goals(inputs: ObservationInputs) -> Floats:
    """Return the steps (B, N, C + 1, 4) from each cell and heading to each agent's goal."""
    world, state = inputs.world, inputs.state
    shape = world.height, world.width
    maps = [world.obstacle[m].tobytes() for m in state.map]
    goals = state.agents["goal"].tolist()
    return np.stack([[steps_to(map, shape, goal) for goal in each] for map, each in zip(maps, goals, strict=True)])


def taken(values: Array, *places: Array) -> Array:
    """Return the values (B, N, ...) of each agent at `places`, one index (B, N, ...) for each further dimension."""
    extra = (1,) * (places[0].ndim - 2)
    b, n = (index.reshape(*index.shape, *extra) for index in np.ogrid[: values.shape[0], : values.shape[1]])
    return values[(b, n, *places)]


def draw_steps_to_go(inputs: ObservationInputs, image: Array, plane: int) -> None:
    """The channel `cost_to_go`, in steps: how much closer to the goal each cell is, over h + w."""
    steps, agents = steps_to_goals(inputs), inputs.state.agents
    own = taken(steps, agents["cell"], agents["heading"])[..., None]
    view = inputs.view_shape
    closer = (own - taken(steps.min(axis=3), inputs.cells)) / (view.height + view.width)
    image[:, :, plane] = np.clip(closer, -1, 1).reshape(image[:, :, plane].shape)


def write_step_advantage(inputs: ObservationInputs, values: Array, at: int) -> None:
    """The feature `action_advantage`, in steps: 0 for an action on a shortest path, -1 for one that loses two steps."""
    steps, agents = steps_to_goals(inputs), inputs.state.agents
    cell, heading = agents["cell"], agents["heading"]
    ahead = inputs.world.leads_to[inputs.state.map[:, None], heading, cell]
    own = taken(steps, cell, heading)
    after = {
        Action.FORWARD: np.where(ahead == cell, np.inf, taken(steps, ahead, heading)),
        Action.ROTATE_LEFT: taken(steps, cell, (heading + 3) % 4),
        Action.ROTATE_RIGHT: taken(steps, cell, (heading + 1) % 4),
        Action.WAIT: np.where(own == 0, -1, own),  # resting on the goal is free
    }
    for action, left in after.items():
        values[:, :, at + action] = np.clip(own - 1 - left, -2, 0) / 2


steps_to_go = Channel(draw_steps_to_go, low=-1)
step_advantage = Feature(write_step_advantage, length=len(Action))


def config(weights: str, observed: str) -> TrainConfig:
    """Return the training under some weights with some of `CHANNELS`."""
    preset, here = PRESETS["quickstart"], "experiments.ideas.observed_weights"
    env = replace(
        preset.task.env,
        num_agents=NUM_AGENTS,
        max_steps=MAX_STEPS,
        on_target="finish",
        edge_weights=weights,
        channels=("view", "goal", "orientation", *CHANNELS[observed], f"{here}:steps_to_go"),
        features=(f"{here}:step_advantage", "goal_vector", "last_actions"),
        reward=REWARD,
    )
    return replace(
        preset,
        task=replace(preset.task, env=env, mixture=MAPS),
        algorithm="ippo",
        model=ModelConfig(conv_channels=(32,)),
        optimization=replace(preset.optimization, num_envs=128),
    )


def main(options: Options) -> None:
    """Train and evaluate the missing runs in sequence, write the results after each, and the table at the end."""
    if not options.write:
        for weights in WEIGHTS:
            measure(weights, options)
    write()


def measure(weights: str, options: Options) -> None:
    """Measure the planners and the policies under some weights, those without results."""
    for name, knows_weights in REFERENCES.items():
        for reference in STUDY.missing([(f"{weights}: {name}", 0)]):
            STUDY.add(reference, planner_means(weights, knows_weights, options.episodes))
    for seed, observed, temperature in product(options.seeds, CHANNELS, TEMPERATURES):
        run, training = folder(options.output, f"{weights} {observed}", seed), config(weights, observed)
        for setting in STUDY.missing([(f"{weights}: {observed}, temperature {temperature:g}", seed)]):
            if not (run / "policy.safetensors").exists():
                train(replace(training, seed=seed, agent_steps=options.agent_steps), run, overwrite=True)
            STUDY.add(setting, policy_means(f"{run}:temperature={temperature:g}", training, options.episodes))


def policy_means(policy: str, training: TrainConfig, episodes: int) -> dict[str, str]:
    """Return the means of a policy's metrics in held-out episodes."""
    factory = policy_factory(policy, trust_remote_code=True)
    keywords = training.task.env_keywords()
    task = EvaluationTask("held out", NUM_AGENTS, keywords, episodes, FIRST_EVALUATION_SEED)
    return means(episode.metrics for episode in evaluate({policy: factory}, [task]))


def means(metrics: Iterable[Mapping[str, float]]) -> dict[str, str]:
    """Return the mean of each of `METRICS`, that of the costs over solved episodes."""
    found = list(metrics)
    values = {name: [one[name] for one in found] for name in ("CSR", "ISR")}
    values[SOLVED] = [one["weighted_cost_ratio"] for one in found if one["CSR"]]
    return {name: f"{np.mean(each):.4f}" for name, each in values.items()}


def planner_means(weights: str, knows_weights: bool, episodes: int) -> dict[str, str]:
    """Return the means of a planner's metrics in the held-out episodes."""
    env = parallel_env(**config(weights, "without edge weights").task.env_keywords())
    found: list[dict[str, float]] = []
    for episode in range(episodes):
        env.reset(seed=FIRST_EVALUATION_SEED + episode)
        instance = Instance(env.simulator.grid(0), Scenario(env.positions, env.goals), env.headings)
        graph = env.simulator.guidance(0)
        found.append(planned(instance, graph if knows_weights else "uniform", graph))
    return means(found)


def planned(instance: Instance, weights: EdgeWeights, graph: GuidanceGraph) -> dict[str, float]:
    """Return a planner's metrics with some weights as its costs; it pays those of `graph`."""
    rules: dict[str, Any] = {"source": InstanceList([instance]), "on_target": "finish", "max_steps": MAX_STEPS}
    env = parallel_env(**Planner.env_kwargs, **rules, num_agents=NUM_AGENTS, edge_weights=weights)
    positions: list[Ints] = []
    done = rollout(env, planner_of("pibt", env=env), seed=0, on_step=lambda: positions.append(env.positions.copy()))
    paid = parallel_env(**Planner.env_kwargs, **rules, num_agents=NUM_AGENTS, edge_weights=graph)
    paid.reset(seed=0)
    paid.simulator.require_cost_to_go()
    bound = float(paid.simulator.cost_to_go().sum())
    return done.metrics | {"weighted_cost_ratio": Plan(np.stack(positions)).weighted_cost(graph) / bound}


def write() -> None:
    """Write the table: means over seeds, with minimum and maximum."""
    write_table(PAGE, "observed weights", table(STUDY.rows()))


def table(rows: Sequence[Mapping[str, str]]) -> Iterator[str]:
    """Yield the lines of the table in Markdown."""
    yield f"| | {' | '.join(METRICS)} |"
    yield f"| --- |{' --- |' * len(METRICS)}"
    yield from setting_lines(rows, METRICS)


if __name__ == "__main__":
    main(tyro.cli(Options))
