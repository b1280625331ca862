"""The operations that EPIBT chooses from: sequences of actions without those that are never better."""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise, product
from typing import NamedTuple

import numpy as np

from mapf_pz.actions import HEADING_STEPS, Action, CardinalAction, Heading
from mapf_pz.planners.epibt.kernels import AHEAD, NONE, Operations


class Act(NamedTuple):
    """An action, as what it does."""

    number: int
    """In the environment."""
    turn: int = 0
    """Quarter turns to the right."""
    towards: int = NONE
    """The heading of a move, or `AHEAD`."""


FORWARD = Act(Action.FORWARD, towards=AHEAD)
RIGHT, LEFT = Act(Action.ROTATE_RIGHT, turn=1), Act(Action.ROTATE_LEFT, turn=3)
ROTATING = (FORWARD, RIGHT, LEFT, Act(Action.WAIT))
CARDINAL = (
    Act(CardinalAction.RIGHT, towards=Heading.EAST),
    Act(CardinalAction.DOWN, towards=Heading.SOUTH),
    Act(CardinalAction.LEFT, towards=Heading.WEST),
    Act(CardinalAction.UP, towards=Heading.NORTH),
    Act(CardinalAction.WAIT),
)
Word = tuple[Act, ...]


@lru_cache
def operations(depth: int, cardinal: bool) -> Operations:
    """Return all operations of `depth` actions, the most eager first.

    Of sequences that lead over the same cells to the same heading there is one. Agents that turn do so before a move,
    not both ways and not three times; an operation without a move may turn once or twice.
    """
    acts = CARDINAL if cardinal else ROTATING
    words: dict[object, Word] = {}
    for word in product(acts, repeat=depth):
        if _is_useful(word):
            words.setdefault(_trace(word), word)
    number = {trace: p for p, trace in enumerate(words)}
    nodes: dict[Word, int] = {(): 0}
    for word in words.values():
        for length in range(1, depth + 1):
            nodes.setdefault(word[:length], len(nodes))
    wait = acts[-1]
    last = [prefix[-1] if prefix else wait for prefix in nodes]
    return Operations(
        parent=np.array([nodes[prefix[:-1]] for prefix in nodes], np.int32),
        turn=np.array([act.turn for act in last], np.int32),
        towards=np.array([act.towards for act in last], np.int32),
        action=np.array([act.number for act in last], np.int64),
        nodes=np.array([[nodes[word[: t + 1]] for t in range(depth)] for word in words.values()], np.int32),
        rest=np.array([number[_trace((*word[1:], wait))] for word in words.values()], np.int32),
        waits=number[_trace((wait,) * depth)],
    )


def _is_useful(word: Word) -> bool:
    """Tell whether turns are followed by a move, unless there is none, and are not more than are needed."""
    moves = [t for t, act in enumerate(word) if act.towards != NONE]
    ends = [-1, *moves, len(word)]
    runs = [word[before + 1 : after] for before, after in pairwise(ends)]
    if moves and any(act.turn for act in runs[-1]):
        return False
    return all(
        (run.count(RIGHT) == 0 or run.count(LEFT) == 0) and sum(act.turn != 0 for act in run) < 3 for run in runs
    )


def _trace(word: Word) -> tuple[tuple[int, ...], ...]:
    """Return the places that a word leads over from [0, 0] and east, and the heading at its end."""
    row, col, heading = 0, 0, 0
    places: list[tuple[int, ...]] = []
    for act in word:
        heading = (heading + act.turn) % 4
        if act.towards != NONE:
            step = HEADING_STEPS[heading if act.towards == AHEAD else act.towards]
            row, col = row + int(step[0]), col + int(step[1])
        places.append((row, col))
    return (*places, (heading,))
