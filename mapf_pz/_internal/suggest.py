"""Names that users give: the entries that they mean, and suggestions for misspelled ones in error messages."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from typing import Any, TypeVar

Entry = TypeVar("Entry")


def entry_of(option: str, name: str, table: Mapping[Any, Entry]) -> Entry:
    """Return the entry of a table that an option names; raises `ValueError` for an unknown name."""
    if name not in table:
        raise ValueError(f"{option}={name!r}: expected one of {', '.join(map(repr, table))}")
    return table[name]


def expected_names(name: str, known: Iterable[str]) -> str:
    """Return what to expect instead of `name`: the closest of the known names if one is similar, otherwise all."""
    names = list(dict.fromkeys(known))
    return closest(name, names).rstrip() or f"expected one of {', '.join(names)}"


def closest(name: str, known: Iterable[str]) -> str:
    """Return a question for the known name that is most similar to `name`, followed by a space; empty if none is.

    Upper and lower case are the same.
    """
    names = {each.lower(): each for each in known}
    near = difflib.get_close_matches(name.lower(), names, n=1)
    return f"did you mean {names[near[0]]!r}? " if near else ""
