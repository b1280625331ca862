"""Signatures of functions whose keywords are the fields of a configuration: for editors, `help()`, type checkers."""

from __future__ import annotations

import ast
import inspect
from collections.abc import Callable
from itertools import pairwise
from textwrap import dedent, indent
from typing import Any, Concatenate, ParamSpec, TypeVar, cast

Fields = ParamSpec("Fields")
Result = TypeVar("Result")


def with_fields_of(config: Callable[Fields, object]) -> Callable[[Callable[..., Result]], Callable[Fields, Result]]:
    """Give a function of `**keywords` the signature and the documentation of the dataclass `config`.

    So no field is declared or documented twice.
    """

    def decorate(function: Callable[..., Result]) -> Callable[Fields, Result]:
        _show_fields(function, config, [])
        return cast("Callable[Fields, Result]", function)

    return decorate


def init_with_fields_of(
    config: Callable[Fields, object],
) -> Callable[[Callable[..., None]], Callable[Concatenate[Any, Fields], None]]:
    """Give a method `__init__` the signature and the documentation of the dataclass `config`."""

    def decorate(method: Callable[..., None]) -> Callable[Concatenate[Any, Fields], None]:
        _show_fields(method, config, [inspect.Parameter("self", inspect.Parameter.POSITIONAL_ONLY)])
        return cast("Callable[Concatenate[Any, Fields], None]", method)

    return decorate


def _show_fields(function: Any, config: Any, first: list[inspect.Parameter]) -> None:
    signature = inspect.signature(config)
    function.__signature__ = signature.replace(
        parameters=[*first, *signature.parameters.values()],
        return_annotation=inspect.signature(function).return_annotation,
    )
    texts = field_docs(config)
    arguments = "\n".join(indent(f"{name}: {texts[name]}", "    ") for name in signature.parameters)
    function.__doc__ = f"{inspect.getdoc(function)}\n\nArgs:\n{arguments}\n"


def field_docs(config: type) -> dict[str, str]:
    """Return the docstrings below the fields of a dataclass, including inherited fields, by name."""
    docs: dict[str, str] = {}
    for base in reversed(config.__mro__[:-1]):
        (definition,) = ast.parse(dedent(inspect.getsource(base))).body
        for member, after in pairwise(cast("ast.ClassDef", definition).body):
            match member, after:
                case ast.AnnAssign(target=ast.Name(name)), ast.Expr(value=ast.Constant(str(text))):
                    docs[name] = inspect.cleandoc(text).replace("\n", "\n    ")
                case _:
                    pass
    return docs
