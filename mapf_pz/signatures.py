"""Signatures of functions whose keywords are the fields of a configuration: for editors, `help()`, type checkers."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar, cast

Fields = ParamSpec("Fields")
Result = TypeVar("Result")


def with_fields_of(config: Callable[Fields, object]) -> Callable[[Callable[..., Result]], Callable[Fields, Result]]:
    """Give a function of `**keywords` the signature of `config`, so that no field is declared twice."""

    def decorate(function: Callable[..., Result]) -> Callable[Fields, Result]:
        shown: Any = function
        shown.__signature__ = inspect.signature(config).replace(
            return_annotation=inspect.signature(function).return_annotation
        )
        return cast("Callable[Fields, Result]", function)

    return decorate
