"""Plan files: the League of Robot Runners' JSON, the MAPF tracker's CSV, and the text of the PIBT and LaCAM tools."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from reprlib import repr as shortened

from mapf_pz._internal.atomic import write_whole
from mapf_pz._internal.text import read_text
from mapf_pz.errors import FormatError
from mapf_pz.instances.instance import ActionModel, Instance
from mapf_pz.planners.plans.files.lorr import format_lorr, parse_lorr
from mapf_pz.planners.plans.files.planfile import PlanFile, PlanMetadata, Schedule, Selection
from mapf_pz.planners.plans.files.text import format_text, parse_text
from mapf_pz.planners.plans.files.tracker import format_tracker, parse_tracker
from mapf_pz.planners.plans.plan import Plan

__all__ = [
    "PlanFile",
    "PlanMetadata",
    "Schedule",
    "Selection",
    "check_format",
    "format_plan",
    "parse_plan",
    "read_plan",
    "write_plan",
]

PARSERS: dict[str, Callable[[str, str | Path, Selection], PlanFile]] = {
    r"\{": parse_lorr,
    r"\w+=|0:": parse_text,
    r".*\b(solution_plan|path)\b": parse_tracker,
}
"""The parsers, by a pattern of the start of their files; the first match is used."""

FORMATTERS: dict[str, Callable[[Plan, Instance, PlanMetadata], str]] = {
    ".json": format_lorr,
    ".csv": format_tracker,
    ".txt": format_text,
}
"""The functions that format a plan file, by file extension."""


def read_plan(path: str | Path, selection: Selection | None = None) -> PlanFile:
    """Read a plan file in any of the three formats, which is detected from the contents.

    Args:
        path: the file.
        selection: which plan to read. It is needed only for CSV files of the tracker, which hold several plans and no
            starts.

    Raises:
        FileNotFoundError: the file does not exist.
        FormatError: the file has none of these formats or is malformed, or not exactly one of its plans is selected.
    """
    return parse_plan(read_text(path), path, selection)


def parse_plan(text: str, origin: str | Path, selection: Selection | None = None) -> PlanFile:
    """Parse the text of a plan file; raises `FormatError` as `read_plan` does, with the name `origin`."""
    start = text.lstrip()[:1000]
    for pattern, parse in PARSERS.items():
        if re.match(pattern, start):
            return parse(text, origin, selection or Selection())
    expected = "expected a plan: League of Robot Runners JSON, tracker CSV, or text with a 'solution='"
    raise FormatError(origin, f"{expected}, got {shortened(text)}", 1)


def check_format(path: str | Path, action_model: ActionModel) -> None:
    """Raise `ValueError` unless a file of that name can hold plans with that action model."""
    extension = Path(path).suffix.lower()
    if extension not in FORMATTERS:
        raise ValueError(f"{path}: expected a file name that ends in {', '.join(FORMATTERS)}")
    if extension == ".csv" and action_model != "cardinal":
        raise ValueError(f"{path}: a tracker CSV file cannot hold headings, expected action_model='cardinal'")


def format_plan(plan: Plan, path: str | Path, instance: Instance, metadata: PlanMetadata | None = None) -> str:
    """Return the text of a plan file in the format of the extension; raises `ValueError` as `write_plan` does."""
    check_format(path, "cardinal" if plan.headings is None else "rotate")
    return FORMATTERS[Path(path).suffix.lower()](plan, instance, metadata or PlanMetadata())


def write_plan(plan: Plan, path: str | Path, instance: Instance, metadata: PlanMetadata | None = None) -> None:
    """Write a plan file, atomically: League of Robot Runners `.json`, tracker `.csv` (cardinal agents only), or `.txt`.

    Args:
        plan: the plan.
        path: the file.
        instance: the instance that the plan solves; lifelong instances can be written only as `.json`.
        metadata: metadata, which is written if the format has fields for it.

    Raises:
        ValueError: the file has another extension, or its format cannot hold the plan.
    """
    write_whole(Path(path), format_plan(plan, path, instance, metadata).encode())
