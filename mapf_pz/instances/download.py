"""Download of the MovingAI benchmark into the user's cache, which makes its maps and scenarios available by name."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from http import HTTPStatus
from pathlib import Path
from typing import Any, TypeAlias

from mapf_pz._internal.atomic import naming
from mapf_pz._internal.lock import locked
from mapf_pz.instances.files.archive import Archive, unpack

CACHE_VARIABLE = "MAPF_PZ_CACHE"
"""Environment variable for the folder of downloaded data; overrides the user's cache."""
TIMEOUT = 30.0
"""Seconds without data from the server after which the connection is considered lost."""
MAX_BYTES = 2**30
"""Maximum size of a download; larger ones are rejected."""
PIECE = 2**16
"""Chunk size of downloads in bytes."""

Show: TypeAlias = Callable[[str, int, "int | None"], None]
"""Progress callback: the name of an archive, the bytes received, and the total if the server reports it."""


def cache_folder() -> Path:
    """Return the folder of downloaded data, which may not exist: `$MAPF_PZ_CACHE`, or the user's cache."""
    chosen = os.environ.get(CACHE_VARIABLE)
    if chosen:
        return Path(chosen)
    from pooch import os_cache  # slow to import, and rarely needed

    return Path(os_cache("mapf-pz"))


def download(archives: Iterable[Archive], folder: Path, show: Show) -> int:
    """Download archives, verify them, and unpack them to `folder/maps` and `folder/scens`.

    The archives are kept in `folder` and not downloaded again. Interrupted downloads are resumed.

    Returns:
        Number of files unpacked; 0 if all of them existed already.

    Raises:
        BlockingIOError: Another process is writing to the folder.
        ConnectionError: The server cannot be reached, or the connection was lost.
        OSError: The server does not have the file, or it cannot be written.
        ValueError: The checksum of an archive is wrong; the archive is deleted.
        FormatError: An archive cannot be unpacked safely.
    """
    import pooch

    written = 0
    with locked(folder):
        for archive in archives:
            # Typed as Any, since pooch annotates downloaders with the wrong parameter names.
            resuming: Any = _Resuming(show)
            file = Path(pooch.retrieve(archive.url, archive.sha256, archive.name, folder, downloader=resuming))
            written += unpack(file, file.parent)
    return written


class _Resuming:
    """A downloader for pooch that keeps partial files and resumes interrupted downloads."""

    def __init__(self, show: Show) -> None:
        self._show = show

    def __call__(self, url: str, output_file: str, pooch: object) -> None:
        """Download `url` to `NAME.part`, and rename that to `output_file`, which pooch then verifies."""
        name = url.rpartition("/")[2]
        part = Path(output_file).with_name(f"{name}.part")
        self._receive(url, name, part)
        part.replace(output_file)

    def _receive(self, url: str, name: str, part: Path) -> None:
        """Request the missing bytes of `part`, and append them."""
        import requests

        size = part.stat().st_size if part.exists() else 0
        # With a content encoding, the bytes received would not be those of the file.
        headers = {"Accept-Encoding": "identity"} | ({"Range": f"bytes={size}-"} if size else {})
        try:
            response = requests.get(url, headers=headers, stream=True, timeout=TIMEOUT)
        except requests.RequestException as error:
            raise ConnectionError(f"{url}: no answer ({type(error).__name__}); is this machine online?") from None
        with response:
            if size and response.status_code == HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE:  # nothing is left
                part.unlink()
                return self._receive(url, name, part)
            if not response.ok:
                raise OSError(f"{url}: the server answers {response.status_code} {response.reason}")
            if response.status_code != HTTPStatus.PARTIAL_CONTENT:  # the whole file, from the beginning
                size = 0
            length = response.headers.get("Content-Length")
            total = None if length is None else size + int(length)
            _check_size(url, total or 0, part)
            with part.open("ab" if size else "wb") as file:
                try:
                    for chunk in response.iter_content(PIECE):
                        _check_size(url, size + len(chunk), part)
                        with naming(part):
                            size += file.write(chunk)
                        self._show(name, size, total)
                except requests.RequestException:
                    advice = "run the same command again to resume"
                    raise ConnectionError(f"{url}: the connection was cut after {size:,} bytes; {advice}") from None


def _check_size(url: str, size: int, part: Path) -> None:
    """Raise `OSError` for a download of more than `MAX_BYTES`, and delete what has been received."""
    if size > MAX_BYTES:
        part.unlink(missing_ok=True)
        raise OSError(f"{url}: expected at most {MAX_BYTES:,} bytes, the server sends more")
