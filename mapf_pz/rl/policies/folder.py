"""The folders of trained policies: those of the package, of training runs, and on the Hugging Face Hub.

It does not import torch.
"""

from __future__ import annotations

from importlib import resources
from pathlib import Path

from mapf_pz.rl.config_file import CONFIG_FILES
from mapf_pz.rl.policies.hub import PREFIX, is_address, pull

WEIGHTS = "policy.safetensors"
"""The file of a policy's weights in its folder."""
FILES = (*CONFIG_FILES, WEIGHTS)
"""All files that a policy may consist of."""


def policy_names() -> list[str]:
    """Return the names of the bundled policies, sorted."""
    return sorted(folder.name for folder in bundled().iterdir() if folder.is_dir())


def bundled() -> Path:
    """Return the folder of the policies of the package."""
    return Path(str(resources.files("mapf_pz"))) / "rl" / "policies" / "bundled"


def is_policy(policy: str) -> bool:
    """Return whether there is a policy of this name, a file or folder, or if it is an address on the Hub."""
    return policy in policy_names() or is_address(policy) or (policy != "" and Path(policy).exists())


def policy_folder(policy: str | Path) -> Path:
    """Return the folder of a trained policy, which may not exist.

    Args:
        policy: one of `policy_names()`, the folder of a training run, the weights file in it, or an address
            `hf://USER/NAME` on the Hugging Face Hub, optionally followed by `@REVISION`, from which the policy is
            downloaded to the cache unless it is there.

    Raises `ImportError` without `huggingface_hub`, and `OSError` if the download fails.
    """
    if isinstance(policy, str) and policy.startswith(PREFIX):
        return pull(policy, FILES)
    folder = bundled() / policy if policy in policy_names() else Path(policy)
    return folder.parent if folder.suffix == ".safetensors" else folder
