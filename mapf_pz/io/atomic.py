"""Files that are written as a whole or not at all, and errors that say which file they are about."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def replacing(file: Path) -> Generator[Path]:
    """Give a file beside `file` to write, of the same ending, which takes its place at the end.

    What was there before stays until then, and on an error. An `OSError` names `file`.
    """
    beside = file.with_name(f".{file.stem}.new{file.suffix}")
    try:
        yield beside
        beside.replace(file)
    except OSError as error:
        raise _about(file, error) from None
    finally:
        beside.unlink(missing_ok=True)


def write_whole(file: Path, content: bytes) -> None:
    """Write a file so that it is never seen half-written."""
    with replacing(file) as beside:
        beside.write_bytes(content)


@contextmanager
def naming(path: Path) -> Generator[None]:
    """Let an `OSError` that names no file name this file or folder: that of a full disk does not."""
    try:
        yield
    except OSError as error:
        raise error if error.filename is not None else _about(path, error) from None


def _about(path: Path, error: OSError) -> OSError:
    return OSError(f"{path}: {error}") if error.errno is None else OSError(error.errno, error.strerror, str(path))
