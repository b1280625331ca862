"""Parts that users plug in: objects given directly, by a built-in name, or as `package.module:name`."""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from reprlib import repr as shortened
from typing import Any, TypeVar

from mapf_pz._internal.suggest import closest
from mapf_pz.errors import FormatError

Part = TypeVar("Part")
_CODE = re.compile(r"[^\W\d]\w*(\.[^\W\d]\w*)*:[^\W\d]\w*(?=[:+]|$)")
NAMED_PARTS = ("channels", "features", "reward", "source")
"""The fields of `EnvConfig` that may name code, as `package.module:name`."""


def resolve(field: str, given: object, known: Mapping[str, Part], kind: type[Part]) -> Part:
    """Return the part that a configuration's field names.

    Args:
        field: The field's name, for messages.
        given: An object of type `kind`, a name in `known`, or `package.module:name`.
        known: The built-in parts by name.
        kind: The type of parts.

    Raises:
        ValueError: `given` is none of these, or what is imported is not a `kind`.
    """
    if isinstance(given, kind):
        return given
    if not isinstance(given, str):
        raise ValueError(f"{field}: expected names or {kind.__name__} objects, got {given!r}")
    if ":" not in given:
        if given not in known:
            names = f"expected one of {', '.join(known)}, or package.module:name"
            raise ValueError(f"{field}: unknown {given!r}, {closest(given, known).rstrip() or names}")
        return known[given]
    part = import_object(field, given)
    if not isinstance(part, kind):
        raise ValueError(f"{field}={given!r}: expected a {kind.__name__}, got a {type(part).__name__}")
    return part


def import_object(field: str, path: str) -> Any:
    """Return the object at `package.module:name`; raises `ValueError` where there is none."""
    module, _, name = path.partition(":")
    try:
        return getattr(import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise ValueError(f"{field}={path!r}: {' '.join(str(error).split())}") from None


def code_in(name: str) -> str | None:
    """Return `package.module:name` at the start of a name that options may follow, after `:` or `+`; None without it.

    A name with options, such as `lacam:anytime=False`, has none.
    """
    match = _CODE.match(name)
    return match and match[0]


def imported_object(path: str) -> Any:
    """Return the object at `package.module:name` of a module that is imported already; None without it."""
    module, _, name = path.partition(":")
    return getattr(sys.modules.get(module), name, None)


def import_subclass(field: str, path: str, base: type[Part]) -> type[Part]:
    """Return the subclass of `base` at `package.module:Class`; raises `ValueError` if there is none."""
    part = import_object(field, path)
    if not isinstance(part, type) or not issubclass(part, base):
        raise ValueError(f"{field}={path!r}: expected a subclass of {base.__name__}, got {part!r}")
    return part


def check_trusted(origin: str | Path, named: Mapping[str, object], trust_remote_code: bool) -> None:
    """Raise `FormatError` if a file that is not trusted names code outside this package, which importing would run.

    Args:
        origin: The file.
        named: The fields that may name code, each a name or a sequence of names; other values are ignored.
        trust_remote_code: Whether the file is trusted.
    """
    for field, value in named.items():
        for name in value if isinstance(value, (list, tuple)) else (value,):
            if not trust_remote_code and isinstance(name, str) and _is_foreign(name):
                advice = "if you trust it, pass trust_remote_code=True, or --trust-remote-code"
                raise FormatError(origin, f"{field}={shortened(name)} names code that would run; {advice}")


def _is_foreign(name: str) -> bool:
    """Return whether a name has the form `package.module:name`, with another package than this one."""
    module, colon, _ = name.partition(":")
    return colon != "" and module.partition(".")[0] != "mapf_pz"
