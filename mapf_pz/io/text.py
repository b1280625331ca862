"""Untrusted text files: read whole, up to a limit, and refused in one line."""

from __future__ import annotations

import codecs
import os
from pathlib import Path

from mapf_pz.errors import FormatError

MAX_FILE_BYTES = 64 * 2**20
"""Larger files are refused."""


def read_text(path: str | Path, max_bytes: int | None = None) -> str:
    """Return the text of a UTF-8 file, without a byte order mark and with its line ends as they are.

    Args:
        path: The file.
        max_bytes: How large it may be; None: `MAX_FILE_BYTES`.

    Raises:
        FileNotFoundError: There is no such file.
        FormatError: It is a folder or device, is too large, or is not UTF-8.
    """
    limit = MAX_FILE_BYTES if max_bytes is None else max_bytes
    # A device or pipe could block or never end.
    if not os.path.isfile(path):
        if os.path.exists(path):
            raise FormatError(path, "expected a file, got a folder or device")
        raise FileNotFoundError(f"{path}: no such file")
    with open(path, "rb") as file:
        data = file.read(limit + 1)
    if len(data) > limit:
        raise FormatError(path, f"expected at most {limit} bytes")
    data = data.removeprefix(codecs.BOM_UTF8)
    try:
        return data.decode()
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        column = error.start - data.rfind(b"\n", 0, error.start)
        raise FormatError(path, f"expected UTF-8 text, got the byte {data[error.start]:#04x}", line, column) from None
