"""Digests of values: what has the same content has the same digest, in every process and on every machine."""

from __future__ import annotations

import importlib.machinery
import re
import sys
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import partial
from hashlib import sha256
from pathlib import Path
from types import BuiltinFunctionType, FunctionType
from typing import Any

import numpy as np

LENGTH = 16
"""Number of hexadecimal digits of a digest."""
_PACKAGE = __name__.partition(".")[0]
_PART = re.compile(r"([^\W\d]\w*(?:\.\w+)*):\w+")
"""The name of a part that a user plugs in, `package.module:name`."""


class NoDigestError(TypeError):
    """The content of an object is not known."""


def digest(value: object) -> str:
    """Return the digest of a value's content.

    The value consists of arrays, numbers, text, paths (the content of the file), mappings, sequences, dataclasses,
    partial functions, and functions and classes of modules, whose files are included unless they belong to this
    package, as are those of names `package.module:name`. Any other object states what it is in an attribute
    `identity`, a `str`.

    Raises `NoDigestError` for other objects, such as lambdas.
    """
    found = sha256()
    for part in _parts(value):
        found.update(len(part).to_bytes(8, "little") + part)
    return found.hexdigest()[:LENGTH]


def _parts(value: Any) -> Iterator[bytes]:
    """Yield the content of a value."""
    if isinstance(value, Enum) or value is None or isinstance(value, (bool, int, float, bytes, np.generic)):
        yield f"{type(value).__name__} {value!r}".encode()
    elif isinstance(value, str):
        yield from _of_text(value)
    elif isinstance(value, np.ndarray):
        if value.dtype.hasobject:
            raise NoDigestError("array of objects")
        yield from (value.dtype.str.encode(), str(value.shape).encode(), value.tobytes())
    elif isinstance(value, Path):
        yield value.read_bytes() if value.is_file() else str(value).encode()
    elif isinstance(value, (FunctionType, BuiltinFunctionType, type)):
        yield from _of_definition(value)
    elif isinstance(getattr(value, "identity", None), str):
        yield from (b"identity", value.identity.encode())
    else:
        yield from _of_members(value)


def _of_members(value: Any) -> Iterator[bytes]:
    """Yield the content of an object that consists of others."""
    if isinstance(value, Mapping):
        kind, members = "mapping", [member for key in sorted(value, key=repr) for member in (key, value[key])]
    elif isinstance(value, (tuple, list)):
        kind, members = "sequence", list(value)
    elif isinstance(value, partial):
        kind, members = "partial", [value.func, value.args, value.keywords]
    elif is_dataclass(value):
        kind, members = "dataclass", [type(value), *(getattr(value, field.name) for field in fields(value))]
    else:
        raise NoDigestError(type(value).__name__)
    yield f"{kind} {len(members)}".encode()
    for member in members:
        yield from _parts(member)


def _of_text(text: str) -> Iterator[bytes]:
    yield b"text"
    yield text.encode()
    part = _PART.fullmatch(text)
    file = None if part is None else _module_file(part[1])
    if file is not None:
        yield file.read_bytes()


def _of_definition(defined: Any) -> Iterator[bytes]:
    """Yield the name of a function or class, and the file that defines it."""
    name, module = defined.__qualname__, str(defined.__module__)
    if "<" in name:
        raise NoDigestError(name)
    yield f"{module}:{name}".encode()
    if module.partition(".")[0] == _PACKAGE or module in sys.builtin_module_names:
        return
    file = getattr(sys.modules.get(module), "__file__", None)
    if file is None:
        raise NoDigestError(name)
    yield Path(file).read_bytes()


def _module_file(name: str) -> Path | None:
    """Return the file of a module, which is not imported; None if there is none."""
    spec, places, full_name = None, None, ""
    for part in name.split("."):
        full_name = f"{full_name}.{part}".removeprefix(".")
        spec = importlib.machinery.PathFinder.find_spec(full_name, places)
        if spec is None:
            return None
        places = spec.submodule_search_locations
    return None if spec is None or spec.origin is None else Path(spec.origin)
