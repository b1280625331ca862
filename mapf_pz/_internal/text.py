"""Untrusted files, which are read up to a size limit, with one-line errors."""

from __future__ import annotations

import codecs
import os
from pathlib import Path

from mapf_pz.errors import FormatError

MAX_FILE_BYTES = 64 * 2**20
"""Maximum size of a file."""


def read_text(path: str | Path, max_bytes: int | None = None) -> str:
    """Return the text of a UTF-8 file, without a byte order mark and with its original line endings.

    Args:
        path: the file.
        max_bytes: maximum size. None: `MAX_FILE_BYTES`.

    Raises:
        FileNotFoundError: the file does not exist.
        FormatError: the path is a folder or device, or the file is too large or not UTF-8.
    """
    data = read_bytes(path, max_bytes)
    data = data.removeprefix(codecs.BOM_UTF8)
    try:
        return data.decode()
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        column = error.start - data.rfind(b"\n", 0, error.start)
        raise FormatError(path, f"expected UTF-8 text, got the byte {data[error.start]:#04x}", line, column) from None


def read_bytes(path: str | Path, max_bytes: int | None = None) -> bytes:
    """Return the content of a file; raises as `read_text`, except that any bytes are allowed."""
    limit = MAX_FILE_BYTES if max_bytes is None else max_bytes
    # A device or pipe could block or be endless.
    if not os.path.isfile(path):
        if os.path.exists(path):
            raise FormatError(path, "expected a file, got a folder or device")
        raise FileNotFoundError(f"{path}: no such file")
    with open(path, "rb") as file:
        # Reading allocates as much as it asks for: not more than the size that the file states.
        stated = min(os.fstat(file.fileno()).st_size, limit)
        data = file.read(stated + 1)
        if stated < len(data) <= limit:  # the file grows, or states no size, such as those in /proc
            data += file.read(limit + 1 - len(data))
    if len(data) > limit:
        raise FormatError(path, f"expected at most {limit} bytes")
    return data
