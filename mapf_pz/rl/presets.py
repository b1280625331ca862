"""Training runs that have a name."""

from __future__ import annotations

from mapf_pz.rl.config import TaskConfig, TrainConfig

PRESETS: dict[str, TrainConfig] = {
    # Denser maps than those of the evaluation teach agents to make way for each other in narrow places.
    "quickstart": TrainConfig(task=TaskConfig(density=0.3), agent_steps=2_000_000),
}
"""`mapf-pz train NAME` begins from these; every field can be changed on the command line."""
