"""Plan files of the League of Robot Runners, as its simulator writes and PlanViz reads them.

Files with the model `MAPF_T` (rotating agents) of 2023, 2024 and 2026 can be read, and files with the model `MAPF`. The
format of 2023 is written, and for a schedule that of 2024. In files of 2026, the steps of a plan are ticks: an agent is
on its old cell until the last tick of a move, so its size and its position between two cells are ignored.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from itertools import cycle
from pathlib import Path
from reprlib import repr as shortened
from typing import Any, NamedTuple

import numpy as np

from mapf_pz._internal.arrays import Ints
from mapf_pz._internal.json import (
    JsonObject,
    are_whole,
    is_whole,
    list_member,
    parse_object,
    whole_number,
)
from mapf_pz.errors import FormatError
from mapf_pz.instances.instance import Instance
from mapf_pz.planners.plans.files.letters import TURNS, Steps, follow_steps, follow_turns, format_steps, format_turns
from mapf_pz.planners.plans.files.planfile import PlanFile, PlanMetadata, Schedule, Selection, check_size
from mapf_pz.planners.plans.files.schedule import parse_schedule
from mapf_pz.planners.plans.files.ticks import expand_ticks
from mapf_pz.planners.plans.plan import Plan, reached

CARDINAL, ROTATING = "MAPF", "MAPF_T"
STEPS: Steps = {"U": (-1, 0), "D": (1, 0), "L": (0, -1), "R": (0, 1), "W": (0, 0)}
"""The (row, col) step of each letter of the model `MAPF`; `U` is a smaller row."""
LETTERS = {CARDINAL: "".join(STEPS), ROTATING: "".join(TURNS)}
"""The letters of each model."""
NAMES = {CARDINAL: ("N/A",), ROTATING: ("E", "S", "W", "N")}
"""The names of the headings, in order, in each model."""
CLAIMS = {"sumOfCost": "sum of costs", "makespan": "makespan", "numTaskFinished": "tasks finished"}

_Events = list[list[int | str]]


def parse_lorr(text: str, origin: str | Path, _: Selection) -> PlanFile:
    """Parse the text of a plan file; raises `FormatError` with the name `origin` if it is malformed."""
    data = parse_object(text, origin)
    model = data.get("actionModel")
    if not isinstance(model, str) or model not in LETTERS:
        raise FormatError(origin, f"expected 'actionModel' {' or '.join(LETTERS)}, got {shortened(model)}")
    count = whole_number(data, "teamSize", origin, least=1)
    starts = np.array(_starts(list_member(data, "start", origin, count)[:count], NAMES[model], origin))
    letters = _letters(data, count, model, origin)
    if model == ROTATING:
        plan = follow_turns(starts[:, :2], starts[:, 2], letters)
    else:
        plan = follow_steps(starts[:, :2], letters, STEPS)
    claims = {claim: data[key] for key, claim in CLAIMS.items() if is_whole(data.get(key))}
    schedule = parse_schedule(data, count, origin)
    goals = None
    if schedule is not None and claims.get("tasks finished") == count:
        goals = schedule.only_goals()
    return PlanFile(plan, goals, schedule, claims)


def format_lorr(plan: Plan, instance: Instance, metadata: PlanMetadata) -> str:
    """Return the text of a plan file.

    With a schedule, it has the format of 2024. Otherwise it has that of 2023, with one task for each agent, or with a
    task for each of its goals (lifelong).

    Raises `ValueError` if the plan has another number of agents than the instance, or if it has an impossible move or
    turn.
    """
    if plan.num_agents != instance.num_agents:
        raise ValueError(f"plan: {plan.num_agents} agents, but the instance has {instance.num_agents}")
    model = CARDINAL if plan.headings is None else ROTATING
    letters = format_steps(plan, STEPS) if plan.headings is None else format_turns(plan)
    facing = np.zeros(plan.num_agents, np.int64) if plan.headings is None else plan.headings[0]
    goals = instance.scenario.goals
    lifelong = goals.ndim == 3
    tasks = _single_tasks(plan, goals) if not lifelong else _lifelong_tasks(plan, goals)
    if metadata.schedule is not None:
        tasks = _scheduled_tasks(plan, metadata.schedule)
    paths = [",".join(agent_letters) for agent_letters in letters]
    record: JsonObject = {
        "actionModel": model,
        "AllValid": "Yes",
        "teamSize": plan.num_agents,
        "start": [
            [*cell, NAMES[model][h]] for cell, h in zip(plan.positions[0].tolist(), facing.tolist(), strict=True)
        ],
        "numTaskFinished": tasks.num_finished,
        "sumOfCost": plan.num_steps * plan.num_agents if lifelong else plan.sum_of_costs,
        "makespan": plan.num_steps if lifelong else plan.makespan,
        "actualPaths": paths,
        "plannerPaths": paths,
        "plannerTimes": [],
        "errors": [],
        **tasks.members,
    }
    members = [f"{json.dumps(key)}: {json.dumps(value)}" for key, value in record.items()]
    return "{\n" + ",\n".join(members) + "\n}\n"


def _starts(entries: Iterable[Any], names: tuple[str, ...], origin: str | Path) -> list[tuple[int, int, int]]:
    """Return (row, col, heading) of each agent."""
    starts: list[tuple[int, int, int]] = []
    for agent, start in enumerate(entries):
        match start:
            case [row, col, str(name)] if are_whole([row, col]) and name in names:
                starts.append((row, col, names.index(name)))
            case _:
                expected = f"expected the start of agent {agent} to be [row, col, {' or '.join(names)}]"
                raise FormatError(origin, f"{expected}, got {shortened(start)}")
    return starts


def _letters(data: JsonObject, count: int, model: str, origin: str | Path) -> list[str]:
    """Return the letters of each agent's steps or ticks."""
    paths = list_member(data, "actualPaths", origin, count)[:count]
    for agent, path in enumerate(paths):
        if not isinstance(path, str):
            raise FormatError(origin, f"expected the path of agent {agent} to be text, got {shortened(path)}")
    in_ticks = paths[0].startswith("[")
    if in_ticks and model != ROTATING:
        raise FormatError(origin, f"expected the model {ROTATING} for paths in ticks, got {model}")
    ticks = whole_number(data, "agentMaxCounter", origin, least=1) if in_ticks else 1
    letters: list[str] = []
    for agent, path in enumerate(paths):
        if in_ticks:
            letters.append(expand_ticks(path, ticks, count, agent, origin))
        else:
            letters.append(_plain_letters(path, LETTERS[model], agent, origin))
        if len(letters[agent]) != len(letters[0]):
            message = f"expected {len(letters[0])} steps for agent {agent}, as for agent 0, got {len(letters[agent])}"
            raise FormatError(origin, message)
    check_size(len(letters[0]), count, origin)
    return letters


def _plain_letters(path: str, letters: str, agent: int, origin: str | Path) -> str:
    # A regular expression would need a lot of memory for a long path.
    plain = path[::2]
    if set(plain) <= set(letters) and set(path[1::2]) <= {","} and not path.endswith(","):
        return plain
    steps = path.split(",")
    step = next(step for step, letter in enumerate(steps) if len(letter) != 1 or letter not in letters)
    message = f"expected one of {letters} as step {step + 1} of agent {agent}, got {shortened(steps[step])}"
    raise FormatError(origin, message)


class _Tasks(NamedTuple):
    """The tasks of a plan file."""

    num_finished: int
    members: JsonObject


def _tasks_of_2023(events: list[_Events], tasks: list[list[int]]) -> _Tasks:
    finished = sum(event[2] == "finished" for agent in events for event in agent)
    return _Tasks(finished, {"events": events, "tasks": tasks})


def _scheduled_tasks(plan: Plan, schedule: Schedule) -> _Tasks:
    """Return the members of the format of 2024, in which a task has several errands."""
    assigned = [",".join(f"{step}:{task}" for step, task in entries) for entries in schedule.assigned]
    members: JsonObject = {
        "version": "2024 LoRR",
        "actualSchedule": assigned,
        "plannerSchedule": assigned,
        "scheduleErrors": [],
        "events": [[visit.step, visit.agent, visit.task, visit.num_visited] for visit in schedule.visits(plan)],
        "tasks": [
            [number, schedule.revealed.get(number, 0), errands.reshape(-1).tolist()]
            for number, errands in schedule.tasks.items()
        ],
    }
    return _Tasks(schedule.finished(plan), members)


def _single_tasks(plan: Plan, goals: Ints) -> _Tasks:
    """Return the tasks and the events of agents with one goal each."""
    events: list[_Events] = []
    for agent, arrival in enumerate(plan.costs.tolist()):
        events.append([[agent, 0, "assigned"]])
        if (plan.positions[-1, agent] == goals[agent]).all():
            events[agent].append([agent, arrival, "finished"])
    return _tasks_of_2023(events, [[agent, *goal] for agent, goal in enumerate(goals.tolist())])


def _lifelong_tasks(plan: Plan, goals: Ints) -> _Tasks:
    """Return the tasks, numbered as assigned, and the events of agents that visit their goals (N, L, 2) in order."""
    tasks = [[agent, *goal] for agent, goal in enumerate(goals[:, 0].tolist())]
    events: list[_Events] = [[[agent, 0, "assigned"]] for agent in range(plan.num_agents)]
    arrivals = [
        (step, agent, taken)
        for agent in range(plan.num_agents)
        for taken, step in enumerate(reached(plan.positions[:, agent], cycle(goals[agent])), 1)
    ]
    for step, agent, taken in sorted(arrivals):
        events[agent].append([events[agent][-1][0], step, "finished"])
        events[agent].append([len(tasks), step, "assigned"])
        tasks.append([len(tasks), *goals[agent, taken % goals.shape[1]].tolist()])
    return _tasks_of_2023(events, tasks)
