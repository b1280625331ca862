"""Draw the report's Figures 3 to 5, an agent's observation and the networks: `make -f experiments/Makefile figures`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch
from torch import Tensor, nn

import mapf_pz
from mapf_pz.rl.networks.actors import TeamValue, make_matrix_actor
from mapf_pz.rl.networks.observation_shape import ObservationShape
from mapf_pz.rl.presets import PRESETS

IMAGES = Path(__file__).parents[2] / "docs" / "images"
CHANNELS = ("view", "goal", "orientation", "edge weight, ahead", "... right", "... back", "... left")
CONFIG = PRESETS["report"]


def draw_observation() -> None:
    """Draw the front view of one agent, 5 x 5 cells, and the numbers in its seven channels, as in Figure 3."""
    env = mapf_pz.parallel_env(map="random-32-32-20", num_agents=60, edge_weights="random", render_mode="rgb_array")
    number, image = _telling_view(env)
    figure = Figure(figsize=(13, 5.2), layout="constrained")
    panels = figure.subplots(2, 4)
    _draw_surroundings(panels[0, 0], env, number)
    for panel, channel, title in zip(panels.flat[1:], image, CHANNELS, strict=True):
        panel.imshow(channel, vmin=-1, vmax=1, cmap="RdBu_r")
        for (row, col), value in np.ndenumerate(channel):
            color = "white" if abs(value) > 0.7 else "black"
            panel.text(col, row, f"{value:.2g}", ha="center", va="center", fontsize=8, color=color)
        panel.set(xticks=[], yticks=[], title=title)
    figure.savefig(IMAGES / "report-observation.png", dpi=90)


def _telling_view(env: mapf_pz.MapfEnv) -> tuple[int, np.ndarray]:
    """Reset until an agent observes its goal, another agent, and obstacles; return its number and observation."""
    for seed in range(10_000):
        observations = env.reset(seed=seed)[0]
        for number, image in enumerate(observations.values()):
            heading_up = env.headings[number] == mapf_pz.Heading.NORTH
            assert isinstance(image, np.ndarray)
            others = np.count_nonzero(image[2]) > 1
            if heading_up and image[1].any() and others and 0 < (image[3] < 0).sum() < 12 and _is_inside(env, number):
                return number, image
    raise RuntimeError("no such agent")


def _is_inside(env: mapf_pz.MapfEnv, number: int) -> bool:
    row, col = env.positions[number]
    return bool(row >= 4 and 2 <= col < env.grid.shape[1] - 2)


def _draw_surroundings(panel: Axes, env: mapf_pz.MapfEnv, number: int) -> None:
    """Show the part of the map that the agent, which looks up, observes."""
    picture = _picture(env)
    size = picture.shape[0] // env.grid.shape[0]
    row, col = env.positions[number]
    panel.imshow(picture[(row - 4) * size : (row + 1) * size, (col - 2) * size : (col + 3) * size])
    panel.set(xticks=[], yticks=[], title="its view on the map")


def _picture(env: mapf_pz.MapfEnv) -> np.ndarray:
    picture = env.render()
    assert isinstance(picture, np.ndarray)
    return picture


def draw_networks() -> None:
    """Draw the layers and the sizes of what is between them, as in Figures 4 and 5."""
    shape, num_agents = ObservationShape.of_task(CONFIG.task), CONFIG.task.num_agents
    networks = {
        "policy": make_matrix_actor(shape, num_agents, CONFIG.model),
        "value": TeamValue(shape, num_agents, "team", CONFIG.model),
    }
    image = torch.zeros(1, *shape.stacked(num_agents).image)
    figure = Figure(figsize=(14, 4), layout="constrained")
    for panel, (name, network) in zip(figure.subplots(2, 1), networks.items(), strict=True):
        _draw_boxes(panel, [f"observations\n{'x'.join(map(str, image.shape[1:]))}", *layers(network, image)])
        panel.set_title(name, loc="left")
    figure.savefig(IMAGES / "report-networks.png", dpi=90)


def layers(network: nn.Module, image: Tensor) -> Iterator[str]:
    """Yield what each layer of a network does to an observation, with the shape of its output."""
    seen: list[tuple[nn.Module, Tensor]] = []

    def record(layer: nn.Module, _: object, output: Tensor) -> None:
        seen.append((layer, output))

    for layer in network.modules():
        if isinstance(layer, (nn.Conv2d, nn.Linear)):
            layer.register_forward_hook(record)
    network(image)
    for layer, output in seen:
        shape = "x".join(map(str, output.shape[1:]))
        if isinstance(layer, nn.Conv2d):
            side, stride = layer.kernel_size[0], layer.stride[0]
            yield f"convolution\n{side}x{side}, stride {stride}\n{shape}"
        else:
            yield f"linear\n{shape}"


def _draw_boxes(panel: Axes, texts: Sequence[str]) -> None:
    for k, text in enumerate(texts):
        panel.add_patch(FancyBboxPatch((k, 0), 0.7, 1, boxstyle="round,pad=0.04", facecolor="#e8eef7", edgecolor="C0"))
        panel.text(k + 0.35, 0.5, text, ha="center", va="center", fontsize=10)
        if k:
            panel.annotate("", (k - 0.05, 0.5), (k - 0.25, 0.5), arrowprops={"arrowstyle": "->"})
    panel.set(xlim=(-0.1, len(texts) - 0.2), ylim=(-0.1, 1.1))
    panel.axis("off")


if __name__ == "__main__":
    draw_observation()
    draw_networks()
