"""Signatures of functions whose keywords are the fields of a configuration: for editors, `help()`, type checkers."""

from __future__ import annotations

import ast
import inspect
import sys
from collections.abc import Callable, Iterator
from functools import cache
from itertools import pairwise
from textwrap import indent
from typing import Any, Concatenate, ParamSpec, TypeVar, cast

Fields = ParamSpec("Fields")
Result = TypeVar("Result")
_INDENT = "    "


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
    document_fields(function, config)


def document_fields(function: Any, config: Any) -> None:
    """Add the documentation of the fields of the dataclass `config` to that of a function or class."""
    docs, names = field_docs(config), inspect.signature(config).parameters
    shown = [f"{name}: {indent(docs[name], _INDENT).lstrip()}" for name in names if name in docs]
    function.__doc__ = "\n".join([str(inspect.getdoc(function)), "", "Args:", indent("\n".join(shown), _INDENT), ""])


def field_docs(config: type) -> dict[str, str]:
    """Return the docstrings below the fields of a dataclass, including inherited fields, by name."""
    bases = reversed(config.__mro__[:-1])
    return {name: text for base in bases for name, text in _module_docs(base.__module__).get(base.__name__, {}).items()}


@cache
def _module_docs(module: str) -> dict[str, dict[str, str]]:
    """Return the docstrings below the fields of all classes of a module, by class and by field."""
    tree = ast.parse(inspect.getsource(sys.modules[module]))
    return {node.name: dict(_class_docs(node)) for node in ast.walk(tree) if isinstance(node, ast.ClassDef)}


def _class_docs(definition: ast.ClassDef) -> Iterator[tuple[str, str]]:
    for member, after in pairwise(definition.body):
        match member, after:
            case ast.AnnAssign(target=ast.Name(name)), ast.Expr(value=ast.Constant(str(text))):
                yield name, inspect.cleandoc(text)
            case _:
                pass
