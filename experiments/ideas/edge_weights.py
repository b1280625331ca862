"""Measure whether edge weights in the observation help: `python -m experiments.ideas.edge_weights`.

It is idea 1 of the report. Policies that differ in what they observe of the costs imitate a planner under guidance
graphs that are random in every episode, with three seeds, and are evaluated under graphs that none of them has seen.
`docs/results/edge-weights.csv` gets the results, whose runs are not repeated, and `docs/explanation/report-ideas.md`
the table.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro

from experiments.pages import FILES, PAGES, setting_lines, write_table
from experiments.study import Study, StudyOptions, folder
from mapf_pz.environment.policy import simulator_of
from mapf_pz.evaluation.episodes import rollout
from mapf_pz.evaluation.policies import policy_factory
from mapf_pz.rl.config import TaskConfig, TrainConfig
from mapf_pz.rl.presets import PRESETS
from mapf_pz.rl.progress import read_progress
from mapf_pz.rl.training.train import train
from mapf_pz.simulator.seeds import FIRST_EVALUATION_SEED
from mapf_pz.simulator.simulator import Simulator

PAGE = PAGES / "report-ideas.md"

AGENT_STEPS = 800_000
"""Length of a training."""
PLANNER, EXPERT = "the planner", PRESETS["lifelong"].imitation.expert
CHANNELS, FEATURES = ("view", "goal", "orientation", "other_goals"), ("last_actions", "goal_vector")
WEIGHTS = ("edge_weights",)
ROUTES = ("cost_to_go", "heuristic", "others_next", "others_heuristic")
ADVANTAGE = ("action_advantage",)
SETTINGS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "neither": ((), ()),
    "edge weights": (WEIGHTS, ()),
    "cost to go": (("cost_to_go",), ()),
    "cost to go, edge weights": (("cost_to_go", *WEIGHTS), ()),
    "all that derives from the cost to go": (ROUTES, ADVANTAGE),
    "all that derives from the cost to go, edge weights": ((*ROUTES, *WEIGHTS), ADVANTAGE),
}
"""Channels and features that are observed in addition to `CHANNELS` and `FEATURES`."""
METRICS = {"agreement": 3, "throughput": 2, "cost": 1}
"""Measures of a policy and their digits in the table; the expert has no agreement."""
STUDY = Study(FILES / "edge-weights.csv", ("setting", "seed"), tuple(METRICS))


@dataclass(frozen=True)
class Options(StudyOptions):
    """Options of the experiment."""

    output: Path = Path("runs/edge-weights")
    """Folder of all runs."""
    seeds: tuple[int, ...] = (0, 1, 2)
    """Random seeds."""
    agent_steps: int = AGENT_STEPS
    """Length of each training."""
    episodes: int = 32
    """Number of episodes of each evaluation."""


def config(setting: str) -> TrainConfig:
    """Return the preset `lifelong` with random graphs, a setting's observations, the layer, and no communication."""
    preset = PRESETS["lifelong"]
    channels, features = SETTINGS[setting]
    env = replace(
        preset.task.env,
        channels=(*CHANNELS, *channels),
        features=(*FEATURES, *features),
        edge_weights="random",
    )
    task = replace(preset.task, env=env, shield=True)
    model = replace(preset.model, communication=0, communication_radius=None)
    return replace(preset, task=task, model=model, validation_interval=0)


def main(options: Options) -> None:
    """Train and evaluate the missing runs in sequence, write the results after each, and the table at the end."""
    if not options.write:
        for planner in STUDY.missing([(PLANNER, 0)]):
            STUDY.add(planner, _measures(config("neither").task, EXPERT, options.episodes))
        for setting, seed in STUDY.missing((setting, seed) for seed in options.seeds for setting in SETTINGS):
            run = folder(options.output, setting, seed)
            if not (run / "policy.safetensors").exists():
                train(replace(config(setting), seed=seed, agent_steps=options.agent_steps), run, overwrite=True)
            measures = _measures(config(setting).task, f"{run}+pibt:temperature=0", options.episodes)
            STUDY.add((setting, seed), {"agreement": _agreement(run)} | measures)
    write()


def _agreement(run: Path) -> str:
    """Return how often the most likely action was the planner's in the last fifth of a training.

    It is measured before the policy learns from these steps; their episodes have graphs that it has not seen.
    """
    rates = [row["agreement"] for row in read_progress(run)]
    return f"{np.mean(rates[-len(rates) // 5 :]):.4f}"


def _measures(task: TaskConfig, policy: str, episodes: int) -> dict[str, str]:
    """Return goals per step, and the weights of all steps per goal, in episodes with graphs that are new."""
    env, acting = policy_factory(policy)(task.env_keywords())
    goals, cost = 0.0, 0.0
    for episode in range(episodes):
        costs = Costs(simulator_of(env))
        done = rollout(env, acting, FIRST_EVALUATION_SEED + episode, on_step=costs.add)
        goals += done.metrics["avg_throughput"] * done.num_steps
        cost += costs.total
    return {"throughput": f"{goals / (episodes * task.env.max_steps):.4f}", "cost": f"{cost / goals:.3f}"}


class Costs:
    """The weights of all agents' steps in an episode: of edges, and of waiting and turning."""

    def __init__(self, simulator: Simulator) -> None:
        """Start with no steps."""
        self._simulator = simulator
        self._before: np.ndarray | None = None
        self.total = 0.0

    def add(self) -> None:
        """Add the last step; the first call is after the reset."""
        view = self._simulator.planning_view()
        cells = view.agents["cell"].copy()
        if self._before is not None:
            moves = view.leads_to[:, self._before] == cells
            moved = cells != self._before
            edge = np.where(moved, moves.argmax(0), len(view.weight) - 1)
            self.total += float(view.weight[edge, self._before].sum())
        self._before = cells


def write() -> None:
    """Write the table: means over seeds, with minimum and maximum."""
    write_table(PAGE, "edge weights", table(STUDY.rows()))


def table(rows: Sequence[Mapping[str, str]]) -> Iterator[str]:
    """Yield the lines of the table in Markdown."""
    yield "| observed | agreement | goals per step | cost per goal |"
    yield "| --- | --- | --- | --- |"
    yield from setting_lines(rows, METRICS)


if __name__ == "__main__":
    main(tyro.cli(Options))
