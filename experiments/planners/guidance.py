"""Measure the numbers of docs/explanation/guidance-graphs.md.

`python -m experiments.planners.guidance COMMAND`. `optimize` writes a graph of each map to `runs/guidance/MAP`;
`compare` prints the table. Maps are read from the folder of GGO's released files and from those in
`MAPF_PZ_BENCHMARK`.
"""

from __future__ import annotations

import json
import math
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from mapf_pz.guidance import GuidanceGraph, save_guidance
from mapf_pz.guidance.library import guidance_graph
from mapf_pz.optimization.evaluate import compare as compare_graphs
from mapf_pz.optimization.task import GuidanceTask
from mapf_pz.simulator.config import ActionModel, Goals
from mapf_pz.simulator.keywords import EnvKeywords

RUNS = Path("runs/guidance")


@dataclass(frozen=True)
class Setup:
    """A map of Table 3 of Zhang et al., IJCAI 2024."""

    map: str
    """Name of the map, or of GGO's file of it."""
    num_agents: int
    """Number of agents."""
    published: float = math.nan
    """The best published throughput."""
    released: str | None = None
    """GGO's file of optimized weights, if it was released."""
    goals: Goals = "uniform"
    """How goals are sampled."""
    action_model: ActionModel = "cardinal"
    """How agents move."""
    planner: str = "pibt"
    """The planner that the graph is for."""
    max_steps: int = 1000
    """Length of an episode; in the paper 1000."""

    @property
    def name(self) -> str:
        """Name of the run."""
        return f"{Path(self.map).stem}-{self.num_agents}"

    def map_in(self, folder: Path) -> str:
        """Return the name of the map, or the path of GGO's file of it in `folder`."""
        return str(folder / self.map) if self.map.endswith(".json") else self.map

    def env(self, folder: Path) -> EnvKeywords:
        """Return the environment, with its map in `folder`."""
        return EnvKeywords(
            {
                "map": self.map_in(folder),
                "num_agents": self.num_agents,
                "goals": self.goals,
                "action_model": self.action_model,
                "on_target": "restart",
                "max_steps": self.max_steps,
            }
        )

    def flags(self, folder: Path) -> list[str]:
        """Return the flags of `mapf-pz guidance` for this setup."""
        task = ["--map", self.map_in(folder), "--num-agents", str(self.num_agents), "--goals", self.goals]
        rules = ["--action-model", self.action_model, "--max-steps", str(self.max_steps)]
        return [*task, *rules, "--planner", self.planner]


SETUPS = (
    Setup("pibt_random_unweight_32x32.json", 400, 7.78, "pibt_random_cma-es_32x32_400_agents_four-way-move.json"),
    Setup("empty-48-48", 1000, 25.98, "pibt_empty-48-48_cma-es-piu_1000_agents_four-way-move.json"),
    Setup(
        "pibt_warehouse_33x36_w_mode.json",
        *(400, 7.64, "pibt_warehouse-33x36_w_mode_cma-es_400_agents_four-way-move.json"),
        goals="alternating",
    ),
    Setup("pibt_room-64-64-8.json", 1500, 3.13, "pibt_room_cma-es-piu-transfer_64x64_1500_agents_four-way-move.json"),
    Setup("maze-32-32-4", 400, 1.47),
    Setup("den312d", 1200, 4.98),
)
BUNDLED = (
    Setup("random-32-32-20", 200, action_model="rotate", planner="epibt:depth=4", max_steps=300),
    Setup("warehouse-10-20-10-2-1", 400),
    Setup("random-24-24-20", 150),
)
TURNING = (("random-32-32-20", 100), ("random-32-32-20", 200))
GRAPHS = Path("mapf_pz/guidance/graphs")


def optimize(ggo: Path, minutes: float = 10.0, only: tuple[str, ...] = (), seed: int = 0) -> None:
    """Optimize a graph for each map.

    Args:
        ggo: Folder of GGO's released files.
        minutes: Time budget of each map.
        only: Names of runs; all if there are none.
        seed: Random seed.
    """
    for setup in _chosen(SETUPS, only):
        words = ["guidance", "optimize", *setup.flags(ggo), "--minutes", str(minutes), "--seed", str(seed)]
        command = [sys.executable, "-m", "mapf_pz", *words, "--output", str(RUNS / setup.name)]
        print(" ".join(["mapf-pz", *words]), flush=True)
        subprocess.run(command, check=True)


def _chosen(setups: Sequence[Setup], only: Sequence[str]) -> list[Setup]:
    """Return the setups with one of these names; all if there are none."""
    return [setup for setup in setups if not only or setup.name in only]


def compare(ggo: Path, num_seeds: int = 50, only: tuple[str, ...] = (), jobs: int = 2) -> None:
    """Print the throughput of uniform, crisscross, released and optimized weights.

    Args:
        ggo: Folder of GGO's released files.
        num_seeds: Number of episodes of each graph.
        only: Names of runs; all if there are none.
        jobs: Number of processes.
    """
    print("| map, agents | published best | uniform | crisscross | released | optimized |\n| --- |" + " --- |" * 5)
    for setup in _chosen(SETUPS, only):
        task = GuidanceTask(env=setup.env(ggo), planner=setup.planner)
        files = {
            "uniform": "uniform",
            "crisscross": "crisscross",
            "optimized": str(RUNS / setup.name / "guidance.json"),
        }
        if setup.released is not None:
            files["released"] = str(ggo / setup.released)
        graphs = {name: guidance_graph(file, task.grid) for name, file in files.items()}
        found = {
            row.name: f"{row.mean:.2f} ± {row.standard_error:.2f}"
            for row in compare_graphs(task, graphs, num_seeds, jobs=jobs)
        }
        cells = [found.get(name, "") for name in ("uniform", "crisscross", "released", "optimized")]
        print(f"| {task.grid.name}, {setup.num_agents} | {setup.published} | {' | '.join(cells)} |", flush=True)


def bundle(num_seeds: int = 50, minutes: float = 4.0, only: tuple[str, ...] = (), jobs: int = 2) -> None:
    """Optimize graphs of bundled maps, and write them to the package with their cards.

    Args:
        num_seeds: Number of episodes by which each is compared with uniform and crisscross weights.
        minutes: Time budget of each map.
        only: Names of runs; all if there are none.
        jobs: Number of processes.
    """
    for setup in _chosen(BUNDLED, only):
        output = RUNS / setup.name
        words = ["guidance", "optimize", *setup.flags(Path()), "--minutes", str(minutes)]
        if not (output / "guidance.json").exists():
            subprocess.run([sys.executable, "-m", "mapf_pz", *words, "--output", str(output)], check=True)
        task = GuidanceTask(env=setup.env(Path()), planner=setup.planner)
        graph = guidance_graph(output / "guidance.json", task.grid)
        graphs = {
            "uniform": GuidanceGraph.uniform(task.grid.free),
            "crisscross": GuidanceGraph.crisscross(task.grid.free),
        }
        rows = compare_graphs(task, graphs | {"optimized": graph}, num_seeds, jobs=jobs)
        card = {
            "map": setup.map,
            "num_agents": setup.num_agents,
            "planner": task.planner,
            "command": " ".join(["mapf-pz", *words]),
            "seeds": f"0 to {num_seeds - 1}",
            "goals_per_step": {
                row.name: {"mean": round(row.mean, 4), "standard_error": round(row.standard_error, 4)} for row in rows
            },
        }
        save_guidance(graph, GRAPHS / f"{setup.name}.npz", task.grid)
        (GRAPHS / f"{setup.name}.json").write_text(json.dumps(card, indent=2) + "\n", "utf-8")
        print(setup.name, card["goals_per_step"], flush=True)


def turns(planner: str = "epibt:depth=3", num_seeds: int = 16, jobs: int = 2) -> None:
    """Print the throughput of agents that turn, for several costs of turning and waiting; moves cost 1.

    Args:
        planner: Planner.
        num_seeds: Number of episodes of each cost.
        jobs: Number of processes.
    """
    costs = (0.5, 1, 2, 4, 8)
    print(f"| map, agents | {' | '.join(f'{cost:g}' for cost in costs)} |\n| --- |" + " --- |" * len(costs))
    for map, num_agents in TURNING:
        env = EnvKeywords({"map": map, "num_agents": num_agents, "on_target": "restart", "max_steps": 500})
        task = GuidanceTask(env=env, planner=planner)
        uniform = GuidanceGraph.uniform(task.grid.free)
        graphs = {str(cost): GuidanceGraph(uniform.move, np.full(task.grid.shape, cost)) for cost in costs}
        rows = compare_graphs(task, graphs, num_seeds, jobs=jobs)
        found = {row.name: f"{row.mean:.2f} ± {row.standard_error:.2f}" for row in rows}
        print(f"| {map}, {num_agents} | {' | '.join(found[name] for name in graphs)} |", flush=True)


if __name__ == "__main__":
    tyro.extras.subcommand_cli_from_dict({"optimize": optimize, "compare": compare, "bundle": bundle, "turns": turns})
