import dataclasses

import numpy as np
import pytest
import torch
from torch.nn.functional import gelu

import mapf_pz
from mapf_pz.rl import load_policy, train
from mapf_pz.rl.config import ModelConfig, OptimizationConfig, TrainConfig
from mapf_pz.rl.networks.actors import Actor, LocalCritic, TeamActor, TeamCritic, TeamValue
from mapf_pz.rl.networks.encoders import IMAGE_LAYERS
from mapf_pz.rl.networks.observation_shape import ObservationShape
from tests.helpers.small_run import TINY

SIZES = [(1, 1), (3, 3), (5, 9), (7, 7), (11, 11), (20, 20), (2, 25)]
MODELS = {name: ModelConfig(encoder=name, conv_channels=(4, 6), hidden=16, head=(8,)) for name in IMAGE_LAYERS}


def observations(observed, *lead):
    features = torch.randn(*lead, observed.features) if observed.features else None
    return torch.randn(*lead, *observed.image), features


@pytest.mark.parametrize("features", [0, 5])
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("name", IMAGE_LAYERS)
def test_any_size_any_leading_dimensions_any_number_of_agents(name, size, features):
    observed, config = ObservationShape((3, *size), features, 4), MODELS[name]
    actor, local, team = (network(observed, config) for network in (Actor, LocalCritic, TeamCritic))
    for lead in [(1,), (7,), (2, 3), (2, 3, 5)]:
        seen = observations(observed, *lead)
        (logits,) = actor(*seen)
        assert logits.shape == (*lead, 4)
        assert local(*seen).shape == team(*seen).shape == (*lead, 1)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("name", IMAGE_LAYERS)
def test_a_team_s_networks(name, size):
    observed, config = ObservationShape((3, *size), 5, 4), MODELS[name]
    actor = TeamActor(observed, 3, config)
    for lead in [(), (2,), (2, 3)]:
        seen = observations(observed.stacked(3), *lead)
        mean, spread = actor(*seen)
        assert mean.shape == spread.shape == (*lead, 3, 4)
        assert TeamValue(observed, 3, "team", config)(*seen).shape == (*lead, 1)
        assert TeamValue(observed, 3, "agent", config)(*seen).shape == (*lead, 3, 1)


@pytest.mark.parametrize("name", IMAGE_LAYERS)
def test_logits_and_values_are_permuted_with_the_agents(name):
    observed, order = ObservationShape((3, 7, 7), 5, 4), torch.tensor([3, 0, 4, 2, 1])
    image, features = observations(observed, 2, 5)
    actor = Actor(observed, MODELS[name])
    torch.testing.assert_close(actor(image[:, order], features[:, order])[0], actor(image, features)[0][:, order])
    critic = TeamCritic(observed, MODELS[name])
    torch.testing.assert_close(critic(image[:, order], features[:, order]), critic(image, features)[:, order])


def test_the_report_s_network_is_that_of_its_code():
    observed = ObservationShape((7, 20, 20), 0, 5).stacked(4)
    encoder = Actor(observed, ModelConfig(encoder="report", conv_channels=(32, 64), hidden=128)).encoder
    shapes = {name: tuple(weight.shape) for name, weight in encoder.named_parameters() if name.endswith("weight")}
    assert shapes == {"image.0.weight": (32, 28, 8, 8), "image.2.weight": (64, 32, 4, 4), "joint.0.weight": (128, 64)}


@pytest.mark.parametrize(("size", "left"), [((20, 20), (1, 1)), ((28, 36), (2, 3))])
def test_the_report_s_convolutions_have_strides_of_4_and_2(size, left):
    layers = torch.nn.Sequential(*IMAGE_LAYERS["report"]((3, *size), MODELS["report"]))
    assert layers(torch.zeros(1, 3, *size)).shape == (1, 6, *left)


@pytest.mark.parametrize(
    ("size", "left"), [((7, 5), (5, 3)), ((5, 7), (3, 5)), ((4, 9), (2, 7)), ((3, 9), (3, 9)), ((5, 6), (3, 4))]
)
def test_convolutions_are_padded_where_the_shorter_side_is_3_or_less(size, left):
    layers = torch.nn.Sequential(*IMAGE_LAYERS["conv"]((3, *size), MODELS["conv"]))
    assert layers(torch.zeros(1, 3, *size)).shape == (1, 6, *left)


def test_the_report_s_network_has_two_convolutions():
    with pytest.raises(ValueError, match=r"conv_channels=\(16,\): the encoder 'report' has exactly two convolutions"):
        Actor(ObservationShape((7, 20, 20), 0, 5), ModelConfig(encoder="report"))


@pytest.mark.parametrize(("name", "function"), [("relu", torch.relu), ("gelu", gelu), ("tanh", torch.tanh)])
def test_the_activation_of_heads(name, function):
    actor = Actor(ObservationShape((3, 7, 7), 0, 5), dataclasses.replace(MODELS["conv"], activation=name))
    image = torch.rand(2, 3, 7, 7)
    hidden, logits = actor.head[0], actor.head[-1]
    (expected,) = actor(image)
    torch.testing.assert_close(logits(function(hidden(actor.encoder(image, None)))), expected)


@pytest.mark.parametrize(("side", "pooled"), [(7, 7), (11, 11), (12, 6), (20, 10), (22, 11), (24, 6), (40, 10)])
def test_only_large_images_are_pooled(side, pooled):
    config = ModelConfig(encoder="residual", conv_channels=(4, 6), num_blocks=1)
    layers = torch.nn.Sequential(*IMAGE_LAYERS["residual"]((3, side, side), config))
    assert layers(torch.zeros(1, 3, side, side)).shape == (1, 6, pooled, pooled)


@pytest.mark.parametrize("num_blocks", [0, 1, 3])
def test_number_of_residual_blocks(num_blocks):
    config = dataclasses.replace(MODELS["residual"], num_blocks=num_blocks)
    convolutions = [
        m for m in Actor(ObservationShape((3, 7, 7), 0, 4), config).modules() if isinstance(m, torch.nn.Conv2d)
    ]
    assert len(convolutions) == 2 * (1 + 2 * num_blocks)


@pytest.mark.parametrize("name", IMAGE_LAYERS)
def test_a_trained_policy_acts_as_its_network(tmp_path, name):
    config = TrainConfig(
        task=TINY.task,
        model=MODELS[name],
        optimization=OptimizationConfig(num_envs=4, steps_per_batch=8, num_epochs=1, minibatch_size=16),
        agent_steps=192,
    )
    policy = load_policy(train(config, tmp_path), deterministic=True)
    observations, _ = mapf_pz.parallel_env(**policy.env_kwargs, num_agents=5).reset(seed=0)
    seen = [torch.from_numpy(np.stack([o[key] for o in observations.values()])) for key in ("image", "features")]
    with torch.no_grad():
        (logits,) = policy.network(*seen)
    assert list(policy.act(observations).values()) == logits.argmax(-1).tolist()
