"""Validation of configuration fields; errors name the field, the value and the allowed values."""

from __future__ import annotations

import math
from typing import Literal, get_args, get_origin, get_type_hints


def check_names(config: object) -> None:
    """Raise `ValueError` unless every `Literal` field has one of its allowed values."""
    for name, kind in get_type_hints(type(config)).items():
        if get_origin(kind) is Literal and getattr(config, name) not in get_args(kind):
            allowed = ", ".join(map(repr, get_args(kind)))
            raise ValueError(f"{name}={getattr(config, name)!r}: expected one of {allowed}")


def check_part(field: str, value: object, known: tuple[str, ...]) -> None:
    """Raise `ValueError` unless `value` is one of the `known` names or has the form `package.module:name`."""
    if value not in known and not (isinstance(value, str) and ":" in value):
        raise ValueError(f"{field}={value!r}: expected one of {', '.join(map(repr, known))}, or package.module:name")


def check_counts(config: object, least: int, *names: str) -> None:
    """Raise `ValueError` unless these fields are whole numbers, or tuples of them, of at least `least`."""
    for name in names:
        value = getattr(config, name)
        numbers = value if isinstance(value, tuple) else (value,)
        if not all(isinstance(number, int) and number >= least for number in numbers):
            expected = "whole numbers, each" if isinstance(value, tuple) else "a whole number,"
            raise ValueError(f"{name}={value!r}: expected {expected} {least} or more")


def check_positive(config: object, most: float, *names: str) -> None:
    """Raise `ValueError` unless these fields are greater than 0, at most `most`, and finite."""
    for name in names:
        value = getattr(config, name)
        if not 0 < value <= most or math.isinf(value):
            raise ValueError(f"{name}={value!r}: expected a number greater than 0{_bound(most)}")


def check_from_zero(config: object, most: float, *names: str) -> None:
    """Raise `ValueError` unless these fields are 0 or greater, at most `most`, and finite."""
    for name in names:
        value = getattr(config, name)
        if not 0 <= value <= most or math.isinf(value):
            raise ValueError(f"{name}={value!r}: expected a number, 0 or greater{_bound(most)}")


def _bound(most: float) -> str:
    return "" if math.isinf(most) else f", at most {most:g}"
