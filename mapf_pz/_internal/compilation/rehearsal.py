"""A rehearsal finds all kernels that code needs before any is compiled, so that they are compiled in parallel.

In a rehearsal, kernels that are not compiled are called in plain Python, which is fast for a few agents on a small map.
With which types of arguments they are called is all that compiling them needs.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from functools import partial
from typing import Any, TypeAlias

import numba
import numpy as np

from mapf_pz._internal.compilation.jobs import Job, run_jobs

Scene: TypeAlias = Callable[[], object]
"""Code that calls kernels, and may be called several times."""


class Rehearsal:
    """The kernels that scenes call and that are not compiled."""

    def __init__(self, scenes: tuple[Scene, ...]) -> None:
        """Call the scenes. An error ends one: a real call will raise it, too, unless plain Python alone does."""
        self.jobs: list[Job] = []
        self._is_within_kernel = False
        token = _rehearsal.set(self)
        try:
            for scene in scenes:
                with suppress(Exception), np.errstate(all="ignore"):
                    scene()
        finally:
            _rehearsal.reset(token)

    def call_of(self, kernel: Any, arguments: tuple[Any, ...]) -> Callable[..., Any]:
        """Return the kernel for such arguments, in plain Python unless it is compiled."""
        if self._is_within_kernel:
            return kernel.py_func
        types = tuple(map(numba.typeof, arguments))
        if kernel.has(types):
            return kernel.compile(types)
        job = Job(kernel, types)
        if job not in self.jobs:
            self.jobs.append(job)
        return partial(self._interpret, kernel.py_func)

    def _interpret(self, function: Callable[..., Any], *arguments: Any) -> Any:
        self._is_within_kernel = True
        try:
            return _as_python(function(*map(_with_attributes, arguments)))
        finally:
            self._is_within_kernel = False


_rehearsal: ContextVar[Rehearsal | None] = ContextVar("rehearsal", default=None)
_announced: ContextVar[Scene | None] = ContextVar("announced", default=None)


def current_rehearsal() -> Rehearsal | None:
    """Return the rehearsal that calls this code, if one does."""
    return _rehearsal.get()


def compile_all(*scenes: Scene) -> int:
    """Call the scenes, and before that compile all kernels that they call; return how many were not compiled before.

    Kernels that call each other count as one.
    """
    jobs = Rehearsal(scenes).jobs if current_rehearsal() is None else []
    if jobs:
        run_jobs(jobs)
    for scene in scenes:
        scene()  # loads what other processes have compiled
    return len(jobs)


@contextmanager
def announced(scene: Scene) -> Generator[None]:
    """Let the first kernel that is not compiled be compiled together with all those that `scene` calls."""
    token = _announced.set(None if current_rehearsal() else scene)
    try:
        yield
    finally:
        _announced.reset(token)


def compile_announced() -> None:
    """Compile the kernels of the scene that is announced, if one is."""
    scene = _announced.get()
    if scene is not None:
        token = _announced.set(None)
        try:
            compile_all(scene)
        finally:
            _announced.reset(token)


def _as_python(result: Any) -> Any:
    """Return a result with numbers of Python, as compiled kernels return them."""
    if isinstance(result, tuple):
        return _of_type(result, map(_as_python, result))
    return result.item() if isinstance(result, np.generic) else result


def _of_type(original: tuple[Any, ...], parts: Iterable[Any]) -> tuple[Any, ...]:
    """Return a tuple of the same type, which may be a named tuple, with other parts."""
    return type(original)(*parts) if hasattr(original, "_fields") else tuple(parts)


def _with_attributes(argument: Any) -> Any:
    """Return the argument with the fields of records as attributes, as compiled kernels read them."""
    if isinstance(argument, tuple):
        return _of_type(argument, map(_with_attributes, argument))
    if isinstance(argument, np.ndarray) and argument.dtype.names:
        return argument.view(np.recarray)
    return argument
