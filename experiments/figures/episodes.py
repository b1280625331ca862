"""Draw the figures of the documentation: `make -f experiments/Makefile figures`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

import mapf_pz
from mapf_pz.commands.main import main
from mapf_pz.environment import MapfEnv
from mapf_pz.instances.sources import RandomObstacles
from mapf_pz.render.gif import save_png

IMAGES = Path(__file__).parents[2] / "docs" / "images"
WAREHOUSE = "warehouse-10-20-10-2-1"
PLANES = (
    "view",
    "goal",
    "orientation",
    "weight forward",
    "weight right",
    "weight back",
    "weight left",
    "cost_to_go",
)


def animate_episode() -> None:
    """Save an episode of a trained policy as an animation."""
    options = "--policy mappo --map random-24-24-20 --num-agents 40 --max-steps 160"
    if main(["render", str(IMAGES / "episode.svg"), *options.split()]):
        raise SystemExit(1)


def draw_episode_starts() -> None:
    """Draw the report's Figures 1 and 2: 10, 100 and 800 agents in a warehouse, 100 in a city; and its problem."""
    settings: list[dict[str, Any]] = [{"map": WAREHOUSE, "num_agents": num_agents} for num_agents in (10, 100, 800)]
    settings += [{"map": "Paris_1_256", "num_agents": 100}, {"scenario": "warehouse_small_10"}]
    for keywords in settings:
        env = mapf_pz.parallel_env(**keywords, render_mode="rgb_array")
        env.reset(seed=0)
        picture = env.render()
        assert isinstance(picture, np.ndarray)
        save_png(picture, IMAGES / f"{'-'.join(map(str, keywords.values()))}.png")


def draw_observation() -> None:
    """Draw the map with the view of one agent, and the planes of its observation."""
    env = mapf_pz.parallel_env(
        source=RandomObstacles(12, 12, 0.15, 8),
        channels=("view", "goal", "orientation", "edge_weights", "cost_to_go"),
        edge_weights="crisscross",
        view_size=(7, 7),
        view="centered",
        render_mode="rgb_array",
    )
    observations, agent = _reset_to_informative_view(env)
    figure = Figure(figsize=(12, 4.6), layout="constrained")
    left, right = np.ravel(np.array(figure.subfigures(1, 2, width_ratios=(1, 1.7))))
    _draw_map(left.subplots(), env, agent)
    axes = right.subplots(2, 4).flat
    for axis, plane, title in zip(axes, observations[f"agent_{agent}"], PLANES, strict=True):
        axis.imshow(plane, vmin=-1, vmax=1, cmap="RdBu_r")
        axis.set_title(title, fontsize=10)
        axis.set(xticks=[], yticks=[])
    figure.savefig(IMAGES / "observation.png", dpi=110)


def _reset_to_informative_view(env: MapfEnv) -> tuple[dict[str, np.ndarray], int]:
    """Reset until an agent observes its goal and at least three others; return the observations and the agent."""
    for seed in range(10_000):
        observations: dict[str, np.ndarray] = env.reset(seed=seed)[0]  # pyright: ignore[reportAssignmentType]
        for agent in range(env.max_num_agents):
            image = observations[f"agent_{agent}"]
            inside = (env.positions[agent] >= 3).all() and (env.positions[agent] <= 8).all()
            if inside and image[1].any() and (image[0] == 0.5).sum() >= 3:
                return observations, agent
    raise RuntimeError("no agent observes its goal and three others")


def _draw_map(axis: Axes, env: MapfEnv, agent: int) -> None:
    picture = env.render()
    assert isinstance(picture, np.ndarray)
    scale = picture.shape[0] / env.grid.shape[0]
    row, col = env.positions[agent]
    axis.imshow(picture)
    corner = ((col - 3) * scale, (row - 3) * scale)
    for color, width in (("black", 4), ("white", 2)):
        axis.add_patch(Rectangle(corner, 7 * scale, 7 * scale, fill=False, edgecolor=color, linewidth=width))
    axis.set(xticks=[], yticks=[])
    axis.set_title("the map, and one agent's view", fontsize=10)


if __name__ == "__main__":
    IMAGES.mkdir(exist_ok=True)
    animate_episode()
    draw_episode_starts()
    draw_observation()
