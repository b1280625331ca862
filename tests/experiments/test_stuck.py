"""Why agents do not reach their goals: `experiments/policies/stuck.py`."""

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("matplotlib")
from experiments.policies.stuck import WINDOW, Ending, causes
from mapf_pz.render import Inspection, Recording

STEPS = {1: (-1, 0), 2: (1, 0), 3: (0, -1), 4: (0, 1)}
NAMES = tuple(f"action_advantage {k + 1}" for k in range(5))


def lengths(free, goal):
    """Return the length of the shortest path from each cell to the goal."""
    found = np.full(free.shape, np.inf)
    found[tuple(goal)] = 0
    for _ in range(free.size):
        for row, col in np.argwhere(free):
            near = [(row + r, col + c) for r, c in STEPS.values()]
            inside = [cell for cell in near if 0 <= cell[0] < free.shape[0] and 0 <= cell[1] < free.shape[1]]
            found[row, col] = min(found[row, col], 1 + min(found[cell] for cell in inside))
    return found


def ending(rows, paths, goals):
    """Return the ending of an episode in which agents take these paths, whose last cell they keep."""
    free = np.array([[char == "." for char in row] for row in rows])
    num_steps = WINDOW + 10
    positions = np.array([[path[min(t, len(path) - 1)] for path in paths] for t in range(num_steps + 1)])
    tables = [lengths(free, goal) for goal in goals]
    costs = np.array([[table[tuple(cell)] for table, cell in zip(tables, cells, strict=True)] for cells in positions])
    features = -np.ones((num_steps, len(paths), 5), np.float32)
    for t, i in np.ndindex(num_steps, len(paths)):
        for action, step in STEPS.items():
            cell = tuple(positions[t, i] + step)
            if all(0 <= k < size for k, size in zip(cell, free.shape, strict=True)):
                features[t, i, action] = 0 if tables[i][cell] < costs[t, i] else -1
    inspection = Inspection(np.ones((*features.shape[:2], 5), np.bool_), features, NAMES)
    all_goals = np.broadcast_to(goals, positions.shape)
    return Ending(Recording(free, positions, all_goals, inspection=inspection), costs)


BACK_AND_FORTH = [(0, 0), (0, 1)] * 60
CASES = {
    "head-on": (["...."], [[(0, 1)], [(0, 2)]], [(0, 3), (0, 0)], ["head-on", "head-on"]),
    "a contested cell": (["....."], [[(0, 1)], [(0, 3)]], [(0, 4), (0, 0)], ["contested cell", "contested cell"]),
    "a queue": (["....."], [[(0, 0)], [(0, 1)]], [(0, 3), (0, 4)], ["behind others", "waits"]),
    "cut off": (["....."], [[(0, 0)], [(0, 1)]], [(0, 3), (0, 1)], ["cut off", ""]),
    "a way around": (["...", "...", ".@."], [[(0, 0)], [(0, 1)]], [(0, 2), (0, 1)], ["behind a goal", ""]),
    "late": (["." * 60], [[(0, k) for k in range(60)]], [(0, 59)], ["late"]),
    "displaced": (["...."], [BACK_AND_FORTH], [(0, 1)], ["displaced"]),
    "oscillates": (["...."], [BACK_AND_FORTH], [(0, 3)], ["oscillates"]),
    "at the goal": (["...."], [[(0, 0)]], [(0, 0)], [""]),
}


@pytest.mark.parametrize("name", CASES)
def test_the_cause(name):
    rows, paths, goals, expected = CASES[name]
    assert causes(ending(rows, paths, goals)) == expected


def test_an_episode_is_solved_if_all_are_at_their_goals():
    costs = np.array([[1.0, 0.0], [0.0, 0.0]])
    assert Ending(SimpleNamespace(), costs).solved
    assert not Ending(SimpleNamespace(), costs[:1]).solved
