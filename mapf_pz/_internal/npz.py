"""Untrusted `.npz` files: NumPy arrays in a zip archive, which are read up to a size limit and never unpickled."""

from __future__ import annotations

import io
import math
import zipfile
import zlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapf_pz._internal.atomic import write_whole
from mapf_pz._internal.text import read_bytes
from mapf_pz.errors import FormatError

MAX_BYTES = 2**29
"""Maximum size of all arrays of a file together."""
_DAMAGE = (zipfile.BadZipFile, zlib.error, ValueError, LookupError, EOFError, OSError, RuntimeError, TypeError)


def read_npz(path: str | Path, names: Iterable[str], max_bytes: int = MAX_BYTES) -> dict[str, NDArray[Any]]:
    """Return the arrays of these names, of booleans, numbers or text.

    Args:
        path: The file.
        names: The names of the arrays.
        max_bytes: Maximum size of these arrays together, which is checked before any of them is read.

    Raises:
        FileNotFoundError: The file does not exist.
        FormatError: The file is malformed or too large, or an array is missing.
    """
    content = io.BytesIO(read_bytes(path))
    try:
        with zipfile.ZipFile(content) as archive:
            members = {name: archive.getinfo(f"{name}.npy") for name in names}
            size = sum(member.file_size for member in members.values())
            if size > max_bytes:
                raise ValueError(f"expected arrays of at most {max_bytes} bytes, got {size}")
            return {name: _array(archive, name, member) for name, member in members.items()}
    except _DAMAGE as error:
        reason = " ".join(str(error).split())
        raise FormatError(path, f"expected an .npz file with the arrays {', '.join(names)}: {reason}") from None


def write_npz(path: str | Path, arrays: Mapping[str, ArrayLike]) -> None:
    """Write arrays by name; the file is replaced atomically."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w") as member:
                np.lib.format.write_array(member, np.asarray(array), allow_pickle=False)
    write_whole(Path(path), buffer.getvalue())


def _array(archive: zipfile.ZipFile, name: str, member: zipfile.ZipInfo) -> NDArray[Any]:
    """Return an array, after checking its header; raises one of `_DAMAGE`."""
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ValueError(f"array {name!r} is compressed by an unknown method")
    with archive.open(member) as file:
        content = io.BytesIO(file.read(member.file_size))
    np.lib.format.read_magic(content)
    shape, is_fortran, dtype = np.lib.format.read_array_header_1_0(content)
    data = content.read()
    if dtype.kind not in "biufU":
        raise ValueError(f"array {name!r} has an unknown header")
    if dtype.itemsize * math.prod(shape) != len(data):  # NumPy's own reader would allocate what the header claims
        raise ValueError(f"array {name!r} is not of the size in its header")
    return np.frombuffer(data, dtype).reshape(shape, order="F" if is_fortran else "C")
