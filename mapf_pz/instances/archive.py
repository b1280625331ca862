"""The zip files of the MovingAI benchmark: which there are, and how their maps and scenarios are taken out."""

from __future__ import annotations

import shutil
import stat
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from mapf_pz.errors import FormatError
from mapf_pz.io.atomic import replacing

FOLDERS = {".map": "maps", ".scen": "scens"}
"""Where files go, by their ending; others are left in the archive."""
MAX_MEMBERS = 10_000
"""Archives of more files are refused."""
MAX_BYTES = 2**30
"""Archives that would take more than this when they are unpacked are refused."""


@dataclass(frozen=True)
class Archive:
    """A zip file on a server."""

    url: str
    """Where it is served."""
    sha256: str
    """Its checksum, in hexadecimal digits."""

    @property
    def name(self) -> str:
        """The last part of the address."""
        return self.url.rpartition("/")[2]


_SERVER = "https://movingai.com/benchmarks/mapf"
ARCHIVES = {
    "maps": Archive(
        f"{_SERVER}/mapf-map.zip",
        "9da2e4c5ce03aa4e063b3a283ce874590b36cc4f31a297fe7ecb00d105abf288",
    ),
    "random": Archive(
        f"{_SERVER}/mapf-scen-random.zip",
        "20b7838f7a51f13e90a63ee138e9435fb4e41b0381becbc7313b7d3a7d859276",
    ),
    "even": Archive(
        f"{_SERVER}/mapf-scen-even.zip",
        "249896aaf15ef2d9beb378f954f0b7ca17189c6dec1b76a78965bbdbe714ad75",
    ),
}
"""The benchmark: its maps, and its two sets of scenarios."""


def unpack(file: Path, folder: Path) -> int:
    """Take maps and scenarios out of a zip file, and return how many were written.

    They go to `folder/maps` and `folder/scens`, without the folders that they have in the archive. Files that are there
    already, of the same size, are left alone.

    Raises:
        OSError: The archive cannot be read, or a file cannot be written.
        FormatError: It is no zip file or a spoilt one; it holds a link or a path that leads out of the folder; it would
            take more than `MAX_BYTES`, or holds more than `MAX_MEMBERS` files.
    """
    written = 0
    try:
        with zipfile.ZipFile(file) as archive:
            members = archive.infolist()
            _check(members, file)
            for member in members:
                target = _target(member, folder)
                if target is None or (target.is_file() and target.stat().st_size == member.file_size):
                    continue
                target.parent.mkdir(parents=True, exist_ok=True)
                # Piece by piece: a member that holds more than it says does not fill the memory.
                with archive.open(member) as source, replacing(target) as beside, beside.open("wb") as sink:
                    shutil.copyfileobj(source, sink)
                written += 1
    except (zipfile.BadZipFile, zlib.error, EOFError) as error:
        raise FormatError(file, f"expected a sound zip file: {error}") from None
    return written


def _check(members: list[zipfile.ZipInfo], file: Path) -> None:
    """Refuse an archive that no honest server would send."""
    if len(members) > MAX_MEMBERS:
        raise FormatError(file, f"expected at most {MAX_MEMBERS:,} files in the archive, got {len(members):,}")
    size = sum(member.file_size for member in members)
    if size > MAX_BYTES:
        raise FormatError(file, f"expected at most {MAX_BYTES:,} bytes when unpacked, got {size:,}")
    for member in members:
        path = PurePosixPath(member.filename.replace("\\", "/"))
        if path.is_absolute() or ".." in path.parts or ":" in member.filename:
            raise FormatError(file, f"expected paths inside the archive's folder, got {member.filename!r}")
        if stat.S_ISLNK(member.external_attr >> 16):
            raise FormatError(file, f"expected files, got the link {member.filename!r}")


def _target(member: zipfile.ZipInfo, folder: Path) -> Path | None:
    """Return where a member goes; None for one that is no map and no scenario."""
    path = PurePosixPath(member.filename)
    if member.is_dir() or path.name.startswith(".") or path.suffix not in FOLDERS:  # macOS adds hidden files
        return None
    return folder / FOLDERS[path.suffix] / path.name
