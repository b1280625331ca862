"""One decorator for all kernels: compiled when they are first needed, and cached on disk."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core.registry import CPUDispatcher

from mapf_pz._internal.compilation.cache import KernelCache, cache_root, numba_config
from mapf_pz._internal.compilation.dry_run import compile_together, current_dry_run

Kernel = TypeVar("Kernel", bound=Callable[..., Any])
Array = Any  # numpy arrays; the comments give shape and dtype, which Numba's compiled signatures hold to

_CPUDispatcher: Any = CPUDispatcher  # Numba is not annotated
_PROCESS = os.getpid()


def jit(kernel: Kernel) -> Kernel:
    """Compile `kernel` when it is first called."""
    return _compile(kernel, parallel=False)


def inlined(kernel: Kernel) -> Kernel:
    """Compile a short `kernel` into the kernels that call it, where passing its arguments would take longer than it.

    It must not allocate or return arrays.
    """
    return _compile(kernel, parallel=False, forceinline=True, nrt=False)


class BatchKernel:
    """A kernel with a `prange` over the environments of a batch, compiled apart for one thread and for several.

    It must not allocate arrays. In its own body it must not assign to an array out of a tuple (`state.time[b] = 1`),
    only in a `@jit` function that it calls: compiling for several threads, Numba (0.68) drops such a line.
    """

    def __init__(self, kernel: Callable[..., None]) -> None:
        """Take the plain Python function; as a decorator, `@BatchKernel`."""
        self.__doc__, self.__name__, self.__module__ = kernel.__doc__, kernel.__name__, kernel.__module__
        name = kernel.__name__
        self._serial: Any = _compile(kernel, parallel=False, nrt=False, path=f"{name}._serial")
        self._parallel: Any = _compile(kernel, parallel=True, path=f"{name}._parallel")

    def __call__(self, num_threads: int, *arguments: Any) -> None:
        """Run the kernel on `num_threads` threads; in a forked process on one, since OpenMP's do not survive a fork."""
        if num_threads == 1 or os.getpid() != _PROCESS:
            self._serial(*arguments)
            return
        before = numba.get_num_threads()
        numba.set_num_threads(num_threads)
        try:
            self._parallel(*arguments)
        finally:
            numba.set_num_threads(before)

    def bind(self, num_threads: int, first: tuple[Any, ...], others: tuple[Any, ...]) -> BoundKernel:
        """Return the kernel with its first arguments `first`; `others` are examples of those that it is called with."""
        return BoundKernel(self, num_threads, first, others)

    def compiled(self, num_threads: int, arguments: tuple[Any, ...]) -> Callable[..., None]:
        """Return the compiled function for arguments like these, whose types it does not check."""
        kernel = self._serial if num_threads == 1 else self._parallel
        dry_run = current_dry_run()
        if dry_run is not None:
            return dry_run.call_of(kernel, arguments)
        return kernel.compile(tuple(map(numba.typeof, arguments)))

    def __reduce__(self) -> str:
        """Pickle and copy the kernel as what it is in its module."""
        return self.__name__


class BoundKernel:
    """A kernel with its first arguments.

    The others must have the types, dimensions and memory layout of the examples, which is not checked: Numba's look-up
    of the types of all arguments takes longer than the work for a few agents.
    """

    def __init__(
        self, kernel: BatchKernel, num_threads: int, first: tuple[Any, ...], examples: tuple[Any, ...]
    ) -> None:
        """Load nothing yet."""
        self._parts = kernel, num_threads, first, examples
        self._run: Callable[..., None] = self._load_and_run

    def load(self) -> None:
        """Compile the kernel, or load it, as the first call does otherwise."""
        kernel, num_threads, first, examples = self._parts
        run: Callable[..., None] = partial(kernel, num_threads)
        if not numba_config.DISABLE_JIT:
            compiled = kernel.compiled(num_threads, (*first, *examples))
            run = compiled if num_threads == 1 else run
        self._run = partial(run, *first)

    def __call__(self, *others: Any) -> None:
        """Run the kernel."""
        self._run(*others)

    def _load_and_run(self, *others: Any) -> None:
        self.load()
        self._run(*others)

    def __reduce__(self) -> tuple[type[BoundKernel], tuple[Any, ...]]:
        """Pickle and copy the parts, since compiled functions cannot be."""
        return BoundKernel, self._parts


class _Kernel(_CPUDispatcher):
    """A function that Numba compiles: see `mapf_pz._internal.compilation`."""

    root: Path | None = None
    """The folder of the cache of all kernels; None: there is none."""
    path: str = ""
    """The name in the module of the function."""

    def has(self, types: tuple[Any, ...]) -> bool:
        """Return whether the kernel is compiled for arguments of these types, here or in the cache."""
        if types in self.overloads:
            return True
        return self.root is not None and self._cache.has(types, self.targetctx.codegen())

    def compile(self, sig: tuple[Any, ...]) -> Any:
        """Compile the kernel for arguments of these types, or load it."""
        if not self.has(sig):
            compile_together()
        return super().compile(sig)

    def get_call_template(self, args: tuple[Any, ...], kws: dict[str, Any]) -> Any:
        """Return how other kernels call this one: with whole numbers of one type, so that it is compiled only once."""
        return super().get_call_template(tuple(map(_wide, args)), {name: _wide(kind) for name, kind in kws.items()})

    def _compile_for_args(self, *arguments: Any, **keywords: Any) -> Any:
        """Return the function that is called with arguments of types for which none is compiled yet."""
        dry_run = current_dry_run()
        if dry_run is not None:
            return dry_run.call_of(self, arguments)
        return super()._compile_for_args(*arguments, **keywords)


def _wide(given: Any) -> Any:
    """Return the type of an argument that takes those of the given type: 64 bits for whole numbers with a sign."""
    kind: Any = numba.types.unliteral(given)
    return numba.types.int64 if kind in numba.types.signed_domain else kind


def _compile(kernel: Kernel, parallel: bool, forceinline: bool = False, nrt: bool = True, path: str = "") -> Kernel:
    """Compile a kernel on its first call.

    `nrt`: with Numba's runtime, which kernels that allocate or return arrays need. It counts the references to every
    slice of an array, which takes longer than the work on a slice for a few agents. `path`: if it is not its own name,
    the kernel's name in its module.
    """
    if numba_config.DISABLE_JIT:
        return kernel
    options = {"nopython": True, "nogil": True, "error_model": "numpy", "boundscheck": None}
    compiled = _Kernel(kernel, targetoptions=options | {"parallel": parallel, "forceinline": forceinline, "_nrt": nrt})
    compiled.root, compiled.path = cache_root(numba_config.CACHE_DIR), path or kernel.__name__
    if compiled.root is not None:
        compiled._cache = KernelCache(kernel, compiled.root, parallel)
    return cast("Kernel", compiled)
