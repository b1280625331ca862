"""A lock on a folder that a process writes over time."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from mapf_pz._internal.atomic import naming

LOCK_FILE = ".lock"
"""Name of the file in the folder that holds the lock."""


@contextmanager
def locked(folder: Path | None) -> Generator[None]:
    """Lock a folder, which is created if it is missing; without a folder, do nothing.

    The same thread may lock a folder that it has locked already. The lock ends with its process, also if that is
    killed. A folder that was created is removed again if it is empty at the end, for example after an error.

    Raises `BlockingIOError` if another process or thread has locked the folder.
    """
    if folder is None:
        yield
        return
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    with naming(folder):
        folder.mkdir(parents=True, exist_ok=True)
    lock = FileLock(folder / LOCK_FILE, is_singleton=True)
    try:
        lock.acquire(blocking=False)
    except Timeout:
        raise BlockingIOError(f"{folder}: another process is writing to this folder; expected another one") from None
    try:
        yield
    finally:
        if lock.lock_counter == 1:
            # Nothing is written after this, so it does not matter that another process may lock a new file now.
            (folder / LOCK_FILE).unlink(missing_ok=True)
        lock.release()
        for path in missing:
            if any(path.iterdir()):
                break
            path.rmdir()
