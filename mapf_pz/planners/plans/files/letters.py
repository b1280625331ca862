"""Conversion between plans and strings of letters, one letter for each step of an agent."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from mapf_pz._internal.arrays import Bools, Ints
from mapf_pz.instances.heading import HEADING_STEPS
from mapf_pz.planners.plans.plan import Plan

FORWARD, RIGHT, LEFT, WAIT = "F", "R", "C", "W"
TURNS = {FORWARD: 0, RIGHT: 1, LEFT: 3, WAIT: 0}
"""The letters of rotating agents in the League of Robot Runners, and the quarter turns of each."""

Steps = Mapping[str, tuple[int, int]]
"""The (row, col) step of each letter, for cardinal agents."""


def follow_steps(starts: ArrayLike, letters: Sequence[str], steps: Steps) -> Plan:
    """Return the plan of cardinal agents from `starts` (N, 2); agents with fewer letters wait at the end."""
    moves = np.zeros((256, 2), np.int32)
    for letter, step in steps.items():
        moves[ord(letter)] = step
    positions = _staying(np.asarray(starts), letters)
    for agent, word in enumerate(letters):
        positions[1 : len(word) + 1, agent] += moves[_codes(word)].cumsum(axis=0, dtype=np.int32)
        positions[len(word) + 1 :, agent] = positions[len(word), agent]
    return Plan(positions)


def follow_turns(starts: ArrayLike, headings: ArrayLike, letters: Sequence[str]) -> Plan:
    """Return the plan of rotating agents from `starts` (N, 2) and `headings` (N,); all have equally many letters."""
    quarters = np.zeros(256, np.int64)
    for letter, quarter in TURNS.items():
        quarters[ord(letter)] = quarter
    positions = _staying(np.asarray(starts), letters)
    facing = np.empty(positions.shape[:2], np.int8)
    facing[0] = headings
    for agent, word in enumerate(letters):
        codes = _codes(word)
        facing[1:, agent] = (facing[0, agent] + quarters[codes].cumsum()) % 4
        moves = HEADING_STEPS[facing[:-1, agent]] * (codes == ord(FORWARD))[:, None]
        positions[1:, agent] += moves.cumsum(axis=0, dtype=np.int32)
    return Plan(positions, facing)


def format_steps(plan: Plan, steps: Steps) -> list[str]:
    """Return the letters of each cardinal agent; raises `ValueError` if one moves farther than one cell."""
    moves = np.diff(plan.positions, axis=0)
    return _format(plan, {letter: (moves == step).all(axis=2) for letter, step in steps.items()})


def format_turns(plan: Plan) -> list[str]:
    """Return the letters of each rotating agent; raises `ValueError` for any other move or turn."""
    if plan.headings is None:
        raise ValueError("plan: expected headings")
    moves = np.diff(plan.positions, axis=0)
    turns = np.diff(plan.headings, axis=0) % 4
    still = (moves == 0).all(axis=2)
    ahead = (moves == HEADING_STEPS[plan.headings[:-1]]).all(axis=2)
    masks = {FORWARD: ahead & (turns == 0), RIGHT: still & (turns == 1), LEFT: still & (turns == 3)}
    return _format(plan, masks | {WAIT: still & (turns == 0)})


def _staying(starts: Ints, letters: Sequence[str]) -> Ints:
    """Return positions (T + 1, N, 2) at which all agents stay at their starts."""
    num_steps = max(map(len, letters), default=0)
    return np.tile(starts.astype(np.int32), (num_steps + 1, 1, 1))


def _codes(word: str) -> Ints:
    return np.frombuffer(word.encode("ascii"), np.uint8)


def _format(plan: Plan, masks: Mapping[str, Bools]) -> list[str]:
    """Return the letters of each agent, given a mask (T, N) of the steps of each letter."""
    codes = np.zeros((plan.num_steps, plan.num_agents), np.uint8)
    for letter, mask in masks.items():
        codes[mask] = ord(letter)
    if not codes.all():
        step, agent = np.argwhere(codes == 0)[0].tolist()
        raise ValueError(f"plan: step {step + 1} of agent {agent} is not a valid step, so it cannot be written")
    return [codes[:, agent].tobytes().decode() for agent in range(plan.num_agents)]
