"""An instance as text: one character a cell, as in a `.map` file, with the agents and their goals.

`@` obstacle, `.` free, `x` the goal of an agent who is elsewhere;
`>` `v` `<` `^` an agent that looks east, south, west, north, and `E` `S` `W` `N` the same on its own goal;
`o` an agent that looks nowhere, and `O` the same on its own goal.
"""

from __future__ import annotations

import numpy as np

from mapf_pz.arrays import Bools, Ints

OBSTACLE, FREE, GOAL = "@", ".", "x"
BY_HEADING, BY_HEADING_AT_GOAL = ">v<^", "ESWN"
NO_HEADING, NO_HEADING_AT_GOAL = "o", "O"


def draw(free: Bools, positions: Ints, headings: Ints | None, goals: Ints, active: Bools | None = None) -> str:
    """Draw one text.

    Args:
        free: (H, W), True where an agent can stand.
        positions: (N, 2), [row, col].
        headings: (N,), or None for agents that look nowhere.
        goals: (N, 2), [row, col].
        active: (N,); an agent that is not active is left out, with its goal. None: all are.

    Returns:
        H lines of W characters, each with its line end.
    """
    text = np.where(free, FREE, OBSTACLE)
    shown = np.arange(len(positions)) if active is None else np.flatnonzero(active)
    text[goals[shown, 0], goals[shown, 1]] = GOAL
    for agent in shown:
        at_goal = np.array_equal(positions[agent], goals[agent])
        text[tuple(positions[agent])] = _symbol(None if headings is None else int(headings[agent]), at_goal)
    return "".join("".join(line) + "\n" for line in text)


def _symbol(heading: int | None, at_goal: bool) -> str:
    if heading is None:
        return NO_HEADING_AT_GOAL if at_goal else NO_HEADING
    return (BY_HEADING_AT_GOAL if at_goal else BY_HEADING)[heading]
