"""Copy the policy of a training run into the package: `python -m experiments.bundle RUN NAME`.

Its weights are rounded to 16 bits, so that all policies of the package together stay below 8 MB.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro
from tyro.conf import Positional

from mapf_pz.rl import load_policy
from mapf_pz.rl.config_file import save_config
from mapf_pz.rl.policies.folder import bundled
from mapf_pz.rl.policies.load import save_weights


@dataclass(frozen=True)
class Options:
    """Which policy becomes one of the package."""

    run: Positional[Path]
    """Folder of the run."""
    name: Positional[str]
    """Name of the policy; an earlier one of this name is replaced."""


def main(options: Options) -> None:
    """Write the configuration and the rounded weights."""
    policy, folder = load_policy(options.run), bundled() / options.name
    folder.mkdir(exist_ok=True)
    save_config(folder, policy.config)
    save_weights(folder, policy.network.half())


if __name__ == "__main__":
    main(tyro.cli(Options))
