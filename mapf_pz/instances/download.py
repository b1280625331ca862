"""The download of the MovingAI benchmark into the user's cache, where maps and scenarios are then found by name."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from http import HTTPStatus
from pathlib import Path
from typing import Any, TypeAlias

from mapf_pz.instances.archive import Archive, unpack
from mapf_pz.io.atomic import naming

CACHE_VARIABLE = "MAPF_PZ_CACHE"
"""The environment variable that names the folder of downloaded data, in place of the user's cache."""
TIMEOUT = 30.0
"""Seconds without a word from the server after which the connection counts as cut."""
PIECE = 2**16
"""Bytes that are received at a time."""

Show: TypeAlias = Callable[[str, int, "int | None"], None]
"""Is told the name of an archive, the bytes that are here, and how many there are where the server says so."""


def cache_folder() -> Path:
    """Return the folder of downloaded data, which need not exist: `$MAPF_PZ_CACHE`, or the user's cache."""
    chosen = os.environ.get(CACHE_VARIABLE)
    if chosen:
        return Path(chosen)
    from pooch import os_cache  # takes a while, and most programs never come here

    return Path(os_cache("mapf-pz"))


def download(archives: Iterable[Archive], folder: Path, show: Show) -> int:
    """Download archives, check them, and unpack them into `folder/maps` and `folder/scens`.

    The archives stay in `folder`: what is there is not downloaded again. A download that was cut goes on where it was.

    Returns:
        How many files were unpacked; 0 where all were there.

    Raises:
        ConnectionError: The server cannot be reached, or the connection was cut.
        OSError: The server has no such file, or the disk does not take it.
        ValueError: An archive does not have its checksum; it is deleted.
        FormatError: An archive does not unpack safely.
    """
    import pooch

    written = 0
    for archive in archives:
        # Its annotation gives a downloader the names of a processor's parameters.
        resuming: Any = _Resuming(show)
        file = Path(pooch.retrieve(archive.url, archive.sha256, archive.name, folder, downloader=resuming))
        written += unpack(file, file.parent)
    return written


class _Resuming:
    """A downloader for pooch that keeps what it has when the connection is cut, and goes on from there."""

    def __init__(self, show: Show) -> None:
        self._show = show

    def __call__(self, url: str, output_file: str, pooch: object) -> None:
        """Download `url` to `output_file`, by way of `NAME.part` beside it; pooch then checks it."""
        name = url.rpartition("/")[2]
        part = Path(output_file).with_name(f"{name}.part")
        self._receive(url, name, part)
        part.replace(output_file)

    def _receive(self, url: str, name: str, part: Path) -> None:
        """Ask for what is missing of `part`, and add it."""
        import requests

        here = part.stat().st_size if part.exists() else 0
        # Compressed on the way, the bytes would not be those of the file, and could not be counted.
        headers = {"Accept-Encoding": "identity"} | ({"Range": f"bytes={here}-"} if here else {})
        try:
            response = requests.get(url, headers=headers, stream=True, timeout=TIMEOUT)
        except requests.RequestException as error:
            raise ConnectionError(f"{url}: no answer ({type(error).__name__}); is this machine online?") from None
        with response:
            if here and response.status_code == HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE:  # there is no more
                part.unlink()
                return self._receive(url, name, part)
            if not response.ok:
                raise OSError(f"{url}: the server answers {response.status_code} {response.reason}")
            if response.status_code != HTTPStatus.PARTIAL_CONTENT:  # the whole file, from the beginning
                here = 0
            length = response.headers.get("Content-Length")
            total = None if length is None else here + int(length)
            with part.open("ab" if here else "wb") as file:
                try:
                    for piece in response.iter_content(PIECE):
                        with naming(part):
                            here += file.write(piece)
                        self._show(name, here, total)
                except requests.RequestException:
                    cut = f"{url}: the connection was cut after {here:,} bytes; the same command goes on from there"
                    raise ConnectionError(cut) from None
