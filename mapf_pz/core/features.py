"""The features: numbers observed beside the image. Each declares its length, and has a kernel that writes it (the
`action_advantage`'s is `path.advantage`).

A feature's numbers stand in `values` (B * N, F) float32 in the agent's `row` from column `at` on; all are in [-1, 1].
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import prange

from mapf_pz.core.jit import jit, parallel_jit
from mapf_pz.core.path import advantage
from mapf_pz.core.state import Array, Distances, State, World
from mapf_pz.core.world import STEPS
from mapf_pz.types import Heading


@dataclass(frozen=True)
class Feature:
    """What one feature adds to the vector."""

    length: Callable[[int, int], int]
    """From the number of actions A and of remembered actions L to how many numbers it is."""
    needs_distances: bool = False


FEATURES: dict[str, Feature] = {
    "goal_vector": Feature(lambda _actions, _remembered: 4),
    "location": Feature(lambda _actions, _remembered: 6),
    "action_advantage": Feature(lambda actions, _remembered: actions, needs_distances=True),
    "last_actions": Feature(lambda actions, remembered: (actions + 1) * remembered),
    "time": Feature(lambda _actions, _remembered: 1),
}
"""All features by name, in the order that the constants below number them."""

GOAL_VECTOR, LOCATION, ACTION_ADVANTAGE, LAST_ACTIONS, TIME = range(5)
_NORTH = int(Heading.NORTH)


@jit
def write_goal_vector(height: int, width: int, agent: Array, up: int, values: Array, row: int, at: int) -> None:
    """Unit vector to the goal (up, right in the view), `log(1 + distance) / log(1 + H + W)`, and 1 on the goal.

    `up` is the direction that is up in the view.
    """
    down, right = STEPS[up]
    rows = agent.goal // width - agent.cell // width
    cols = agent.goal % width - agent.cell % width
    distance = np.sqrt(rows * rows + cols * cols)
    length = max(distance, 1.0)
    values[row, at] = (rows * down + cols * right) / length
    values[row, at + 1] = (rows * right - cols * down) / length
    values[row, at + 2] = np.log1p(distance) / np.log1p(height + width)
    values[row, at + 3] = 1.0 if distance == 0 else 0.0


@jit
def write_location(height: int, width: int, agent: Array, values: Array, row: int, at: int) -> None:
    """`row / H`, `col / W`, and the heading as one of four."""
    values[row, at] = agent.cell // width / height
    values[row, at + 1] = agent.cell % width / width
    for heading in range(4):
        values[row, at + 2 + heading] = 1.0 if agent.heading == heading else 0.0


@jit
def write_last_actions(history: Array, b: int, i: int, num_actions: int, values: Array, row: int, at: int) -> None:
    """The last L actions, newest first: each one of A, and 1 if the agent changed its cell."""
    for k in range(history.shape[2]):
        for action in range(num_actions):
            values[row, at + action] = 1.0 if history[b, i, k, 0] == action else 0.0
        values[row, at + num_actions] = history[b, i, k, 1]
        at += num_actions + 1


def _write_features(
    places: Array,
    cardinal: bool,
    egocentric: bool,
    max_steps: int,
    world: World,
    distances: Distances,
    state: State,
    values: Array,
) -> None:
    """Write all agents' features to `values` (B * N, F); agents that have disappeared observe zeros.

    `places` (number of features,) int32 tells where each feature's numbers begin; -1: it is not observed.
    """
    num_actions = 5 if cardinal else 4
    for b in prange(state.time.size):
        m, crew = state.map[b], state.agents[b]
        for i in range(crew.size):
            agent, row = crew[i], b * crew.size + i
            if not agent.was_active:
                values[row] = 0.0
                continue
            if places[GOAL_VECTOR] >= 0:
                up = agent.heading if egocentric else _NORTH
                write_goal_vector(world.height, world.width, agent, up, values, row, places[GOAL_VECTOR])
            if places[LOCATION] >= 0:
                write_location(world.height, world.width, agent, values, row, places[LOCATION])
            if places[ACTION_ADVANTAGE] >= 0:
                slot = distances.slot[m, agent.goal]
                for action in range(num_actions):
                    worth = advantage(world, m, distances.to_go, slot, cardinal, agent, action)
                    values[row, places[ACTION_ADVANTAGE] + action] = worth
            if places[LAST_ACTIONS] >= 0:
                write_last_actions(state.history, b, i, num_actions, values, row, places[LAST_ACTIONS])
            if places[TIME] >= 0:
                values[row, places[TIME]] = state.time[b] / max_steps


write_features = jit(_write_features)
write_features_in_parallel = parallel_jit(_write_features)
