"""Planners by name, with options: `epibt:depth=5,time_limit=0.1`, or `package.module:Class:depth=5` of your own."""

from __future__ import annotations

import ast
import inspect
from collections.abc import Mapping
from typing import Any

from mapf_pz._internal.plugins import code_in, import_object, imported_object
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
    _, kind, options = planner_options(name)
    return kind(env, seed=seed, **options)


def planner_class(name: str) -> type[Planner] | None:
    """Return the class of a planner by its name, with or without options; None if the name is not a planner's.

    That of `package.module:Class` is found only if the module has been imported: names in files run no code.
    """
    if (planner := PLANNERS.get(name.partition(":")[0])) is not None:
        return planner
    code = own_code(name)
    kind = None if code is None else imported_object(code)
    return kind if isinstance(kind, type) and issubclass(kind, Planner) else None


def planner_options(name: str) -> tuple[str, type[Planner], dict[str, Any]]:
    """Return the planner's name without options, its class, and its options.

    Raises `ValueError` for an unknown name, an unknown option, and a value that is not a number or text as expected.
    """
    kind = planner_class(name)
    if kind is None:
        expected = f"expected one of {', '.join(PLANNERS)}, or package.module:Class of a module that is imported"
        raise ValueError(f"planner {split_options(name)[0]!r}: {expected}")
    planner, text = split_options(name)
    return planner, kind, parse_options(kind.__name__, default_options(kind), text)


def split_options(name: str) -> tuple[str, str]:
    """Return a planner's name without options, and the options as text: `epibt` and `depth=5` of `epibt:depth=5`."""
    planner = own_code(name) or name.partition(":")[0]
    return planner, name[len(planner) + 1 :]


def import_code(name: str) -> None:
    """Import the code of a user's planner or policy by its name; raises `ValueError` if there is none."""
    if (code := own_code(name)) is not None:
        import_object("policy", code)


def own_code(name: str) -> str | None:
    """Return `package.module:Class` of the name of a user's planner or policy; None for other names."""
    return None if name.partition(":")[0] in PLANNERS else code_in(name)


def default_options(kind: type) -> dict[str, Any]:
    """Return the options of a class of planners or policies, with their defaults: its arguments but `env` and `seed`.

    Raises `ValueError` for an argument without a default.
    """
    options: dict[str, Any] = {}
    for name, parameter in inspect.signature(kind).parameters.items():
        if name in ("env", "seed") or parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
            continue
        if parameter.default is parameter.empty:
            raise ValueError(f"{kind.__name__}: expected a default of its argument {name!r}")
        options[name] = parameter.default
    return options


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
