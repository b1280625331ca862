"""Presets: named training configurations. Each bundled policy was trained with the preset of the same name."""

from __future__ import annotations

from dataclasses import replace

from mapf_pz.instances.mixture import MapMixture
from mapf_pz.rl.config import (
    TRAINING_ENV,
    ImitationConfig,
    ModelConfig,
    OptimizationConfig,
    PPOConfig,
    TaskConfig,
    TrainConfig,
)
from mapf_pz.simulator.config import REWARDS, EnvConfig

# Maps that are denser than in the evaluation teach agents to give way to each other in narrow passages.
_QUICKSTART = TrainConfig(
    task=TaskConfig(mixture=MapMixture(density=0.3)),
    optimization=OptimizationConfig(num_epochs=2),
    agent_steps=2_000_000,
    precision="auto",
)

_CROWD = TrainConfig(
    task=TaskConfig(
        env=replace(TRAINING_ENV, num_agents=32, max_steps=160),
        mixture=MapMixture(height=20, width=20, density=0.2),
    ),
    optimization=OptimizationConfig(num_envs=32, minibatch_size=128),
    agent_steps=3_000_000,
)

# The report's policy: two convolutions and a linear layer to 128 features, then 2 x 64 for policy and value. Early in
# training, the other agents' rewards are mostly noise, so `share` is half of its value in the reward `progress`.
_CENTRAL = TrainConfig(
    task=TaskConfig(
        env=replace(
            TRAINING_ENV,
            num_agents=4,
            max_steps=64,
            view_size=(5, 5),
            reward=replace(REWARDS["progress"], share=1.0),
        ),
        mixture=MapMixture(height=8, width=8, density=0.1),
    ),
    algorithm="central-ppo",
    model=ModelConfig(encoder="report", conv_channels=(32, 64), hidden=128, head=(64, 64)),
    optimization=OptimizationConfig(num_epochs=6, minibatch_size=512, learning_rate=5e-4),
    ppo=PPOConfig(entropy_coeff=0.0),
    agent_steps=2_000_000,
)

# Close to the report's experiment: its observations, its rewards, except that a blocked forward move earns nothing, and
# its network (Figures 4 and 5), on another warehouse. `docs/explanation/report.md` lists how the authors' runs differ.
_REPORT = TrainConfig(
    task=TaskConfig(
        env=EnvConfig(
            map="warehouse-10-20-10-2-1",
            num_agents=10,
            max_steps=256,
            view_size=(20, 20),
            edge_weights="random",
            reward="report",
        )
    ),
    algorithm="central-ppo",
    model=ModelConfig(encoder="report", conv_channels=(32, 64), hidden=128, head=(64, 64)),
    optimization=OptimizationConfig(
        num_envs=8, steps_per_batch=64, minibatch_size=128, learning_rate=2.5e-4, max_grad_norm=5.0
    ),
    ppo=PPOConfig(gamma=0.9999, entropy_coeff=0.0, critic_coeff=0.19, credit="team"),
    agent_steps=5_000_000,
    validation_interval=500_000,
    validation_episodes=32,
)

# What the report's policy needs to route its agents, with its map, agents, channels, networks and action matrix. Agents
# that follow their cost to go get stuck at others that have reached their goals in an aisle, so it leads around these.
# With a high discount factor, the advantages of ten agents that share one network are too noisy.
_REPORT_REPAIRED = replace(
    _REPORT,
    task=TaskConfig(
        env=replace(
            _REPORT.task.env,
            max_steps=400,
            view="centered",
            channels=(*_REPORT.task.env.channels, "cost_to_go", "others_next", "others_at_goal"),
            features=("action_advantage", "last_actions", "goal_vector", "location"),
            edge_weights="warehouse-10-20-10-2-1-400",
            around_agents_at_goals=True,
            reward=replace(REWARDS["progress"], step_cost=0.2),
        )
    ),
    model=replace(_REPORT.model, activation="gelu"),
    optimization=replace(_REPORT.optimization, num_envs=16, minibatch_size=64, learning_rate=7e-4, max_grad_norm=0.5),
    ppo=replace(_REPORT.ppo, gamma=0.9, lmbda=0.9, entropy_coeff=0.003, credit="agent"),
    agent_steps=2_000_000,
    validation_interval=200_000,
)

# The problem of the authors' runs, their episodes and the settings of their PPO, with this package's environment; their
# exploration is another, which depends on the state.
_REPORT_PUBLISHED = replace(
    _REPORT,
    task=TaskConfig(
        env=replace(_REPORT.task.env, map=None, scenario="warehouse_small_10", max_steps=1000),
        action_mode="affine",
    ),
    model=replace(_REPORT.model, activation="gelu"),
    optimization=replace(_REPORT.optimization, steps_per_batch=512, num_epochs=10, final_learning_rate=1.0),
)

# A centralized policy for any number of agents. The run continues from an imitated policy: see
# `policies/bundled/README.md`.
_CENTRAL_TEAM = TrainConfig(
    task=TaskConfig(
        env=replace(
            _CENTRAL.task.env,
            num_agents=16,
            max_steps=96,
            view_size=(7, 7),
            features=("action_advantage", "last_actions", "goal_vector", "pose"),
        ),
        mixture=MapMixture(height=(10, 14), width=(10, 14), density=(0.1, 0.2)),
    ),
    algorithm="central-ppo",
    model=ModelConfig(conv_channels=(32, 32), communication=2),
    optimization=OptimizationConfig(num_envs=32, num_epochs=2, minibatch_size=128, learning_rate=3e-4),
    ppo=replace(_CENTRAL.ppo, warmup_updates=3),
    initial_temperature=0.5,
    agent_steps=600_000,
    validation_interval=200_000,
)

# Imitation of windowed planning, with more agents per free cell than in most evaluations. Agents exchange embeddings
# with those near them, and learn without the safety layer, so that they meet their own conflicts. The costs of
# `crisscross:0.7` spread them over the aisles of a warehouse, and cost little elsewhere.
_LIFELONG_CARDINAL = TrainConfig(
    task=TaskConfig(
        env=EnvConfig(
            num_agents=48,
            max_steps=256,
            action_model="cardinal",
            on_target="restart",
            view_size=(9, 9),
            view="centered",
            channels=(
                *("view", "goal", "cost_to_go", "heuristic"),
                *("others_next", "others_heuristic", "other_goals"),
            ),
            features=("action_advantage", "last_actions", "goal_vector", "pose"),
            num_last_actions=2,
            edge_weights="crisscross:0.7",
            reward=REWARDS["progress"],
        ),
        mixture=MapMixture(
            maps=("primal2", "primal2", "random", "random", "warehouse"),
            height=(17, 21),
            width=(17, 21),
            density=(0.1, 0.3),
            loops=(0.3, 0.95),
        ),
    ),
    algorithm="dagger",
    model=ModelConfig(conv_channels=(48, 48), hidden=192, communication=2, communication_radius=5),
    optimization=OptimizationConfig(
        num_envs=32, steps_per_batch=16, num_epochs=2, minibatch_size=16, learning_rate=2e-3
    ),
    imitation=ImitationConfig(expert="windowed:rounds=2,window=12", temperature=0.3, augment=True),
    agent_steps=12_000_000,
    checkpoint_interval=800_000,
    validation_interval=800_000,
    validation_episodes=32,
    precision="auto",
)

# Agents that turn, on small and on larger maps.
_LIFELONG = replace(
    _LIFELONG_CARDINAL,
    task=replace(
        _LIFELONG_CARDINAL.task,
        env=replace(
            _LIFELONG_CARDINAL.task.env,
            action_model="rotate",
            channels=("view", "goal", "orientation", *_LIFELONG_CARDINAL.task.env.channels[2:]),
        ),
        mixture=replace(_LIFELONG_CARDINAL.task.mixture, height=(17, 28), width=(17, 28)),
    ),
    agent_steps=6_000_000,
    checkpoint_interval=400_000,
)

# Imitation of LaCAM, which plans from states that the policy has reached. In short segments, more of the labeled states
# have the policy's own actions in their past: see `docs/explanation/imitation.md`.
_LACAM = ImitationConfig(
    expert="lacam:time_limit=0.1,clock=work", expert_share=0.3, segment_steps=4, temperature=0.5, augment=True
)
_ONE_ROUND = replace(
    _LIFELONG_CARDINAL,
    task=replace(
        _LIFELONG_CARDINAL.task,
        env=replace(_LIFELONG_CARDINAL.task.env, max_steps=128, on_target="nothing", edge_weights="uniform"),
        mixture=replace(
            _LIFELONG_CARDINAL.task.mixture,
            maps=("primal2", "primal2", "primal2", "primal2", "random"),
            height=(17, 32),
            width=(17, 32),
            wall_density=(0.2, 0.4),
        ),
    ),
    optimization=replace(_LIFELONG_CARDINAL.optimization, steps_per_batch=32),
    imitation=_LACAM,
    agent_steps=11_000_000,
)

# Agents decide in rounds, so that of those in conflict not all go, or all wait. In plans, waits follow waits, and a
# policy that sees this in its last actions waits forever; so it often learns without them. The run continues from one
# with one round: see `policies/bundled/README.md`.
_ONESHOT_CARDINAL = replace(
    _ONE_ROUND,
    model=replace(_ONE_ROUND.model, decision_rounds=4),
    optimization=replace(_ONE_ROUND.optimization, learning_rate=1e-3),
    imitation=replace(_LACAM, history_dropout=0.25),
    agent_steps=3_000_000,
    checkpoint_interval=500_000,
    validation_interval=1_000_000,
)

# Agents that turn, with one round.
_ONESHOT = replace(
    _ONE_ROUND,
    task=replace(
        _ONE_ROUND.task,
        env=replace(
            _ONE_ROUND.task.env,
            max_steps=256,
            action_model="rotate",
            channels=_LIFELONG.task.env.channels,
        ),
        mixture=replace(
            _ONE_ROUND.task.mixture,
            maps=("primal2", "primal2", "random", "random", "warehouse"),
            height=(17, 28),
            width=(17, 28),
        ),
    ),
    imitation=replace(_LACAM, history_dropout=0.25),
    agent_steps=5_000_000,
    checkpoint_interval=500_000,
    validation_interval=1_000_000,
)

# Imitation of LaCAM by one policy for all agents, without the safety layer, in crowded warehouses with aisles of one
# cell. The costs of `crisscross` make them one-way. The run continues from another: see `policies/bundled/README.md`.
_CENTRAL_WAREHOUSE = replace(
    _ONESHOT,
    task=replace(
        _ONESHOT.task,
        env=replace(_ONESHOT.task.env, num_agents=64, edge_weights="crisscross"),
        mixture=replace(
            _ONESHOT.task.mixture,
            maps=("warehouse", "warehouse", "warehouse", "random"),
            height=(20, 34),
            width=(26, 46),
            shelf_length=(5, 10),
            density=(0.1, 0.25),
        ),
    ),
    model=replace(_ONESHOT.model, communication_radius=None),
    optimization=replace(_ONESHOT.optimization, num_envs=16, num_epochs=1, minibatch_size=12, learning_rate=1e-3),
    imitation=replace(_LACAM, expert_share=0.5, segment_steps=32, augment=False),
    agent_steps=1_500_000,
    validation_interval=750_000,
    validation_episodes=16,
    precision="float32",
)

PRESETS: dict[str, TrainConfig] = {
    "quickstart": _QUICKSTART,
    "mappo": _CROWD,
    "ippo": replace(_CROWD, algorithm="ippo"),
    "mappo-cardinal": replace(_CROWD, task=replace(_CROWD.task, env=replace(_CROWD.task.env, action_model="cardinal"))),
    "central-ppo": _CENTRAL,
    "central-ppo-8": replace(
        _CENTRAL,
        task=replace(
            _CENTRAL.task,
            env=replace(_CENTRAL.task.env, num_agents=8),
            mixture=MapMixture(height=10, width=10, density=0.1),
        ),
        model=ModelConfig(encoder="report", conv_channels=(64, 64), hidden=384, head=(192,)),
        optimization=replace(_CENTRAL.optimization, learning_rate=7e-4, num_epochs=4),
        agent_steps=8_000_000,
    ),
    "central": _CENTRAL_TEAM,
    "central-warehouse": _CENTRAL_WAREHOUSE,
    "report": _REPORT,
    "report-repaired": _REPORT_REPAIRED,
    "report-published": _REPORT_PUBLISHED,
    "lifelong": _LIFELONG,
    "lifelong-cardinal": _LIFELONG_CARDINAL,
    "oneshot": _ONESHOT,
    "oneshot-cardinal": _ONESHOT_CARDINAL,
    "oneshot-cardinal-one-round": _ONE_ROUND,
}
"""The presets of `mapf-pz train NAME`; every field can be changed on the command line."""

SUMMARIES = {
    "quickstart": "A first policy within minutes: MAPPO, 8 agents on small maps with obstacles.",
    "mappo": "MAPPO, 32 agents on maps with obstacles; the critic observes the team.",
    "ippo": "The same with IPPO; the critic observes what the agent observes.",
    "mappo-cardinal": "MAPPO with agents that move in four directions and do not turn.",
    "central-ppo": "The report's centralized policy, 4 agents, with observations and rewards that it learns from.",
    "central-ppo-8": "The same with 8 agents and larger networks.",
    "central": "A centralized policy with communication, for any number of agents.",
    "central-warehouse": "The same for crowded warehouses: imitation of LaCAM with the costs of a guidance graph.",
    "report": "The report's experiment: its map, observations, rewards and networks.",
    "report-repaired": "The same with observations, a reward and a training that let its policy route the agents.",
    "report-published": "The problem and the settings of the runs that the report's authors published.",
    "lifelong": "Imitation of windowed planning in lifelong episodes, agents that turn.",
    "lifelong-cardinal": "Imitation of windowed planning in lifelong episodes, cardinal actions.",
    "oneshot": "Imitation of LaCAM in episodes with one goal per agent, agents that turn.",
    "oneshot-cardinal": "Imitation of LaCAM in episodes with one goal per agent, cardinal actions, decision rounds.",
    "oneshot-cardinal-one-round": "The same with one decision round: the policy that `oneshot-cardinal` starts from.",
}
"""A sentence about each preset."""
