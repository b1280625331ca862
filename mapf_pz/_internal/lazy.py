"""Packages whose public names are loaded when they are first used, so that importing a package is quick."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from importlib import import_module
from typing import Any


def lazy_attributes(package: str, homes: Mapping[str, str], packages: Collection[str] = ()) -> Callable[[str], Any]:
    """Return a package's function `__getattr__` (PEP 562).

    Args:
        package: name of the package.
        homes: the modules, relative to the package, that define its public names.
        packages: names of packages in the package, which are imported when they are first used.
    """

    def load(name: str) -> Any:
        if name in packages:
            return import_module(f"{package}.{name}")
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(f"{package}.{homes[name]}"), name)

    return load
