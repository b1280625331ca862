"""A recording for tests: three agents on a small map."""

import numpy as np

from mapf_pz.render import Recording

FREE = np.array([[True, True, True, True], [True, False, True, True], [True, True, True, True]])
# Agent 0 turns and moves to its goal, agent 1 is blocked and disappears, agent 2 gets another goal.
POSITIONS = np.array(
    [
        [[0, 0], [2, 0], [1, 3]],
        [[0, 0], [2, 0], [1, 2]],
        [[0, 1], [2, 1], [1, 2]],
        [[0, 2], [2, 2], [1, 2]],
    ]
)
GOALS = np.array(
    [
        [[0, 2], [2, 2], [1, 2]],
        [[0, 2], [2, 2], [2, 3]],
        [[0, 2], [2, 2], [2, 3]],
        [[0, 2], [2, 2], [2, 3]],
    ]
)
HEADINGS = np.array([[3, 0, 2], [0, 0, 2], [0, 0, 1], [0, 0, 0]])
ACTIVE = np.array([[True, True, True], [True, True, True], [True, True, True], [True, False, True]])
BLOCKED = np.array([[False, False, False], [False, True, False], [False, False, False], [False, False, False]])
DELAYED = np.array([[False, False, False], [False, False, False], [False, False, True], [False, False, False]])
WAITS_FOR = np.array([[-1, -1, -1], [-1, 2, -1], [2, 0, -1], [-1, -1, -1]])
OBSERVED = np.zeros((4, 2, 2, 1, 3), np.int8)
OBSERVED[1, 0, 1] = [-127, 0, 127]
WEIGHTS = np.ones((4, 3, 4), np.float32)
WEIGHTS[0, 0] = 0.5
RECORDING = Recording(
    FREE,
    POSITIONS,
    GOALS,
    HEADINGS,
    ACTIVE,
    BLOCKED,
    WEIGHTS,
    OBSERVED,
    ("view", "goal"),
    "a <b>title</b>",
    {"who": "me"},
    view="centered",
    frame="map",
)
