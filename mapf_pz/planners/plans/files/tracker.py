"""CSV files of the MAPF tracker: several plans on one map, one in each row, without starts.

A plan is a quoted field with a line of letters `u d l r w` for each agent, where `u` is a LARGER row. Waits at the end
are omitted.
Source: tracker.pathfinding.ai, and the examples in github.com/MAPF-Competition/PlanViz.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from reprlib import repr as shortened
from typing import NamedTuple

from mapf_pz.errors import FormatError
from mapf_pz.instances.instance import Instance
from mapf_pz.planners.plans.files.letters import follow_steps, format_steps
from mapf_pz.planners.plans.files.planfile import PlanFile, PlanMetadata, Selection, check_size, one_goal_each
from mapf_pz.planners.plans.plan import Plan

STEPS = {"u": (1, 0), "d": (-1, 0), "l": (0, -1), "r": (0, 1), "w": (0, 0)}
"""The (row, col) step of each letter."""
PLAN_COLUMNS = ("solution_plan", "path")
"""The names of the column of plans, in the two variants of the format."""
COLUMNS = ("map_name", "scen_type", "type_id", "agents", "lower_cost", "solution_cost", "solution_plan")
"""The columns that are written."""
MAX_ROWS, MAX_COLUMNS = 100_000, 100
"""Maximum numbers of rows and columns of a file."""

_FIELD = re.compile(r'(?:"([^"]*)"|([^",\r\n]*))(,|\r?\n|\Z)')
_SCENARIO = re.compile(r"(.+)-(even|random)-(\d+)")
_COUNT = re.compile(r"\d{1,9}", re.ASCII)


class _Field(NamedTuple):
    text: str
    line: int


_Row = dict[str, _Field]


def parse_tracker(text: str, origin: str | Path, selection: Selection) -> PlanFile:
    """Parse the text of a tracker CSV file, and return the selected plan.

    Raises `FormatError` with the name `origin` if not exactly one plan is selected, or if the file is malformed.
    """
    rows = list(_rows(text, origin))
    if selection.scenario is None:
        raise FormatError(origin, "expected a scenario to be given, as this file does not contain the starts")
    row = _selected(rows, selection, origin)
    column = next(name for name in PLAN_COLUMNS if name in row)
    plan, line = row[column]
    letters = plan.split("\n")
    count = int(row["agents"].text)
    if len(letters) != count:
        raise FormatError(origin, f"expected a line for each of {count} agents, got {len(letters)}", line)
    if count > len(selection.scenario):
        raise FormatError(origin, f"expected a scenario of {count} agents, got {len(selection.scenario)}", line)
    letters = [word.removesuffix("\r") for word in letters]
    for agent, word in enumerate(letters):
        if unknown := re.search("[^udlrw]", word):
            message = f"expected one of udlrw as step {unknown.start() + 1} of agent {agent}, got {unknown[0]!r}"
            raise FormatError(origin, message, line + agent)
    check_size(max(map(len, letters)), count, origin, line)
    plan = follow_steps(selection.scenario.starts[:count], letters, STEPS)
    return PlanFile(plan, claims=_claims(row, plan))


def format_tracker(plan: Plan, instance: Instance, metadata: PlanMetadata) -> str:
    """Return the text of a tracker CSV file for cardinal agents.

    Raises `ValueError` if agents have several goals each, or if the plan has an impossible move.
    """
    one_goal_each(instance.scenario.goals, "tracker CSV")
    if re.search(r'[",\r\n]', instance.grid.name):
        raise ValueError(f"map name {instance.grid.name!r}: a tracker CSV file cannot hold this name")
    named = _SCENARIO.fullmatch(metadata.scenario_name)
    kind, number = (named[2], named[3]) if named else ("", "")
    waits = re.compile("w+$")
    letters = "\n".join(waits.sub("", word) for word in format_steps(plan, STEPS))
    # In this format, an agent that never moves costs 0.
    at_goal = int((instance.scenario.starts == instance.scenario.goals).all(axis=1).sum())
    lower = "" if metadata.lower_bound is None else metadata.lower_bound - at_goal
    cost = plan.sum_of_costs - plan.num_unmoved
    row = (instance.grid.name, kind, number, plan.num_agents, lower, cost, f'"{letters}"')
    return f"{','.join(COLUMNS)}\n{','.join(map(str, row))}\n"


def _rows(text: str, origin: str | Path) -> Iterator[_Row]:
    """Yield the rows below the header: the fields by column name."""
    records = _records(text, origin)
    header = [field.text for field in next(records, [])]
    if "agents" not in header or not any(name in header for name in PLAN_COLUMNS):
        raise FormatError(origin, f"expected the columns agents and {' or '.join(PLAN_COLUMNS)}", 1)
    for number, fields in enumerate(records, 1):
        if number > MAX_ROWS:
            raise FormatError(origin, f"expected at most {MAX_ROWS} plans", fields[0].line)
        if len(fields) != len(header):
            raise FormatError(origin, f"expected {len(header)} fields, got {len(fields)}", fields[0].line)
        row = dict(zip(header, fields, strict=True))
        if not _COUNT.fullmatch(row["agents"].text):
            got = shortened(row["agents"].text)
            raise FormatError(origin, f"expected the number of agents, got {got}", row["agents"].line)
        yield row


def _records(text: str, origin: str | Path) -> Iterator[list[_Field]]:
    """Yield the records of a CSV text. The module `csv` limits the length of fields, by a process-wide setting."""
    position, line = 0, 1
    fields: list[_Field] = []
    while position < len(text):
        match = _FIELD.match(text, position)
        if match is None:
            raise FormatError(origin, "expected a quoted field, or a field without quotes in it", line)
        quoted, bare, end = match.groups()
        fields.append(_Field(bare if quoted is None else quoted, line))
        if len(fields) > MAX_COLUMNS:
            raise FormatError(origin, f"expected at most {MAX_COLUMNS} fields", line)
        line += match[0].count("\n")
        position = match.end()
        if end != ",":
            yield fields
            fields = []
    if fields:
        yield fields


def _selected(rows: list[_Row], selection: Selection, origin: str | Path) -> _Row:
    # Any other name, such as that of a generated scenario, does not restrict the selection.
    name = selection.name if _SCENARIO.fullmatch(selection.name) else ""
    found = [
        row
        for row in rows
        if selection.num_agents in (None, int(row["agents"].text)) and (not name or _name(row) in ("", name))
    ]
    if len(found) == 1:
        return found[0]
    wanted = "" if selection.num_agents is None else f" for {selection.num_agents} agents"
    wanted += f" of {name}" if name else ""
    there = ", ".join(" ".join(f"{_name(row)} {row['agents'].text}".split())[-80:] for row in (found or rows)[:5])
    raise FormatError(
        origin, f"expected one plan{wanted}, got {len(found)}: the file has plans for {there or 'no agents'}"
    )


def _name(row: _Row) -> str:
    """Return the name of a row's scenario, or an empty string if the file does not contain it."""
    parts = [row[name].text for name in ("map_name", "scen_type", "type_id") if name in row]
    return "-".join(parts) if len(parts) == 3 and all(parts) else ""


def _claims(row: _Row, plan: Plan) -> dict[str, int]:
    cost = row.get("solution_cost")
    if cost is None or not _COUNT.fullmatch(cost.text):
        return {}
    return {"sum of costs": int(cost.text) + plan.num_unmoved}
