"""The cache of compiled kernels on disk, which is never stale and which several processes may write to.

Numba's own cache does not see that a callee in another file has changed, so the cache folder is named by a hash of all
kernel files: any change to one of them compiles afresh. Nor does it tell kernels for one thread from those for several:
these have a folder of their own. And it has one index of all that is compiled of a function, in which two processes may
lose each other's entries: here, each compiled function is one file.

Without a writable folder for the cache, it is in a temporary folder of the user; without that, nothing is cached.
"""

from __future__ import annotations

import hashlib
import os
import stat
import tempfile
import warnings
from functools import cache
from multiprocessing import current_process
from pathlib import Path
from typing import Any

from numba import config
from numba.core.caching import FunctionCache, IndexDataCacheFile

numba_config: Any = config  # its settings are made when it is loaded, unseen by type checkers
_FunctionCache: Any = FunctionCache  # Numba is not annotated
_CacheFile: Any = IndexDataCacheFile


class KernelCache(_FunctionCache):
    """What is compiled of one function."""

    def __init__(self, function: Any, root: Path, parallel: bool) -> None:
        """Keep it below `root`; `parallel`: the function is compiled for several threads."""
        # Numba reads the folder when the cache is made; the user's own setting is put back at once.
        previous = numba_config.CACHE_DIR
        numba_config.CACHE_DIR = str(root / ("parallel" if parallel else "serial"))
        try:
            super().__init__(function)
        finally:
            numba_config.CACHE_DIR = previous
        self._cache_file = _Files(self._cache_path, self._impl.filename_base, self._impl.locator.get_source_stamp())

    def has(self, types: tuple[Any, ...], codegen: Any) -> bool:
        """Return whether there is a file for arguments of these types."""
        return self._cache_file.has(self._index_key(types, codegen))


class _Files(_CacheFile):
    """The files of one function, each for arguments of certain types; what the file is for is in it, too."""

    def has(self, key: object) -> bool:
        return os.path.exists(self._data_path(self._file_of(key)))

    def load(self, key: object) -> Any:
        try:
            version, stamp, stored, data = self._load_data(self._file_of(key))
        except FileNotFoundError:
            return None
        return data if (version, stamp, stored) == (self._version, self._source_stamp, key) else None

    def save(self, key: object, data: object) -> None:
        self._save_data(self._file_of(key), (self._version, self._source_stamp, key, data))

    def _file_of(self, key: object) -> str:
        return self._data_name(int(hashlib.sha256(repr(key).encode()).hexdigest()[:12], 16))


@cache
def cache_root(setting: str) -> Path | None:
    """Return the folder of the cache of these kernels; None if there is no folder to which the user can write.

    It is in `setting`, Numba's cache folder, if one is set, otherwise in the user's cache. Warns of any other.
    """
    try:
        base = Path(setting) if setting else Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        return _writable(base / "mapf_pz" / _FINGERPRINT)
    except (OSError, RuntimeError) as error:  # RuntimeError: the user has no home
        reason = " ".join(str(error).split()).rstrip(".")
    try:
        base = _private_folder()
        folder, place = _writable(base / "mapf_pz" / _FINGERPRINT), f"cached in {base}"
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


def _fingerprint() -> str:
    """Hash the kernel files and what else changes the compiled code."""
    digest = hashlib.sha256(f"bounds check {numba_config.BOUNDSCHECK}".encode())
    package = Path(__file__).parents[2]
    kernels = package / "simulator" / "kernels"
    for file in sorted(package.rglob("*.py")):
        content = file.read_bytes()
        if kernels in file.parents or any(name in content for name in _IMPORTED_BY_KERNELS):
            digest.update(content)
    return digest.hexdigest()[:16]


_IMPORTED_BY_KERNELS = b"from mapf_pz._internal.jit import", b"from numba import", b"from numba.core"
_FINGERPRINT = _fingerprint()
