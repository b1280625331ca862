"""Configurations: frozen dataclasses whose fields pydantic checks, and the types of such fields."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from functools import wraps
from reprlib import repr as shortened
from typing import Annotated, Any, TypeVar

import numpy as np
from pydantic import (
    AfterValidator,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainValidator,
    TypeAdapter,
    ValidationError,
    WrapValidator,
)
from pydantic_core import ArgsKwargs

from mapf_pz._internal.signatures import document_fields
from mapf_pz._internal.suggest import expected_names

Config = TypeVar("Config", bound=type)
Item = TypeVar("Item")


def as_tuple(value: Any) -> Any:
    """Return a sequence as a tuple, and any other value as it is."""
    return tuple(value) if isinstance(value, Sequence) and not isinstance(value, str) else value


def _from_numpy(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value


Whole = Annotated[int, BeforeValidator(_from_numpy)]
"""A whole number, also one of NumPy."""
Count = Annotated[Whole, Field(ge=1)]
"""A whole number, 1 or more."""
Natural = Annotated[Whole, Field(ge=0)]
"""A whole number, 0 or more."""
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
"""A finite number greater than 0."""
Coefficient = Annotated[float, Field(ge=0, allow_inf_nan=False)]
"""A finite number, 0 or more."""
Share = Annotated[float, Field(ge=0, le=1)]
"""A number from 0 to 1."""
Items = Annotated[tuple[Item, ...], BeforeValidator(as_tuple)]
"""A tuple, or any other sequence, which becomes one."""


UNCHECKED = PlainValidator(lambda value: value)
"""What the type of a field is annotated with that is checked elsewhere."""


def expecting(text: str) -> WrapValidator:
    """Return what a field's type is annotated with to say what it expects, where it is a union of types."""

    def check(value: Any, handler: Callable[[Any], Any]) -> Any:
        try:
            return handler(value)
        except ValidationError:
            raise ValueError(f"expected {text}") from None

    return WrapValidator(check)


def name_or_part(names: Sequence[str]) -> AfterValidator:
    """Return what the type of a field is annotated with that is one of these names, or `package.module:name`."""

    def check(name: str) -> str:
        if name not in names and ":" not in name:
            raise ValueError(f"expected one of {', '.join(map(repr, names))}, or package.module:name")
        return name

    return AfterValidator(check)


_RULES = ConfigDict(strict=True, extra="forbid", arbitrary_types_allowed=True)
_EXPECTED = {
    "int_type": "a whole number",
    "float_type": "a number",
    "bool_type": "True or False",
    "string_type": "text",
    "callable_type": "a function",
    "tuple_type": "a tuple or list",
    "too_short": "{min_length} or more items",
    "literal_error": "one of {expected}",
    "greater_than": "{number} greater than {gt}",
    "greater_than_equal": "{number}, {ge} or more",
    "less_than": "less than {lt}",
    "less_than_equal": "at most {le}",
}
"""What is expected instead of a value, by pydantic's type of the error; otherwise, pydantic's text says it."""
ABSENT, UNKNOWN = "expected a value", "unknown field, which may be one of another version"
"""Complaints about a field that a file lacks, and about one that it should not have."""
_MISPLACED = {"missing": ABSENT, "extra_forbidden": UNKNOWN, "unexpected_keyword_argument": UNKNOWN}


def checked(config: Config) -> Config:
    """Let pydantic check the fields of a frozen dataclass by their types, without conversions, when one is made.

    It then raises `ValueError` in one line that names the field, the value, and what is expected; and `TypeError` for
    an unknown keyword, with what the class has in `HINTS` for it, or the closest known one. The docstrings below the
    fields become part of that of the class.
    """
    dataclass: Any = config
    dataclass.__pydantic_config__ = _RULES
    validator = TypeAdapter(config).validator
    signature = inspect.signature(config)

    @wraps(dataclass.__init__)
    def init(self: Any, *values: Any, **given: Any) -> None:
        for name in given:
            if name not in signature.parameters:
                hint = getattr(config, "HINTS", {}).get(name) or expected_names(name, signature.parameters)
                raise TypeError(f"unknown keyword {name!r}: {hint}")
        arguments = signature.bind(*values, **given).arguments
        try:
            validator.validate_python(ArgsKwargs((), arguments), self_instance=self)
        except ValidationError as error:
            raise _cause(error) or ValueError(complaint(error)) from None

    dataclass.__init__ = init
    document_fields(config, config)
    return config


def _cause(error: ValidationError) -> Exception | None:
    """Return the exception that the `__post_init__` of the configuration has raised, or None."""
    first = error.errors()[0]
    return None if first["loc"] else first.get("ctx", {}).get("error")


def complaint(error: ValidationError) -> str:
    """Return the first error in one line: the field, the value, and what is expected."""
    first = error.errors()[0]
    parts = (f"[{part}]" if isinstance(part, int) else f".{part}" for part in first["loc"])
    place, kind, value = "".join(parts).removeprefix("."), first["type"], first["input"]
    if kind in _MISPLACED:
        return f"{place}: {_MISPLACED[kind]}"
    context = first.get("ctx", {})
    if "error" not in context:
        number = "a whole number" if any(isinstance(bound, int) for bound in context.values()) else "a number"
        bounds = {name: f"{bound:g}" if isinstance(bound, float) else bound for name, bound in context.items()}
        known = _EXPECTED.get(kind, first["msg"].removeprefix("Input should be "))
        text = f"expected {known.format(number=number, **bounds)}".replace("' or '", "', '")
    elif isinstance(value, dict):
        return f"{place}: {context['error']}".removeprefix(": ")
    else:
        text = str(context["error"])
    return f"{place}={shown(value)}: {text}"


def shown(value: object) -> str:
    """Return a value for error messages: in one line, shortened."""
    return " ".join(shortened(value).split())
