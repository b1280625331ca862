"""A training run of a second, and what it wrote."""

import csv
import dataclasses

from mapf_pz.instances import MapMixture
from mapf_pz.rl.config import ModelConfig, OptimizationConfig, TaskConfig, TrainConfig
from mapf_pz.simulator.config import EnvConfig

ENV_FIELDS = {field.name for field in dataclasses.fields(EnvConfig)}
MIXTURE_FIELDS = {field.name for field in dataclasses.fields(MapMixture)}


def changed(task, **fields):
    """Return the task with other fields, of its own, its environment or its maps."""
    env = dataclasses.replace(task.env, **{name: fields.pop(name) for name in fields.keys() & ENV_FIELDS})
    mixture = dataclasses.replace(task.mixture, **{name: fields.pop(name) for name in fields.keys() & MIXTURE_FIELDS})
    return dataclasses.replace(task, env=env, mixture=mixture, **fields)


TINY = TrainConfig(
    task=changed(TaskConfig(), height=6, width=6, num_agents=3, max_steps=12, view_size=(3, 3)),
    model=ModelConfig(conv_channels=(4,), hidden=16),
    optimization=OptimizationConfig(num_envs=4, steps_per_batch=16, num_epochs=1, minibatch_size=32),
    agent_steps=576,
)
TIMINGS = {"seconds", "agent_steps_per_second", "collecting_share", "acting_share", "learning_share"}


def rows(folder):
    with (folder / "progress.csv").open() as file:
        return list(csv.DictReader(file))


def untimed(folder):
    return [{key: value for key, value in row.items() if key not in TIMINGS} for row in rows(folder)]
