"""Policies with random weights."""

import dataclasses

import torch

from mapf_pz.rl.algorithms.named import algorithm_of
from mapf_pz.rl.policies.policy import SharedPolicy, TeamPolicy
from tests.helpers.small_run import TINY, changed

NUM_AGENTS = 6


def untrained(algorithm="mappo", task=None, **model):
    """Return a policy with random weights, whose actions depend much on what it observes."""
    torch.manual_seed(0)
    task = changed(TINY.task, num_agents=NUM_AGENTS, **(task or {}))
    config = dataclasses.replace(TINY, algorithm=algorithm, task=task, model=dataclasses.replace(TINY.model, **model))
    kind = algorithm_of(algorithm)
    network = kind.make_network(config)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter *= 3
    return (TeamPolicy if kind.centralized else SharedPolicy)(network, config, seed=4)
