"""The operations that EPIBT chooses from: sequences of actions, without the redundant ones."""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise, product
from typing import NamedTuple

import numpy as np

from mapf_pz.instances.heading import HEADING_STEPS, Heading
from mapf_pz.planners.epibt.state import AHEAD, NONE, Operations
from mapf_pz.simulator.actions import Action, CardinalAction


class Act(NamedTuple):
    """The effect of an action."""

    number: int
    """Number of the action in the environment."""
    turn: int = 0
    """Number of quarter turns to the right."""
    direction: int = NONE
    """Direction of a move, `AHEAD`, or `NONE`."""


FORWARD = Act(Action.FORWARD, direction=AHEAD)
RIGHT, LEFT = Act(Action.ROTATE_RIGHT, turn=1), Act(Action.ROTATE_LEFT, turn=3)
ROTATING = (FORWARD, RIGHT, LEFT, Act(Action.WAIT))
CARDINAL = (
    Act(CardinalAction.RIGHT, direction=Heading.EAST),
    Act(CardinalAction.DOWN, direction=Heading.SOUTH),
    Act(CardinalAction.LEFT, direction=Heading.WEST),
    Act(CardinalAction.UP, direction=Heading.NORTH),
    Act(CardinalAction.WAIT),
)
Sequence = tuple[Act, ...]


@lru_cache
def operations(depth: int, cardinal: bool, only_turning: bool = False) -> Operations:
    """Return all operations of `depth` actions, those that move earliest first.

    Sequences with the same cells and the same final heading count as one. Rotating agents turn only before a move,
    never in both directions and never three times; with `depth` below 3, too short to turn around and move, an
    operation without a move may turn. With `only_turning`, two operations are added that turn once and then wait.
    """
    acts = CARDINAL if cardinal else ROTATING
    useful = filter(_is_useful, product(acts, repeat=depth))
    sequences: dict[object, Sequence] = {}
    for sequence in sorted(useful, key=_lateness):
        sequences.setdefault(_trace(sequence), sequence)
    num_regular = len(sequences)
    if only_turning:
        for turn in (RIGHT, LEFT):
            sequences.setdefault(_trace((turn, *(acts[-1],) * (depth - 1))), (turn, *(acts[-1],) * (depth - 1)))
    number = {trace: p for p, trace in enumerate(sequences)}
    nodes: dict[Sequence, int] = {(): 0}
    for sequence in sequences.values():
        for length in range(1, depth + 1):
            nodes.setdefault(sequence[:length], len(nodes))
    wait = acts[-1]
    last = [prefix[-1] if prefix else wait for prefix in nodes]
    return Operations(
        parent=np.array([nodes[prefix[:-1]] for prefix in nodes], np.int32),
        turn=np.array([act.turn for act in last], np.int32),
        direction=np.array([act.direction for act in last], np.int32),
        action=np.array([act.number for act in last], np.int64),
        nodes=np.array([[nodes[sequence[: t + 1]] for t in range(depth)] for sequence in sequences.values()], np.int32),
        rest=np.array([number[_trace((*sequence[1:], wait))] for sequence in sequences.values()], np.int32),
        wait=number[_trace((wait,) * depth)],
        num_regular=num_regular,
    )


def _lateness(sequence: Sequence) -> tuple[int, int, int]:
    """Return the sort key of a sequence: actions that do not move count more at the start, and waits more than turns.

    Then come sequences that visit few cells twice, and those with few bends.
    """
    depth = len(sequence)
    still = sum(10 + (12 if act.turn else 13) * (depth - t) for t, act in enumerate(sequence) if act.direction == NONE)
    cells = [(0, 0), *_trace(sequence)[:-1]]
    again = sum(depth - t for t in range(depth) if cells[t + 1] in cells[: t + 1])
    bends = sum(one.direction != other.direction for one, other in pairwise(sequence))
    return still, again, bends


def _is_useful(sequence: Sequence) -> bool:
    """Return whether the sequence has no redundant turns, and none after its last move unless it is very short."""
    moves = [t for t, act in enumerate(sequence) if act.direction != NONE]
    ends = [-1, *moves, len(sequence)]
    runs = [sequence[before + 1 : after] for before, after in pairwise(ends)]
    if (moves or len(sequence) > 2) and any(act.turn for act in runs[-1]):
        return False
    return all(
        (run.count(RIGHT) == 0 or run.count(LEFT) == 0) and sum(act.turn != 0 for act in run) < 3 for run in runs
    )


def _trace(sequence: Sequence) -> tuple[tuple[int, ...], ...]:
    """Return the positions of a sequence that starts at [0, 0] and faces east, and its final heading."""
    row, col, heading = 0, 0, 0
    positions: list[tuple[int, ...]] = []
    for act in sequence:
        heading = (heading + act.turn) % 4
        if act.direction != NONE:
            step = HEADING_STEPS[heading if act.direction == AHEAD else act.direction]
            row, col = row + int(step[0]), col + int(step[1])
        positions.append((row, col))
    return (*positions, (heading,))
