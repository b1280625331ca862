"""The folders that the page may read and write."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from mapf_pz._internal.atomic import write_whole
from mapf_pz._internal.text import read_text
from mapf_pz.editor.requests import Refusal

SUFFIXES = (".map", ".scen", ".json", ".svg", ".txt", ".csv")
"""Extensions of files that may be written."""


class Folders:
    """The only folders that files are read from and written to. Symbolic links are resolved first.

    Raises `NotADirectoryError` for a path that is not a folder.
    """

    def __init__(self, paths: Iterable[Path]) -> None:
        """Create the list of folders; each includes the folders below it."""
        self.paths = list(dict.fromkeys(_resolved(path) for path in paths))
        """The folders: absolute paths."""
        for path in self.paths:
            if not path.is_dir():
                raise NotADirectoryError(f"{path}: expected a folder")

    def inside(self, path: str | Path) -> Path:
        """Return the resolved path; raises `Refusal` unless it is one of the folders or inside one."""
        if "\0" in str(path):
            raise Refusal(400, f"expected a path without null characters, got {str(path)!r}")
        resolved = _resolved(path)
        if not any(resolved.is_relative_to(folder) for folder in self.paths):
            raise Refusal(403, f"{path}: expected a path inside {' or '.join(map(str, self.paths))}")
        return resolved

    def entries(self, path: str) -> dict[str, Any]:
        """Return the files and folders in a folder, sorted by name, as the response to `list`.

        Links that lead out of the folders, and what is neither a file nor a folder, are omitted. Raises `Refusal` for a
        path outside the folders, and `OSError` unless it is a folder that can be read.
        """
        folder = self.inside(path)
        entries: list[dict[str, Any]] = []
        for entry in sorted(folder.iterdir()):
            target = _resolved(entry)
            if any(target.is_relative_to(allowed) for allowed in self.paths) and (target.is_dir() or target.is_file()):
                size = 0 if target.is_dir() else target.stat().st_size
                entries.append({"name": entry.name, "folder": target.is_dir(), "size": size})
        return {"path": str(folder), "entries": entries}

    def read(self, path: str) -> dict[str, Any]:
        """Return the name and the text of a file; raises `Refusal` outside the folders, and as `read_text`."""
        return {"name": Path(path).name, "text": read_text(self.inside(path))}

    def save(self, path: str, text: str, overwrite: bool) -> dict[str, Any]:
        """Write a file atomically.

        Raises:
            Refusal: the path is outside the folders, has an extension other than `SUFFIXES`, exists and is not a file,
                or exists without `overwrite` (status 409).
            OSError: the file cannot be written, or its folder does not exist.
        """
        file = self.inside(path)
        if file.suffix.lower() not in SUFFIXES:
            raise Refusal(400, f"{path}: expected a file name that ends in {', '.join(SUFFIXES)}")
        if not file.parent.is_dir():
            raise FileNotFoundError(f"{file.parent}: no such folder")
        if file.exists() and not file.is_file():
            raise Refusal(400, f"{path}: expected a file, got a folder or device")
        if file.exists() and not overwrite:
            raise Refusal(409, f"{path}: the file exists", exists=True)
        write_whole(file, text.encode())
        return {"path": str(file)}


def _resolved(path: str | Path) -> Path:
    """Return the absolute path without symbolic links and `..`."""
    return Path(os.path.realpath(path))
