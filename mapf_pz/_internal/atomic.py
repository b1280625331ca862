"""Atomic writes of files, and errors that name their files."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from uuid import uuid4


@contextmanager
def replacing(file: Path) -> Generator[Path]:
    """Yield a temporary file in the same folder with the same extension, which replaces `file` at the end.

    After an error, the old file remains. An `OSError` names `file`. Processes that write the file at the same
    time have separate temporary files.
    """
    temporary = file.with_name(f".{uuid4().hex}.new{file.suffix}")
    try:
        # A new file, since a link that someone else has made there would be followed.
        temporary.touch(exist_ok=False)
        yield temporary
        temporary.replace(file)
    except OSError as error:
        raise _named(file, error) from None
    finally:
        temporary.unlink(missing_ok=True)


def write_whole(file: Path, content: bytes) -> None:
    """Write a file atomically."""
    with replacing(file) as temporary:
        temporary.write_bytes(content)


@contextmanager
def naming(path: Path) -> Generator[None]:
    """Add the name of this file or folder to any `OSError` that lacks one, such as that of a full disk."""
    try:
        yield
    except OSError as error:
        raise error if error.filename is not None else _named(path, error) from None


def _named(path: Path, error: OSError) -> OSError:
    return OSError(f"{path}: {error}") if error.errno is None else OSError(error.errno, error.strerror, str(path))
