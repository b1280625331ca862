"""Planners by name, with options."""

from __future__ import annotations

import ast
import inspect
from typing import Any

from mapf_pz.environment import MapfEnv
from mapf_pz.planners.base import Planner
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
}
"""The planners by name."""


def planner_of(name: str, seed: int = 0, env: MapfEnv | None = None) -> Planner:
    """Return the planner of this name with its options, such as `epibt:depth=5`.

    Raises `ValueError` for an unknown name, and for an unknown or invalid option.
    """
    planner, _, options = name.partition(":")
    if planner not in PLANNERS:
        raise ValueError(f"planner {planner!r}: expected one of {', '.join(PLANNERS)}")
    return PLANNERS[planner](env, seed=seed, **_options(PLANNERS[planner], options))


def _options(planner: type[Planner], text: str) -> dict[str, Any]:
    """Parse `depth=5,time_limit=0.1` or `priority=elapsed`; raises `ValueError` for options the planner lacks."""
    parameters = inspect.signature(planner).parameters
    allowed = [name for name in parameters if name not in ("env", "seed")]
    options: dict[str, Any] = {}
    for option in filter(None, text.split(",")):
        name, _, value = map(str.strip, option.partition("="))
        if name not in allowed:
            expected = f"the options {', '.join(allowed)}" if allowed else "no options"
            raise ValueError(f"option {option!r}: {planner.__name__} has {expected}")
        if isinstance(parameters[name].default, str):
            options[name] = value
            continue
        try:
            options[name] = ast.literal_eval(value)
        except (SyntaxError, ValueError, RecursionError, MemoryError):
            options[name] = None
        if not isinstance(options[name], (int, float)):
            raise ValueError(f"option {option!r}: expected a number, True or False")
    return options
