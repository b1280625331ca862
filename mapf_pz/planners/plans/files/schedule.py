"""The schedules in plan files of the League of Robot Runners, in the formats of 2023 and of 2024 and later."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path
from reprlib import repr as shortened
from typing import Any

import numpy as np

from mapf_pz._internal.arrays import Ints
from mapf_pz._internal.json import JsonObject, are_whole, list_member
from mapf_pz.errors import FormatError
from mapf_pz.planners.plans.files.planfile import Schedule

_ENTRY = re.compile(r"(\d{1,9}):(-?\d{1,9})(?:,|\Z)", re.ASCII)

_Assigned = tuple[tuple[int, int], ...]


def parse_schedule(data: JsonObject, num_agents: int, origin: str | Path) -> Schedule | None:
    """Return the schedule in a plan file's JSON object, or None if there is none or it is an empty list.

    Raises `FormatError` if it is malformed.
    """
    name = "events" if data.get("version") is None else "actualSchedule"
    if "tasks" not in data or data.get(name, []) == []:
        return None
    parse = {"events": _from_2023, "actualSchedule": _from_2024}[name]
    entries = list_member(data, name, origin, num_agents)[:num_agents]
    assigned = tuple(parse(entry, agent, origin) for agent, entry in enumerate(entries))
    tasks = dict(_task(task, origin) for task in list_member(data, "tasks", origin))
    return Schedule(assigned, tasks)


def _from_2024(entry: Any, agent: int, origin: str | Path) -> _Assigned:
    """Parse `1:28,19:38`: tasks 28 and 38, assigned at the ends of steps 1 and 19."""
    assigned: list[tuple[int, int]] = []
    position = 0
    while isinstance(entry, str) and position < len(entry):
        item = _ENTRY.match(entry, position)
        if item is None:
            break
        assigned.append((int(item[1]), int(item[2])))
        position = item.end()
    if not isinstance(entry, str) or position < len(entry):
        raise FormatError(
            origin, f"expected the schedule of agent {agent} to be 'step:task,...', got {shortened(entry)}"
        )
    return _in_order(assigned, agent, origin)


def _from_2023(entry: Any, agent: int, origin: str | Path) -> _Assigned:
    """Parse `[[0, 0, "assigned"], [0, 55, "finished"], ...]`: task, step after which it happens, and event."""
    assigned: list[tuple[int, int]] = []
    for event in entry if isinstance(entry, list) else [entry]:
        match event:
            case [task, step, "assigned"] if are_whole([task, step]):
                assigned.append((step + 1, task))
            case [task, step, "finished"] if are_whole([task, step]):
                pass
            case _:
                expected = f"expected events of agent {agent} to be [task, step, assigned or finished]"
                raise FormatError(origin, f"{expected}, got {shortened(event)}")
    return _in_order(assigned, agent, origin)


def _in_order(assigned: list[tuple[int, int]], agent: int, origin: str | Path) -> _Assigned:
    if any(later[0] < earlier[0] for earlier, later in pairwise(assigned)):
        raise FormatError(origin, f"expected the tasks of agent {agent} in chronological order")
    return tuple(assigned)


def _task(task: Any, origin: str | Path) -> tuple[int, Ints]:
    """Return the number and the errands (L, 2) of a task, `[task, row, col]` or `[task, step, [row, col, ...]]`."""
    match task:
        case [number, row, col] if are_whole([number, row, col]):
            return number, np.array([[row, col]])
        case [number, step, list(cells)] if are_whole([number, step]) and are_whole(cells) and cells:
            if len(cells) % 2 == 0:
                return number, np.array(cells).reshape(-1, 2)
        case _:
            pass
    raise FormatError(
        origin, f"expected a task [task, row, col] or [task, step, [row, col, ...]], got {shortened(task)}"
    )
