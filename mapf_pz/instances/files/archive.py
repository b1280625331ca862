"""The zip files of the MovingAI benchmark, and the extraction of their maps and scenarios."""

from __future__ import annotations

import shutil
import stat
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from mapf_pz._internal.atomic import replacing
from mapf_pz.errors import FormatError

FOLDERS = {".map": "maps", ".scen": "scens"}
"""Target folders by file extension; other files are not extracted."""
MAX_MEMBERS = 10_000
"""Maximum number of files in an archive; larger archives are rejected."""
MAX_BYTES = 2**30
"""Maximum unpacked size of an archive; larger archives are rejected."""


@dataclass(frozen=True)
class Archive:
    """A zip file on a server."""

    url: str
    """The address of the file."""
    sha256: str
    """The SHA-256 checksum, in hexadecimal digits."""

    @property
    def name(self) -> str:
        """The file name: the last part of the address."""
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
MAPS = (
    *("Berlin_1_256", "Boston_0_256", "Paris_1_256", "brc202d", "den312d", "den520d", "empty-16-16", "empty-32-32"),
    *("empty-48-48", "empty-8-8", "ht_chantry", "ht_mansion_n", "lak303d", "lt_gallowstemplar_n", "maze-128-128-1"),
    *("maze-128-128-10", "maze-128-128-2", "maze-32-32-2", "maze-32-32-4", "orz900d", "ost003d", "random-32-32-10"),
    *("random-32-32-20", "random-64-64-10", "random-64-64-20", "room-32-32-4", "room-64-64-16", "room-64-64-8"),
    *("w_woundedcoast", "warehouse-10-20-10-2-1", "warehouse-10-20-10-2-2", "warehouse-20-40-10-2-1"),
    "warehouse-20-40-10-2-2",
)
"""The names of the benchmark's maps."""


def unpack(file: Path, folder: Path) -> int:
    """Extract maps and scenarios from a zip file, and return the number of files written.

    They are written to `folder/maps` and `folder/scens`, without their folders in the archive. Existing files of the
    same size are not overwritten.

    Raises:
        OSError: The archive cannot be read, or a file cannot be written.
        FormatError: The file is not a zip file or is damaged, contains a link or a path that leads out of the folder,
            has more than `MAX_MEMBERS` files, or unpacks to more than `MAX_BYTES`.
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
                # In chunks: a member that is larger than it claims must not fill the memory.
                with archive.open(member) as source, replacing(target) as temporary, temporary.open("wb") as sink:
                    shutil.copyfileobj(source, sink)
                written += 1
    except (zipfile.BadZipFile, zlib.error, EOFError) as error:
        raise FormatError(file, f"expected a valid zip file: {error}") from None
    return written


def _check(members: list[zipfile.ZipInfo], file: Path) -> None:
    """Raise `FormatError` for an archive that could be malicious."""
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
    """Return the target path of a member; None if it is neither a map nor a scenario."""
    path = PurePosixPath(member.filename)
    if member.is_dir() or path.name.startswith(".") or path.suffix not in FOLDERS:  # macOS adds hidden files
        return None
    return folder / FOLDERS[path.suffix] / path.name
