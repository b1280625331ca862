"""The command `mapf-pz policy`: share a policy on the Hugging Face Hub, and export its network to ONNX."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, subcommand

from mapf_pz.commands.evaluate import TABLE_FILE
from mapf_pz.rl.policies.card import card
from mapf_pz.rl.policies.folder import FILES, policy_folder
from mapf_pz.rl.policies.hub import push
from mapf_pz.rl.policies.load import load_policy
from mapf_pz.rl.policies.onnx_export import NUM_OBSERVATIONS, export_onnx


@dataclass(frozen=True)
class ExportOptions:
    """Write a policy's network to an ONNX file, and check its outputs."""

    policy: Positional[str]
    """Name of a policy of the package, folder of a training run, or address `hf://USER/NAME`."""
    output: Positional[Path]
    """The ONNX file."""
    trust_remote_code: bool = False
    """Whether the policy's configuration may name code outside this package, which is run."""


@dataclass(frozen=True)
class PushOptions:
    """Upload a policy, with a card, to the Hugging Face Hub."""

    policy: Positional[str]
    """Name of a policy of the package, or folder of a training run."""
    address: Positional[str]
    """Address `hf://USER/NAME`; its repository is created if necessary."""
    license: str = "MIT"
    """License of the weights, for the card."""
    private: bool = False
    """Whether a new repository is private."""


@dataclass(frozen=True)
class PullOptions:
    """Copy a policy from the Hugging Face Hub to a folder. Commands and `load_policy` also take the address."""

    address: Positional[str]
    """Address `hf://USER/NAME`, optionally followed by `@REVISION`."""
    output: Positional[Path]
    """Folder to copy to; it must not exist."""


def policy(
    task: Annotated[ExportOptions, subcommand("export")]
    | Annotated[PushOptions, subcommand("push")]
    | Annotated[PullOptions, subcommand("pull")],
) -> None:
    """Share a policy on the Hugging Face Hub, or export its network to ONNX."""
    match task:
        case ExportOptions():
            _export(task)
        case PushOptions():
            _push(task)
        case PullOptions():
            _pull(task)


def _export(options: ExportOptions) -> None:
    loaded = load_policy(options.policy, trust_remote_code=options.trust_remote_code)
    exported = export_onnx(loaded, options.output)
    for kind, shapes in (("input", exported.inputs), ("output", exported.outputs)):
        for name, shape in shapes.items():
            print(f"{kind} {name}: ({', '.join(map(str, shape))})")
    print(
        f"{options.output}: {options.output.stat().st_size} bytes; outputs differ by at most {exported.difference:.2g} "
        f"in {NUM_OBSERVATIONS} observations"
    )


def _push(options: PushOptions) -> None:
    folder = policy_folder(options.policy)
    files = {name: (folder / name).read_bytes() for name in FILES if (folder / name).exists()}
    table = folder / TABLE_FILE
    results = table.read_text("utf-8") if table.exists() else ""
    text = card(options.policy, options.address, options.license, results)
    print(push(options.address, files | {"README.md": text.encode()}, options.private))


def _pull(options: PullOptions) -> None:
    if options.output.exists():
        raise FileExistsError(f"{str(options.output)!r} exists already")
    folder = policy_folder(options.address)
    load_policy(folder)  # before anything is written
    shutil.copytree(folder, options.output)
    print(f"{options.output}: the policy of {options.address}")
