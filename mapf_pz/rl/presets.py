"""Training runs that have a name."""

from __future__ import annotations

from mapf_pz.rl.config import TrainConfig

PRESETS: dict[str, TrainConfig] = {
    "quickstart": TrainConfig(agent_steps=1_000_000),
}
"""`mapf-pz train NAME` begins from these; every field can be changed on the command line."""
