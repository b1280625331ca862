"""All violations of the rules in a plan, as its page lists them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

import numpy as np

from mapf_pz.actions import HEADING_STEPS
from mapf_pz.arrays import Bools, Ints
from mapf_pz.instance import Instance
from mapf_pz.render.recording import RecordedViolation


def find_violations(instance: Instance, positions: Ints, headings: Ints | None) -> tuple[RecordedViolation, ...]:
    """Return all violations in chronological order: of the rules that `mapf_pz.planners.validate` checks.

    Args:
        instance: the instance. If its agents have several goals each, it does not matter where they end.
        positions: (T + 1, N, 2), [row, col] after each step.
        headings: (T + 1, N), or None for agents without headings.
    """
    found = [*_of_single_agents(instance, positions, headings), *_of_pairs(positions)]
    return tuple(sorted(found, key=lambda violation: (violation.step, violation.agents)))


def _of_single_agents(instance: Instance, positions: Ints, headings: Ints | None) -> Iterator[RecordedViolation]:
    wrong_start = (positions[0] != instance.scenario.starts).any(axis=1)
    moves = np.diff(positions, axis=0)
    far = np.abs(moves).sum(axis=2) > 1
    if headings is not None:
        if instance.headings is not None:
            wrong_start |= headings[0] != instance.headings
        moved = (moves != 0).any(axis=2)
        far |= moved & (moves != HEADING_STEPS[headings[:-1]]).any(axis=2)
        turns = np.diff(headings, axis=0) % 4
        yield from _marked(
            (turns == 2) | ((turns != 0) & moved), 1, positions, "more than a quarter turn, or a turn during a move"
        )
    yield from _marked(wrong_start[None], 0, positions, "not the instance's start")
    yield from _marked(~_are_free(instance.grid.free, positions), 0, positions, "an obstacle, or outside the map")
    yield from _marked(far, 1, positions, "not a move to an adjacent cell, or not straight ahead")
    if instance.scenario.goals.ndim == 2:
        wrong_end = (positions[-1] != instance.scenario.goals).any(axis=1)
        yield from _marked(wrong_end[None], len(positions) - 1, positions, "not the agent's goal")


def _marked(wrong: Bools, first_step: int, positions: Ints, rule: str) -> Iterator[RecordedViolation]:
    """Yield a violation for each True in `wrong` (steps, N), the first row of which is `first_step`."""
    for row, agent in np.argwhere(wrong).tolist():
        step = first_step + row
        yield _violation(step, (agent,), positions, rule)


def _of_pairs(positions: Ints) -> Iterator[RecordedViolation]:
    """Yield each agent that shares a cell with the first agent there, and each two agents that swap cells."""
    before: defaultdict[tuple[int, ...], list[int]] = defaultdict(list)
    for step, cells in enumerate(positions.tolist()):
        here: defaultdict[tuple[int, ...], list[int]] = defaultdict(list)
        for agent, cell in enumerate(map(tuple, cells)):
            here[cell].append(agent)
            if here[cell][0] != agent:
                yield _violation(step, (here[cell][0], agent), positions, "two agents on one cell")
            for other in before.get(cell, ()):
                came_from = positions[step - 1, agent].tolist()
                if other < agent and cells[other] == came_from != list(cell):
                    yield _violation(step, (other, agent), positions, "two agents swap cells")
        before = here


def _violation(step: int, agents: tuple[int, ...], positions: Ints, rule: str) -> RecordedViolation:
    who = " and ".join(f"agent {agent}" for agent in agents)
    cells = dict.fromkeys(tuple(positions[step, agent].tolist()) for agent in agents)
    where = " and ".join(f"[row {row}, col {col}]" for row, col in cells)
    return RecordedViolation(step, agents, f"step {step}: {who} at {where}: {rule}")


def _are_free(free: Bools, cells: Ints) -> Bools:
    """Return which of `cells` (..., 2) are free cells of the map `free` (H, W)."""
    inside: Bools = np.all((cells >= 0) & (cells < np.array(free.shape)), axis=-1)
    row, col = np.moveaxis(np.where(inside[..., None], cells, 0), -1, 0)
    return inside & free[row, col]
