"""The lowest sum of costs, by a search over the states of all agents together in plain Python."""

import heapq
from itertools import product

import numpy as np

STEPS = ((0, 1), (1, 0), (0, -1), (-1, 0))


def lowest_cost(instance, disappear=False):
    """Return the lowest sum of costs, or None if there is no solution.

    It is the least cost of a path in the graph of the states of all agents together, by Dijkstra's algorithm. An agent
    at its goal may end, and then stays there without cost; each other agent costs 1 in each step. An agent that never
    moves costs 1. With `disappear`, an agent that is at its goal after a step ends, and is gone from the next step on.
    """
    free = {tuple(cell) for cell in np.argwhere(instance.grid.free).tolist()}
    goals = [tuple(goal) for goal in instance.scenario.goals.tolist()]
    headings = [None] * len(goals) if instance.headings is None else instance.headings.tolist()
    starts = [tuple(start) for start in instance.scenario.starts.tolist()]

    def options(agent, state):
        """Yield the states of an agent after a step."""
        cell, heading, ended = state
        yield state
        if ended:
            return
        for turn in (1, 3) if heading is not None else ():
            yield cell, (heading + turn) % 4, False
        for direction in range(4) if heading is None else (heading,):
            after = cell[0] + STEPS[direction][0], cell[1] + STEPS[direction][1]
            if after in free:
                yield after, heading, False

    def endings(states):
        """Yield the states with any of the agents at their goals ended."""
        choices = [
            [state, (*state[:2], True)][disappear:] if state[0] == goal and not state[2] else [state]
            for state, goal in zip(states, goals, strict=True)
        ]
        yield from product(*choices)

    first = tuple((start, heading, False) for start, heading in zip(starts, headings, strict=True))
    beginnings = [first] if disappear else endings(first)
    queue = [(sum(ended for *_, ended in states), number, states) for number, states in enumerate(beginnings)]
    count, done = len(queue), set()
    while queue:
        cost, _, states = heapq.heappop(queue)
        if all(ended for *_, ended in states):
            return cost
        if states in done:
            continue
        done.add(states)
        cost += sum(not ended for *_, ended in states)
        for after in product(*(options(agent, state) for agent, state in enumerate(states))):
            moves = [
                (state[0], then[0]) for state, then in zip(states, after, strict=True) if not (disappear and state[2])
            ]
            cells = {end for _, end in moves}
            if len(cells) == len(moves) and not any((b, a) in moves for a, b in moves if a != b):
                for ended in endings(after):
                    count += 1
                    heapq.heappush(queue, (cost, count, ended))
    return None
