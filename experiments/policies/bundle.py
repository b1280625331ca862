"""Copy the policy of a training run into the package: `python -m experiments.policies.bundle RUN NAME`.

Its weights are rounded to 16 bits, so that all policies of the package together stay below 10 MB. The policy's folder
also gets its card, and of the run's progress the rows with a validation. Results of an earlier policy are kept among
those of other seeds, or removed if its configuration is another one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import tyro
from tyro.conf import Positional

from experiments.policies import cards, seeds
from mapf_pz.rl import load_policy
from mapf_pz.rl.config_file import save_config
from mapf_pz.rl.policies.folder import bundled
from mapf_pz.rl.policies.load import save_weights
from mapf_pz.rl.progress import read_progress, write_progress


@dataclass(frozen=True)
class Options:
    """Which policy becomes one of the package."""

    run: Positional[Path]
    """Folder of the run."""
    name: Positional[str]
    """Name of the policy; an earlier one of this name is replaced."""


def main(options: Options) -> None:
    """Write the configuration, the rounded weights, the progress and the card."""
    policy, folder = load_policy(options.run), bundled() / options.name
    if folder.exists():
        seeds.before_bundling(options.name, policy.config)
    folder.mkdir(exist_ok=True)
    save_config(folder, policy.config)
    save_weights(folder, policy.network.half())
    rows = read_progress(options.run)
    validated = [row for row in rows[:-1] if not math.isnan(row.get("validation_return", math.nan))]
    write_progress(folder, [*validated, rows[-1]])
    cards.write(options.name)


if __name__ == "__main__":
    main(tyro.cli(Options))
