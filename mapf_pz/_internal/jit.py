"""One decorator for all kernels: compiled on first use, cached on disk, and never stale.

Numba's own cache does not see that a callee in another file has changed, so the cache folder is named by a hash of all
kernel files: any change to one of them compiles afresh. Nor does it tell kernels for one thread from those for several:
these have a folder of their own.

Without a writable folder for the cache, it is in a temporary folder of the user; without that, nothing is cached.
"""

from __future__ import annotations

import hashlib
import logging
import os
import stat
import tempfile
import warnings
from collections.abc import Callable
from functools import cache, partial
from multiprocessing import current_process
from pathlib import Path
from typing import Any, TypeVar

import numba
from numba import config
from numba.core import event

Kernel = TypeVar("Kernel", bound=Callable[..., Any])
Array = Any  # numpy arrays; the comments give shape and dtype, which Numba's compiled signatures hold to
logger = logging.getLogger(__name__)

numba_config: Any = config  # its settings are made when it is loaded, unseen by type checkers
_njit: Any = numba.njit  # its annotations lack the option `_nrt`
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
        self._serial: Any = _compile(kernel, parallel=False, nrt=False)
        self._parallel: Any = _compile(kernel, parallel=True)

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

    def compiled(self, arguments: tuple[Any, ...]) -> Callable[..., None]:
        """Return the compiled function for one thread and for arguments like these, whose types it does not check."""
        return self._serial.compile(tuple(map(numba.typeof, arguments)))

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
        """Compile the kernel, if it is for one thread."""
        self._parts = kernel, num_threads, first, examples
        if num_threads > 1 or numba_config.DISABLE_JIT:
            self._run = partial(kernel, num_threads, *first)
        else:
            self._run = partial(kernel.compiled((*first, *examples)), *first)

    def __call__(self, *others: Any) -> None:
        """Run the kernel."""
        self._run(*others)

    def __reduce__(self) -> tuple[type[BoundKernel], tuple[Any, ...]]:
        """Pickle and copy the parts, since compiled functions cannot be."""
        return BoundKernel, self._parts


def _compile(kernel: Kernel, parallel: bool, forceinline: bool = False, nrt: bool = True) -> Kernel:
    """Compile a kernel on its first call.

    `nrt`: with Numba's runtime, which kernels that allocate or return arrays need. It counts the references to every
    slice of an array, which takes longer than the work on a slice for a few agents.
    """
    # Numba reads the folder when it decorates; the user's own setting is put back at once.
    previous = numba_config.CACHE_DIR
    root = _cache_root(previous)
    numba_config.CACHE_DIR = "" if root is None else str(root / ("parallel" if parallel else "serial"))
    try:
        compiled = _njit(
            kernel,
            cache=root is not None,
            nogil=True,
            error_model="numpy",
            parallel=parallel,
            forceinline=forceinline,
            _nrt=nrt,
        )
    finally:
        numba_config.CACHE_DIR = previous
    return compiled


@cache
def _cache_root(setting: str) -> Path | None:
    """Return the folder of the cache of these kernels; None if there is no folder to which the user can write.

    It is in `setting`, Numba's cache folder, if one is set, otherwise in the user's cache. Warns of any other.
    """
    try:
        base = Path(setting) if setting else Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        return _writable(base / "mapf_pz" / _FINGERPRINT)
    except (OSError, RuntimeError) as error:  # RuntimeError: the user has no home
        reason = " ".join(str(error).split()).rstrip(".")
    try:
        folder = _writable(_private_folder() / _FINGERPRINT)
        place = f"cached in {folder.parent}"
    except OSError:
        folder, place = None, "not cached"
    if current_process().name == "MainProcess":  # in others, the warning would be repeated
        advice = "set NUMBA_CACHE_DIR to a folder that you can write to"
        warnings.warn(f"compiled kernels are {place}: {reason}; {advice}", RuntimeWarning, stacklevel=2)
    return folder


def _writable(folder: Path) -> Path:
    """Create a folder if it is missing, and return it; raises `OSError` if no file can be created in it."""
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryFile(dir=folder):
        return folder


def _private_folder() -> Path:
    """Return the user's own temporary folder, which other users cannot write to: what is in it will be executed."""
    folder = Path(tempfile.gettempdir()) / f"mapf_pz-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.lstat()
    if stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not found.st_mode & 0o022:
        return folder
    return Path(tempfile.mkdtemp(prefix="mapf_pz-"))


class _FirstCompilation(event.Listener):
    """Logs a message before the first kernel that is really compiled; kernels loaded from the cache are none."""

    def __init__(self) -> None:
        self._done = False

    def on_start(self, event: Any) -> None:
        if not self._done and event.data["dispatcher"].py_func.__module__.startswith("mapf_pz."):
            self._done = True
            logger.warning("compiling kernels, which takes up to a minute (once per machine and version) ...")

    def on_end(self, event: Any) -> None:
        pass


event.register("numba:compile", _FirstCompilation())


def _fingerprint() -> str:
    """Hash the kernel files and what else changes the compiled code."""
    digest = hashlib.sha256(f"bounds check {numba_config.BOUNDSCHECK}".encode())
    package = Path(__file__).parents[1]
    kernels = package / "simulator" / "kernels"
    for file in sorted(package.rglob("*.py")):
        content = file.read_bytes()
        if file == Path(__file__) or kernels in file.parents or b"from mapf_pz._internal.jit import" in content:
            digest.update(content)
    return digest.hexdigest()[:16]


_FINGERPRINT = _fingerprint()
