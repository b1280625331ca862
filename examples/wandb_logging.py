"""Log a training run with Weights & Biases: `pip install wandb`.

Every run also writes TensorBoard files: `tensorboard --logdir RUN`. Tested with wandb 0.31.0.
"""
# pyright: reportMissingImports=false

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal

import tyro
import wandb

from mapf_pz.rl import train
from mapf_pz.rl.presets import PRESETS


@dataclass(frozen=True)
class Example:
    """The preset of `make train`, with a custom length."""

    agent_steps: int = 1_000_000
    """Length of training in agent steps."""
    mode: Literal["offline", "online"] = "offline"
    """`offline`: the log stays in `OUTPUT/wandb` until `wandb sync`; `online`: requires `wandb login`."""
    output: Path = Path("runs/example-wandb")
    """Folder of the run."""


def main(example: Example) -> None:
    """Train, and log every row of progress by agent steps."""
    config = replace(PRESETS["quickstart"], agent_steps=example.agent_steps)
    example.output.mkdir(parents=True, exist_ok=True)
    with wandb.init(project="mapf_pz", mode=example.mode, dir=example.output, config=asdict(config)) as run:
        run.define_metric("*", step_metric="agent_steps")
        train(config, example.output, on_progress=run.log)
        print(f"{run.summary['agent_steps']:.0f} agent steps logged, CSR {run.summary['CSR']:.2f}")


if __name__ == "__main__":
    main(tyro.cli(Example))
