"""Untrusted JSON files: parse an object and its members, with one-line errors."""

from __future__ import annotations

import json
import os
from pathlib import Path
from reprlib import repr as shortened
from typing import Any, TypeGuard

from mapf_pz.errors import FormatError

MAX_LISTS = 4_000_000
"""Maximum number of lists and objects in a file: an empty list takes about thirty times the memory of its text."""
MAX_NUMBER = 2**30
"""Maximum of whole numbers."""
MAX_NAME = 1000
"""Maximum number of characters of a name."""

JsonObject = dict[str, Any]


def parse_object(text: str, origin: str | Path) -> JsonObject:
    """Parse the text of a JSON file; raises `FormatError` with the name `origin` unless it holds an object."""
    data = parse_json(text, origin)
    if not isinstance(data, dict):
        raise FormatError(origin, f"expected a JSON object, got {shortened(data)}", 1)
    return data


def parse_json(text: str, origin: str | Path) -> Any:
    """Parse the text of a JSON file; raises `FormatError` with the name `origin` if it is malformed or too large."""
    if text.count("[") + text.count("{") > MAX_LISTS:
        raise FormatError(origin, f"expected at most {MAX_LISTS} lists and objects")
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        raise FormatError(origin, f"expected JSON: {error.msg}", error.lineno, error.colno) from None
    except RecursionError:
        raise FormatError(origin, "expected JSON that is not nested deeply") from None
    except ValueError:
        raise FormatError(origin, "expected JSON, got a number with thousands of digits") from None


def whole_number(data: JsonObject, name: str, origin: str | Path, least: int = 0) -> int:
    """Return the member `name`; raises `FormatError` unless it is a whole number from `least` to `MAX_NUMBER`."""
    value = data.get(name)
    if not is_whole(value) or not least <= value <= MAX_NUMBER:
        raise FormatError(origin, f"expected {name!r} to be a whole number, {least} or more, got {shortened(value)}")
    return value


def text_member(data: JsonObject, name: str, origin: str | Path) -> str:
    """Return the member `name`; raises `FormatError` unless it is text."""
    value = data.get(name)
    if not isinstance(value, str):
        raise FormatError(origin, f"expected {name!r} to be text, got {shortened(value)}")
    return value


def list_member(data: JsonObject, name: str, origin: str | Path, least: int = 0) -> list[Any]:
    """Return the member `name`; raises `FormatError` unless it is a list of at least `least` items."""
    value = data.get(name)
    if not isinstance(value, list):
        raise FormatError(origin, f"expected {name!r} to be a list, got {shortened(value)}")
    if len(value) < least:
        raise FormatError(origin, f"expected {least} items in {name!r}, got {len(value)}")
    return value


def is_whole(value: Any) -> TypeGuard[int]:
    """Return whether a JSON value is a whole number; true and false are not, although Python treats them as such."""
    return isinstance(value, int) and not isinstance(value, bool)


def are_whole(values: Any) -> TypeGuard[list[int]]:
    """Return whether a JSON value is a list of whole numbers from 0 to `MAX_NUMBER`."""
    return isinstance(values, list) and all(is_whole(value) and 0 <= value <= MAX_NUMBER for value in values)


def named_file(file: str, name: str, folder: Path, origin: str | Path) -> Path:
    """Return the path of the `file` in the member `name`; raises `FormatError` if it is outside the JSON's folder."""
    is_name = file.isprintable() and len(file) <= MAX_NAME
    # Resolve symbolic links, which could lead out of the folder.
    if not is_name or not Path(os.path.realpath(folder / file)).is_relative_to(os.path.realpath(folder)):
        raise FormatError(origin, f"expected {name!r} to be a file in the folder of the JSON, got {shortened(file)}")
    return folder / file
