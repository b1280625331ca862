"""The features: numbers observed besides the image. Each declares its length and the function that writes it.

A kernel writes one feature for all agents to `values` (B, N, F) float32, from column `at` on; numbers are in [-1, 1].
A user's feature is a `Feature` with such a function.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numba import prange

from mapf_pz._internal.arrays import Floats
from mapf_pz._internal.config import Count, checked, expecting
from mapf_pz._internal.jit import Array, BatchKernel
from mapf_pz._internal.plugins import resolve
from mapf_pz.instances.heading import Heading
from mapf_pz.simulator.kernels.cost_lookup import advantage, cost_at
from mapf_pz.simulator.kernels.observation.inputs import ObservationInputs
from mapf_pz.simulator.kernels.observation.symmetry import Symmetry, block_diagonal, one_of, unchanged
from mapf_pz.simulator.kernels.state import CostToGo
from mapf_pz.simulator.kernels.world import STEPS

_NORTH = int(Heading.NORTH)
POSE_UNIT = 2.0**-15
"""The feature `pose` counts rows and columns in this unit: float32 represents its multiples up to 1 exactly."""


@BatchKernel
def _write_goal_vector(height: int, width: int, agents: Array, egocentric: bool, values: Array, at: int) -> None:
    for b in prange(agents.shape[0]):
        for i in range(agents.shape[1]):
            agent = agents[b, i]
            down, right = STEPS[agent.heading if egocentric else _NORTH]
            rows, cols = agent.goal // width - agent.cell // width, agent.goal % width - agent.cell % width
            distance = np.sqrt(rows * rows + cols * cols)
            length = max(distance, 1.0)
            values[b, i, at] = (rows * down + cols * right) / length
            values[b, i, at + 1] = (rows * right - cols * down) / length
            values[b, i, at + 2] = np.log1p(distance) / np.log1p(height + width)
            values[b, i, at + 3] = 1.0 if distance == 0 else 0.0


def write_goal_vector(inputs: ObservationInputs, values: Array, at: int) -> None:
    """Unit vector to the goal (up, right in the view), `log(1 + distance) / log(1 + H + W)`, and 1 on the goal."""
    world, egocentric = inputs.world, inputs.view_shape.num_turns > 1
    _write_goal_vector(inputs.num_threads, world.height, world.width, inputs.state.agents, egocentric, values, at)


def _goal_vector_symmetry(symmetry: Symmetry, size: int) -> Floats:
    up_right = np.diag([-1, 1])  # of rows and columns
    return block_diagonal(up_right @ symmetry.in_view @ up_right, np.eye(2))


@BatchKernel
def _write_location(height: int, width: int, agents: Array, values: Array, at: int) -> None:
    for b in prange(agents.shape[0]):
        for i in range(agents.shape[1]):
            agent = agents[b, i]
            values[b, i, at] = agent.cell // width / height
            values[b, i, at + 1] = agent.cell % width / width
            for heading in range(4):
                values[b, i, at + 2 + heading] = 1.0 if agent.heading == heading else 0.0


def write_location(inputs: ObservationInputs, values: Array, at: int) -> None:
    """`row / H`, `col / W`, and the heading as one of four."""
    _write_location(inputs.num_threads, inputs.world.height, inputs.world.width, inputs.state.agents, values, at)


def _location_symmetry(symmetry: Symmetry, size: int) -> Floats:
    matrix = block_diagonal(symmetry.on_map, one_of(symmetry.headings))
    # One heading is 1; where no agent is observed, none is.
    matrix[:2, 2:] = (symmetry.origin / symmetry.new_shape)[:, None]
    return matrix


@BatchKernel
def _write_pose(width: int, agents: Array, egocentric: bool, unit: float, values: Array, at: int) -> None:
    for b in prange(agents.shape[0]):
        for i in range(agents.shape[1]):
            agent = agents[b, i]
            up = agent.heading if egocentric else _NORTH
            values[b, i, at] = agent.cell // width * unit
            values[b, i, at + 1] = agent.cell % width * unit
            for heading in range(4):
                values[b, i, at + 2 + heading] = 1.0 if up == heading else 0.0


def write_pose(inputs: ObservationInputs, values: Array, at: int) -> None:
    """`row / 32768`, `col / 32768`, and the direction that is up in the view, as one of four."""
    egocentric = inputs.view_shape.num_turns > 1
    _write_pose(inputs.num_threads, inputs.world.width, inputs.state.agents, egocentric, POSE_UNIT, values, at)


def _pose_symmetry(symmetry: Symmetry, size: int) -> Floats:
    matrix = block_diagonal(symmetry.on_map, one_of(symmetry.up))
    matrix[:2, 2:] = POSE_UNIT * symmetry.origin[:, None]
    return matrix


@BatchKernel
def _write_action_advantage(
    cardinal: bool,
    leads_to: Array,
    weight: Array,
    mean_weight: Array,
    packed: Array,
    exact: Array,
    least: Array,
    maps: Array,
    agents: Array,
    values: Array,
    at: int,
) -> None:
    to_go = CostToGo(packed, exact, least)
    for b in prange(agents.shape[0]):
        ways, costs, mean = leads_to[maps[b]], weight[maps[b]], mean_weight[maps[b]]
        for i in range(agents.shape[1]):
            agent = agents[b, i]
            own = cost_at(to_go, agent.table, agent.cell, agent.heading)
            for action in range(5 if cardinal else 4):
                values[b, i, at + action] = advantage(
                    ways, costs, mean, to_go, agent.table, own, cardinal, agent, action
                )


def write_action_advantage(inputs: ObservationInputs, values: Array, at: int) -> None:
    """For each action how much it costs more than the best one, from 0 (nothing) to -1: see `cost_lookup.advantage`."""
    world, maps, agents = inputs.world, inputs.state.map, inputs.state.agents
    graph = (world.leads_to, world.weight, world.mean_weight)
    _write_action_advantage(
        inputs.num_threads, inputs.cardinal, *graph, *inputs.distances[1:], maps, agents, values, at
    )


def _action_symmetry(symmetry: Symmetry, size: int) -> Floats:
    return one_of(symmetry.actions)


@BatchKernel
def _write_last_actions(num_actions: int, history: Array, values: Array, at: int) -> None:
    for b in prange(history.shape[0]):
        for i in range(history.shape[1]):
            for k in range(history.shape[2]):
                begin = at + k * (num_actions + 1)
                for action in range(num_actions):
                    values[b, i, begin + action] = 1.0 if history[b, i, k, 0] == action else 0.0
                values[b, i, begin + num_actions] = history[b, i, k, 1]


def write_last_actions(inputs: ObservationInputs, values: Array, at: int) -> None:
    """The last L actions, newest first: each one of A, and 1 if the agent changed its cell."""
    _write_last_actions(inputs.num_threads, 5 if inputs.cardinal else 4, inputs.state.history, values, at)


def _last_actions_symmetry(symmetry: Symmetry, size: int) -> Floats:
    last = block_diagonal(one_of(symmetry.actions), np.eye(1))
    return block_diagonal(*[last] * (size // len(last)))


def write_time(inputs: ObservationInputs, values: Array, at: int) -> None:
    """Steps taken over `max_steps`."""
    values[:, :, at] = (inputs.state.time / inputs.max_steps)[:, None]


def write_delayed(inputs: ObservationInputs, values: Array, at: int) -> None:
    """1 if the agent was delayed in the last step."""
    values[:, :, at] = inputs.delayed


def write_remaining_delay(inputs: ObservationInputs, values: Array, at: int) -> None:
    """Steps in which the agent is still delayed, over the largest number of a delay; 0 without delays."""
    values[:, :, at] = inputs.state.agents["delay"] / max(inputs.longest_delay, 1)


LengthOf = Callable[[int, int], int]
"""A function that returns a length for A actions and `num_last_actions`."""


@checked
@dataclass(frozen=True)
class Feature:
    """One feature."""

    write: Callable[[ObservationInputs, Array, int], None]
    """`write(inputs, values, at)` writes to all agents' `values` (B, N, F) float32 from column `at` on, in [-1, 1]."""
    length: Annotated[Count | LengthOf, expecting("a whole number, 1 or more, or a function")] = 1
    """How many numbers it is, or a function that returns it for A actions and `num_last_actions`."""
    needs_cost_to_go: bool = False
    """Whether `write` reads the cost to go, which is then computed before; without it, reading is an error."""
    symmetry: Callable[[Symmetry, int], Floats] | None = None
    """`symmetry(symmetry, size)` returns the matrix (size, size) by which its numbers are multiplied in a state that is
    turned or mirrored, for `augment`; `unchanged` is that of numbers that stay. None: it is not known."""

    def size(self, num_actions: int, num_last_actions: int) -> int:
        """Return how many numbers it is in an environment."""
        return self.length if isinstance(self.length, int) else self.length(num_actions, num_last_actions)


def _each_action(num_actions: int, _num_last_actions: int) -> int:
    return num_actions


def _each_last_action(num_actions: int, num_last_actions: int) -> int:
    return (num_actions + 1) * num_last_actions


FEATURES: dict[str, Feature] = {
    "goal_vector": Feature(write_goal_vector, 4, symmetry=_goal_vector_symmetry),
    "location": Feature(write_location, 6, symmetry=_location_symmetry),
    "pose": Feature(write_pose, 6, symmetry=_pose_symmetry),
    "action_advantage": Feature(write_action_advantage, _each_action, needs_cost_to_go=True, symmetry=_action_symmetry),
    "last_actions": Feature(write_last_actions, _each_last_action, symmetry=_last_actions_symmetry),
    "time": Feature(write_time, symmetry=unchanged),
    "delayed": Feature(write_delayed, symmetry=unchanged),
    "remaining_delay": Feature(write_remaining_delay, symmetry=unchanged),
}
"""The built-in features by name."""


def feature_of(feature: str | Feature) -> Feature:
    """Return a feature that is given by name, as `package.module:name`, or as an object; raises `ValueError`."""
    return resolve("features", feature, FEATURES, Feature)
