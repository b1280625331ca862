"""Training runs that have a name."""

from __future__ import annotations

from mapf_pz.rl.config import ModelConfig, PPOConfig, TaskConfig, TrainConfig

PRESETS: dict[str, TrainConfig] = {
    # Denser maps than those of the evaluation teach agents to make way for each other in narrow places.
    "quickstart": TrainConfig(task=TaskConfig(density=0.3), agent_steps=2_000_000),
    # The report's policy: two convolutions and a linear layer to 128 features, then 2 x 64 for policy and value.
    "central-ppo": TrainConfig(
        task=TaskConfig(height=8, width=8, density=0.1, num_agents=4, max_steps=64, view_size=(5, 5)),
        algorithm="central-ppo",
        model=ModelConfig(conv_channels=(32, 64), hidden=128, head=(64, 64)),
        ppo=PPOConfig(learning_rate=5e-4, num_epochs=6, minibatch_size=512, entropy_coeff=0.0),
        agent_steps=4_000_000,
    ),
}
"""`mapf-pz train NAME` begins from these; every field can be changed on the command line."""
