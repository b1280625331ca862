"""A dry run finds all kernels that code needs before any is compiled, so that they can be compiled in parallel.

In a dry run, kernels that are not compiled run as plain Python, which is fast for a few agents on a small map. The
types of their arguments are all that is needed to compile them.
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

Example: TypeAlias = Callable[[], object]
"""Code that calls kernels. It may run several times."""


class DryRun:
    """The kernels that examples call and that are not compiled."""

    def __init__(self, examples: tuple[Example, ...]) -> None:
        """Run the examples. An error ends an example: the real run raises it, too, unless only plain Python does."""
        self.jobs: list[Job] = []
        self._is_within_kernel = False
        token = _dry_run.set(self)
        try:
            for example in examples:
                with suppress(Exception), np.errstate(all="ignore"):
                    example()
        finally:
            _dry_run.reset(token)

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


_dry_run: ContextVar[DryRun | None] = ContextVar("dry_run", default=None)
_together: ContextVar[Example | None] = ContextVar("together", default=None)


def current_dry_run() -> DryRun | None:
    """Return the dry run that runs this code, if one does."""
    return _dry_run.get()


def compile_all(*examples: Example) -> int:
    """Compile all kernels that examples call, then run the examples; return how many kernels were not compiled before.

    A kernel and those that it calls count as one.
    """
    jobs = DryRun(examples).jobs if current_dry_run() is None else []
    if jobs:
        run_jobs(jobs)
    for example in examples:
        example()  # loads what other processes have compiled
    return len(jobs)


@contextmanager
def compiling_together(example: Example) -> Generator[None]:
    """Let the first kernel that is not compiled be compiled together with all those that `example` calls."""
    token = _together.set(None if current_dry_run() else example)
    try:
        yield
    finally:
        _together.reset(token)


def compile_together() -> None:
    """Compile the kernels of the example that `compiling_together` has, if any."""
    example = _together.get()
    if example is not None:
        token = _together.set(None)
        try:
            compile_all(example)
        finally:
            _together.reset(token)


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
