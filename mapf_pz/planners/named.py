"""Planners by name, with options: `epibt:depth=5,time_limit=0.1`."""

from __future__ import annotations

import ast
import inspect
from collections.abc import Mapping
from typing import Any

from mapf_pz.environment.mapf_env import MapfEnv
from mapf_pz.planners.base import Planner
from mapf_pz.planners.cbs.planner import CBS
from mapf_pz.planners.epibt.planner import EPIBT
from mapf_pz.planners.lacam.planner import LaCAM
from mapf_pz.planners.pibt.planner import PIBT
from mapf_pz.planners.sipp.prioritized import PrioritizedSIPP
from mapf_pz.planners.windowed.planner import WindowedLNS

PLANNERS: dict[str, type[Planner]] = {
    "pibt": PIBT,
    "epibt": EPIBT,
    "windowed": WindowedLNS,
    "prioritized": PrioritizedSIPP,
    "lacam": LaCAM,
    "cbs": CBS,
}
"""The planners by name."""
MAX_OPTION = 2**30
"""Maximum absolute value of an option."""


def planner_of(name: str, seed: int = 0, env: MapfEnv | None = None) -> Planner:
    """Return the planner of this name with its options, such as `epibt:depth=5`.

    Raises `ValueError` for an unknown name, and for an unknown or invalid option.
    """
    planner, options = planner_options(name)
    return PLANNERS[planner](env, seed=seed, **options)


def planner_options(name: str) -> tuple[str, dict[str, Any]]:
    """Return the planner's name without options, and its options.

    Raises `ValueError` for an unknown name, an unknown option, and a value that is not a number or text as expected.
    """
    planner, _, options = name.partition(":")
    if planner not in PLANNERS:
        raise ValueError(f"planner {planner!r}: expected one of {', '.join(PLANNERS)}")
    return planner, parse_options(PLANNERS[planner].__name__, default_options(planner), options)


def default_options(planner: str) -> dict[str, Any]:
    """Return the options of a planner of `PLANNERS`, with their defaults."""
    parameters = inspect.signature(PLANNERS[planner]).parameters.values()
    return {parameter.name: parameter.default for parameter in parameters if parameter.name not in ("env", "seed")}


def parse_options(name: str, defaults: Mapping[str, Any], text: str) -> dict[str, Any]:
    """Parse `depth=5,time_limit=0.1` or `priority=elapsed`; raises `ValueError` for options not in `defaults`."""
    options: dict[str, Any] = {}
    for option in filter(None, text.split(",")):
        key, _, value = map(str.strip, option.partition("="))
        if key not in defaults:
            expected = f"the options {', '.join(defaults)}" if defaults else "no options"
            raise ValueError(f"option {option!r}: {name} has {expected}")
        if isinstance(defaults[key], str):
            options[key] = value
            continue
        try:
            options[key] = ast.literal_eval(value)
        except (SyntaxError, ValueError, RecursionError, MemoryError):
            options[key] = None
        if not isinstance(options[key], (int, float)):
            raise ValueError(f"option {option!r}: expected a number, True or False")
        if abs(options[key]) > MAX_OPTION:
            raise ValueError(f"option {option!r}: expected -{MAX_OPTION} to {MAX_OPTION}")
    return options
