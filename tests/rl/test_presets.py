"""The runs that have a name are those whose results are published."""

from dataclasses import replace

import pytest
import torch
from torch import nn

from mapf_pz import parallel_env
from mapf_pz.instances import load_problem
from mapf_pz.rl.algorithms.named import ALGORITHMS
from mapf_pz.rl.config import TrainConfig
from mapf_pz.rl.presets import PRESETS, SUMMARIES


def described(config):
    """Return the agents, maps, episodes, networks, optimization and length of a run."""
    task, model, optimization = config.task, config.model, config.optimization
    return (
        (
            task.num_agents,
            task.mixture.height,
            task.mixture.width,
            task.mixture.density,
            task.env.max_steps,
            task.env.view_size,
        ),
        (model.encoder, model.conv_channels, model.hidden, model.head),
        (
            optimization.num_envs,
            optimization.steps_per_batch,
            optimization.num_epochs,
            optimization.minibatch_size,
            optimization.learning_rate,
            config.ppo.entropy_coeff,
        ),
        config.agent_steps,
    )


CONV, CONV_PPO = ("conv", (16,), 128, (128,)), (64, 32, 4, 256, 7e-4, 0.01)


def test_no_preset_learns_with_a_precision_that_the_machine_emulates():
    assert {config.precision for config in PRESETS.values()} == {"auto", "float32"}


def test_the_default_run():
    assert described(TrainConfig()) == ((8, 12, 12, 0.15, 96, (7, 7)), CONV, CONV_PPO, 2_000_000)


# The presets whose policies come with the package are compared with those in test_policies.py.
@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("quickstart", ((8, 12, 12, 0.3, 96, (7, 7)), CONV, (64, 32, 2, 256, 7e-4, 0.01), 2_000_000)),
        (
            "central-ppo-8",  # docs/benchmark.md
            (
                (8, 10, 10, 0.1, 64, (5, 5)),
                ("report", (64, 64), 384, (192,)),
                (64, 32, 4, 512, 7e-4, 0.0),
                8_000_000,
            ),
        ),
        (
            "oneshot-cardinal-one-round",  # mapf_pz/rl/policies/bundled/README.md
            (
                (48, (17, 32), (17, 32), (0.1, 0.3), 128, (9, 9)),
                ("conv", (48, 48), 192, (128,)),
                (32, 32, 2, 16, 2e-3, 0.01),
                11_000_000,
            ),
        ),
    ],
)
def test_presets_without_a_bundled_policy(name, expected):
    assert described(PRESETS[name]) == expected


def test_every_preset_is_summarized_on_the_command_line():
    assert list(SUMMARIES) == list(PRESETS)


def test_the_repaired_report_keeps_what_the_report_has():
    report, repaired = PRESETS["report"], PRESETS["report-repaired"]
    kept = ("map", "num_agents", "action_model", "view_size", "on_target", "collision_system")
    assert [getattr(repaired.task.env, name) for name in kept] == [getattr(report.task.env, name) for name in kept]
    assert repaired.task.env.channels[:4] == report.task.env.channels == ("view", "goal", "orientation", "edge_weights")
    assert (repaired.algorithm, repaired.task.action_mode) == (report.algorithm, "argmax")
    assert replace(repaired.model, activation=report.model.activation) == report.model


def test_the_report_as_published():
    """The settings of the authors' configuration: ten agents with fixed starts and goals, and 1000 steps."""
    config = PRESETS["report-published"]
    ppo, model, optimization = config.ppo, config.model, config.optimization
    assert described(config)[2:] == ((8, 512, 10, 128, 2.5e-4, 0.0), 5_000_000)
    assert (ppo.gamma, ppo.lmbda, ppo.clip_epsilon, ppo.critic_coeff, ppo.credit) == (0.9999, 0.95, 0.2, 0.19, "team")
    assert (model.activation, optimization.final_learning_rate, optimization.max_grad_norm) == ("gelu", 1, 5)
    assert config.task.action_mode == "affine"
    problem = load_problem("warehouse_small_10")
    env = parallel_env(**config.task.env.keywords())
    for seed in (0, 1):
        env.reset(seed=seed)
        assert env.positions.tolist() == problem.starts.tolist()
        assert env.goals.tolist() == problem.errands[:10].tolist()
    assert config.task.env.max_steps == 1000


def test_the_report_has_the_sizes_of_its_figures():
    """Stacked observations, two convolutions, 128 features, 2 x 64 for the matrix of ten agents and for the value."""
    algorithm = ALGORITHMS["central-ppo"](PRESETS["report"])
    network = algorithm.network
    convolutions = [layer for layer in network.modules() if isinstance(layer, nn.Conv2d)]
    assert [(layer.in_channels, layer.out_channels, layer.kernel_size, layer.stride) for layer in convolutions] == [
        (10 * 7, 32, (8, 8), (4, 4)),
        (32, 64, (4, 4), (2, 2)),
    ]
    linear = [layer.out_features for layer in network.modules() if isinstance(layer, nn.Linear)]
    assert linear == [128, 64, 64, 10 * 4]
    mean, deviation = network(torch.zeros(1, 10 * 7, 20, 20))
    assert mean.shape == deviation.shape == (1, 10, 4)
