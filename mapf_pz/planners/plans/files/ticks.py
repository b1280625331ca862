"""Paths in files of the League of Robot Runners of 2026, in which an action takes several ticks.

An example of a path is `[(0,14,55,0,0):(C 10,F 10,W 27)][(100,14,55,0,0):(F 24)]`. Each segment has a head with its
first tick, a cell, a heading and a counter, followed by letters with their numbers of ticks. An action takes effect at
the end of its last tick; it may be interrupted by waits (`W`). The cell in a segment's head is ignored: in the example
file of PlanViz, all heads repeat the start. This interpretation was verified with that file: its replay is
collision-free, and all its 387 events happen at the given ticks.
"""

from __future__ import annotations

import re
from pathlib import Path

from mapf_pz.errors import FormatError
from mapf_pz.planners.plans.files.letters import TURNS, WAIT
from mapf_pz.planners.plans.files.planfile import check_size

_SEGMENT = re.compile(r"\[\((\d{1,9}),\d{1,9},\d{1,9},\d{1,9},\d{1,9}\):\(([^()\[\]]*)\)\]", re.ASCII)
_RUN = re.compile(rf"([{''.join(TURNS)}]) (\d{{1,9}})(?:,|\Z)", re.ASCII)


def expand_ticks(path: str, ticks_per_action: int, num_agents: int, agent: int, origin: str | Path) -> str:
    """Return a letter for each tick of an agent's path: that of an action in its last tick, otherwise a wait.

    Raises `FormatError` if the path is malformed, changes an action before its end, or exceeds the maximum size.
    """
    runs = _runs(path, agent, origin)
    check_size(sum(ticks for _, ticks in runs), num_agents, origin)
    words: list[str] = []
    counter, doing = 0, ""
    for letter, ticks in runs:
        word = [WAIT] * ticks
        if letter != WAIT:
            if counter and letter != doing:
                message = f"expected agent {agent} to finish the action {doing} before {letter}, at tick"
                raise FormatError(origin, f"{message} {sum(map(len, words))}")
            last = range(ticks_per_action - counter - 1, ticks, ticks_per_action)
            word[last.start :: ticks_per_action] = [letter] * len(last)
            counter, doing = (counter + ticks) % ticks_per_action, letter
        words.append("".join(word))
    return "".join(words)


def _runs(path: str, agent: int, origin: str | Path) -> list[tuple[str, int]]:
    """Return the letters with their numbers of ticks."""
    runs: list[tuple[str, int]] = []
    position = ticks = 0
    while position < len(path):
        segment = _SEGMENT.match(path, position)
        if segment is None or int(segment[1]) != ticks:
            expected = f"expected a segment '[({ticks},row,col,heading,counter):(F 10,...)]'"
            raise FormatError(origin, f"{expected} in the path of agent {agent}, character {position + 1}")
        position = segment.start(2)
        while position < segment.end(2):
            run = _RUN.match(path, position, segment.end(2))
            if run is None:
                message = f"expected a letter and ticks such as 'F 10' in the path of agent {agent}, character"
                raise FormatError(origin, f"{message} {position + 1}")
            runs.append((run[1], int(run[2])))
            ticks += int(run[2])
            position = run.end()
        position = segment.end()
    return runs
