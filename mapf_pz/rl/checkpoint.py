"""Checkpoints: the files that a training run can be continued from, the last two and the best.

A file is TorchRL's archive, a zip with a manifest, of safetensors and JSON; nothing in it is pickled, and none is
unpickled. A checkpoint appears under its name only when it is complete, and the archive's checksums tell damage.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any
from zipfile import ZIP_STORED, BadZipFile, ZipFile

from pydantic import TypeAdapter
from safetensors import SafetensorError
from safetensors.torch import load_file, save
from torchrl.checkpoint import Checkpoint, CheckpointAdapter, CheckpointRotation

from mapf_pz.errors import FormatError
from mapf_pz.rl.learner import Learner

FOLDER, PREFIX, TENSORS = "checkpoints", "checkpoint", "learner.safetensors"
_DAMAGE = (
    *(BadZipFile, SafetensorError, IsADirectoryError, EOFError),
    *(RuntimeError, ValueError, TypeError, LookupError, AttributeError, OverflowError),
)


@dataclass(frozen=True)
class Position:
    """How far a run has come."""

    updates: int
    """Updates done, and rows of progress written."""
    agent_steps: int
    """Steps of all agents together."""
    score: float
    """Mean CSR, or throughput of lifelong episodes, over the latest training episodes; the highest is the best."""


class Checkpoints:
    """The checkpoints in a run's folder."""

    def __init__(self, run: Path) -> None:
        """Refer to the checkpoints of the run in the folder `run`; there may be none yet."""
        self.folder = run / FOLDER
        self._rotation = CheckpointRotation(self.folder, keep_last=2, keep_best=("score", "max"), prefix=PREFIX)

    def latest(self) -> Path:
        """Return the newest checkpoint; raises `FileNotFoundError` where there is none."""
        files = sorted(self.folder.glob(f"{PREFIX}-*"))
        if not files:
            raise FileNotFoundError(f"no checkpoint in {str(self.folder)!r}: train again, with --overwrite")
        return files[-1]

    def save(self, learner: Learner, position: Position) -> None:
        """Write a checkpoint, and remove those that are neither among the last two nor the best."""
        self._rotation.save(_archive(learner), step=position.agent_steps, metadata=asdict(position))

    def sweep(self) -> None:
        """Remove what a process that was killed while it wrote has left; such files never count as checkpoints."""
        _remove(self.folder.glob(f".{PREFIX}-*"))

    def clear(self) -> None:
        """Remove all checkpoints."""
        self.sweep()
        _remove(self.folder.glob(f"{PREFIX}-*"))


def read_position(file: Path) -> Position:
    """Return how far the run had come; raises `FormatError` where the file is no checkpoint."""
    try:
        _check_stored(file)
        return TypeAdapter(Position).validate_python(Checkpoint.manifest(file)["metadata"])
    except _DAMAGE as error:
        raise _refusal(file, error) from None


def restore(file: Path, learner: Learner) -> None:
    """Bring the learner to where it was; raises `FormatError` where the file is damaged or of other networks."""
    try:
        _check_stored(file)
        _archive(learner).load(file)
    except _DAMAGE as error:
        raise _refusal(file, error) from None


class _LearnerAdapter(CheckpointAdapter):
    """Writes a learner as safetensors: TorchRL's own adapters may unpickle what they read."""

    adapter_id = "mapf_pz.learner"

    def save(self, component: Learner, path: Path, *, args: tuple[Any, ...], kwargs: Mapping[str, Any]) -> None:
        path.mkdir(parents=True)
        (path / TENSORS).write_bytes(save(component.tensors()))

    def load(self, component: Learner, path: Path, **_: Any) -> None:
        component.restore(load_file(path / TENSORS))


def _check_stored(file: Path) -> None:
    """Raise `ValueError` for an archive of compressed files, which could be of any size, or of files outside itself."""
    with ZipFile(file) as archive:
        if any(member.compress_type != ZIP_STORED or member.header_offset < 0 for member in archive.infolist()):
            raise ValueError("expected an archive of files that are stored in it as they are")


def _archive(learner: Learner) -> Checkpoint:
    checkpoint = Checkpoint(format="archive")
    checkpoint.register("learner", learner, adapter=_LearnerAdapter())
    return checkpoint


def _refusal(file: Path, error: Exception) -> FormatError:
    reason = " ".join(str(error).split())[:200]
    return FormatError(file, f"not a checkpoint of this run; delete it to continue from the one before: {reason}")


def _remove(paths: Iterable[Path]) -> None:
    for path in paths:
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink()
