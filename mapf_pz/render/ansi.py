"""Render an instance as text: one character per cell, as in a `.map` file, with the agents and their goals.

`@` obstacle, `.` free, `x` the goal of an agent that is elsewhere;
`>` `v` `<` `^` an agent that faces east, south, west, north, and `E` `S` `W` `N` the same at its goal;
`o` an agent without a heading, and `O` the same at its goal;
`z` an agent that was delayed in the last step, and `Z` the same at its goal.
"""

from __future__ import annotations

import numpy as np

from mapf_pz._internal.arrays import Bools, Ints

OBSTACLE, FREE, GOAL = "@", ".", "x"
BY_HEADING, BY_HEADING_AT_GOAL = ">v<^", "ESWN"
NO_HEADING, NO_HEADING_AT_GOAL = "o", "O"
DELAYED, DELAYED_AT_GOAL = "z", "Z"


def draw(
    free: Bools,
    positions: Ints,
    headings: Ints | None,
    goals: Ints,
    active: Bools | None = None,
    delayed: Bools | None = None,
) -> str:
    """Render the text.

    Args:
        free: (H, W), True for free cells.
        positions: (N, 2), [row, col].
        headings: (N,), or None for agents without headings.
        goals: (N, 2), [row, col].
        active: (N,); inactive agents and their goals are omitted. None: all agents are active.
        delayed: (N,), whether each agent was delayed in the last step. None: no agent was.

    Returns:
        H lines of W characters, each with a line ending.
    """
    text = np.where(free, FREE, OBSTACLE)
    shown = np.arange(len(positions)) if active is None else np.flatnonzero(active)
    text[goals[shown, 0], goals[shown, 1]] = GOAL
    for agent in shown:
        at_goal = np.array_equal(positions[agent], goals[agent])
        heading = None if headings is None else int(headings[agent])
        is_delayed = delayed is not None and bool(delayed[agent])
        text[tuple(positions[agent])] = _symbol(heading, at_goal, is_delayed)
    return "".join("".join(line) + "\n" for line in text)


def _symbol(heading: int | None, at_goal: bool, is_delayed: bool) -> str:
    if is_delayed:
        return DELAYED_AT_GOAL if at_goal else DELAYED
    if heading is None:
        return NO_HEADING_AT_GOAL if at_goal else NO_HEADING
    return (BY_HEADING_AT_GOAL if at_goal else BY_HEADING)[heading]
