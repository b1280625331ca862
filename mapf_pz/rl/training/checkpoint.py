"""Checkpoints: the files that a training run can be resumed from. The last two and the best are kept.

A checkpoint is a TorchRL archive, a zip file with a manifest, that contains safetensors and JSON; nothing is pickled or
unpickled. Writes are atomic, and the archive's checksums detect damage.
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
from mapf_pz.rl.algorithms.learner import Learner

FOLDER, PREFIX, TENSORS = "checkpoints", "checkpoint", "learner.safetensors"
_DAMAGE = (
    *(BadZipFile, SafetensorError, IsADirectoryError, EOFError),
    *(RuntimeError, ValueError, TypeError, LookupError, AttributeError, OverflowError),
)


@dataclass(frozen=True)
class Position:
    """The progress of a run at a checkpoint."""

    updates: int
    """Number of completed updates, and of rows in the progress file."""
    agent_steps: int
    """Total number of steps of all agents."""
    score: float
    """Mean CSR, or throughput of lifelong episodes, of the latest training episodes; without any (`bc`), of the latest
    validation; 0 before the first one. The newest of equal checkpoints is the best."""
    inputs: str = ""
    """The digest of the files that the run reads, `inputs_digest`; empty in checkpoints of earlier versions."""


class Checkpoints:
    """The checkpoints in a run's folder."""

    def __init__(self, run: Path) -> None:
        """Refer to the checkpoints of the run in the folder `run`; there may be none yet."""
        self.folder = run / FOLDER
        self._rotation = CheckpointRotation(self.folder, keep_last=2, keep_best=("score", "max"), prefix=PREFIX)

    def latest(self) -> Path:
        """Return the newest checkpoint; raises `FileNotFoundError` if there is none."""
        files = sorted(self.folder.glob(f"{PREFIX}-*"))
        if not files:
            raise FileNotFoundError(f"no checkpoint in {str(self.folder)!r}: train again, with --overwrite")
        return files[-1]

    def save(self, learner: Learner, position: Position) -> None:
        """Write a checkpoint, and remove those that are neither among the last two nor the best."""
        self._rotation.save(_archive(learner), step=position.agent_steps, metadata=asdict(position))

    def sweep(self) -> None:
        """Remove the temporary files of processes killed while writing; these never count as checkpoints."""
        _remove(self.folder.glob(f".{PREFIX}-*"))

    def clear(self) -> None:
        """Remove all checkpoints."""
        self.sweep()
        _remove(self.folder.glob(f"{PREFIX}-*"))


def read_position(file: Path) -> Position:
    """Return the progress of the run; raises `FormatError` if the file is not a checkpoint."""
    try:
        _check_stored(file)
        return TypeAdapter(Position).validate_python(Checkpoint.manifest(file)["metadata"])
    except _DAMAGE as error:
        raise _refusal(file, error) from None


def restore(file: Path, learner: Learner) -> None:
    """Restore the learner's state; raises `FormatError` if the file is damaged or belongs to other networks."""
    try:
        _check_stored(file)
        _archive(learner).load(file)
    except _DAMAGE as error:
        raise _refusal(file, error) from None


class _LearnerAdapter(CheckpointAdapter):
    """Saves a learner as safetensors; TorchRL's adapters may unpickle the files that they load."""

    adapter_id = "mapf_pz.learner"

    def save(self, component: Learner, path: Path, *, args: tuple[Any, ...], kwargs: Mapping[str, Any]) -> None:
        path.mkdir(parents=True)
        (path / TENSORS).write_bytes(save(component.tensors()))

    def load(self, component: Learner, path: Path, **_: Any) -> None:
        tensors = load_file(path / TENSORS)
        if not any(name.startswith("optimizer/") for name in tensors):
            raise ValueError("expected the state of the optimizer")
        component.restore(tensors)


def _check_stored(file: Path) -> None:
    """Raise `ValueError` for compressed members, which could expand to any size, or members outside the archive."""
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
