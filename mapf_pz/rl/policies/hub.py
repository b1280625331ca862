"""Policies on the Hugging Face Hub. Requires huggingface_hub: `mapf-pz[hub]`."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType

PREFIX = "hf://"
"""The beginning of an address on the Hub."""
_ADDRESS = re.compile(PREFIX + r"([\w.-]+/[\w.-]+)(?:@([\w./-]+))?")


def is_address(policy: str) -> bool:
    """Return whether this is an address on the Hub: `hf://USER/NAME`, optionally followed by `@REVISION`."""
    return _ADDRESS.fullmatch(policy) is not None


def pull(address: str, files: Sequence[str]) -> Path:
    """Download those of `files` that exist at an address, and return their folder, which is in the Hub's cache.

    Raises `ValueError` for an address that is not valid, `ImportError` without huggingface_hub, and `OSError` if the
    download fails.
    """
    repository, revision = _parts(address)
    return Path(_hub().snapshot_download(repository, revision=revision, allow_patterns=list(files)))


def push(address: str, files: Mapping[str, bytes], private: bool = False) -> str:
    """Write files, by name, to an address, whose repository is created if necessary; return the page of the commit.

    Raises `ValueError` for an address that is not valid, `ImportError` without huggingface_hub, and `OSError` if the
    upload fails.
    """
    repository, revision = _parts(address)
    api = _hub().HfApi()
    api.create_repo(repository, private=private, exist_ok=True)
    with TemporaryDirectory() as folder:
        for name, content in files.items():
            (Path(folder) / name).write_bytes(content)
        return str(api.upload_folder(repo_id=repository, folder_path=folder, revision=revision).commit_url)


def _parts(address: str) -> tuple[str, str | None]:
    """Return the repository and the revision of an address."""
    found = _ADDRESS.fullmatch(address)
    if found is None:
        raise ValueError(f"{address!r}: expected {PREFIX}USER/NAME or {PREFIX}USER/NAME@REVISION")
    return found[1], found[2]


def _hub() -> ModuleType:
    try:
        import huggingface_hub
    except ImportError as error:
        raise ImportError("policies on the Hub require huggingface_hub: pip install 'mapf-pz[hub]'") from error
    return huggingface_hub
