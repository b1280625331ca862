"""Runs that start from a trained policy, and training under the safety layer."""

import dataclasses

import numpy as np
import pytest
import torch
from torchrl.envs.utils import check_env_specs

from mapf_pz.planners import BatchShield
from mapf_pz.rl import BatchedMapfEnv, load_policy, train
from mapf_pz.rl.algorithms.named import ALGORITHMS
from mapf_pz.rl.environments.collect import MakeEnv
from mapf_pz.rl.training.train import resume
from tests.helpers.small_run import TINY, changed, rows, untimed

ONE_UPDATE = dataclasses.replace(TINY, agent_steps=192)


@pytest.fixture(scope="module")
def start(tmp_path_factory):
    return str(train(ONE_UPDATE, tmp_path_factory.mktemp("start") / "run"))


def with_ppo(config, **fields):
    return dataclasses.replace(config, ppo=dataclasses.replace(config.ppo, **fields))


def logits_of(folder):
    network = load_policy(folder).network
    images, features = torch.rand(50, 5, 3, 3, generator=torch.Generator().manual_seed(0)), torch.zeros(50, 14)
    with torch.no_grad():
        return network(images, features)[0]


@pytest.mark.parametrize("temperature", [1.0, 0.25])
def test_a_run_starts_from_the_policy(tmp_path, start, temperature):
    still = with_ppo(ONE_UPDATE, warmup_updates=1)  # only the critic learns
    folder = train(dataclasses.replace(still, initial_policy=start, initial_temperature=temperature), tmp_path)
    torch.testing.assert_close(logits_of(folder), logits_of(start) / temperature)


def test_only_the_first_updates_warm_up(tmp_path, start):
    config = with_ppo(dataclasses.replace(ONE_UPDATE, agent_steps=384, initial_policy=start), warmup_updates=1)
    assert not torch.equal(logits_of(train(config, tmp_path)), logits_of(start))


def test_the_penalty_is_the_log_ratio_to_the_initial_policy():
    config = with_ppo(dataclasses.replace(ONE_UPDATE, initial_policy="some"), kl_coeff=0.5)
    initial = ALGORITHMS["mappo"](config).network
    algorithm = ALGORITHMS["mappo"](config)
    algorithm.start_from(initial)
    with torch.no_grad():
        for parameter in algorithm.network.parameters():
            parameter += 0.3 * torch.randn(parameter.shape, generator=torch.Generator().manual_seed(1))
    env = MakeEnv(algorithm, config, 0, 4)()
    with torch.no_grad():
        batch = env.rollout(6, algorithm.actor, break_when_any_done=False)
    before = batch["next", "agents", "reward"].clone()
    observed = batch["agents", "observation"]
    learner = algorithm.make_learner()
    means = learner.learn(batch, 0)
    with torch.no_grad():
        logits = initial(observed["image"], observed["features"])[0]
    reference = torch.distributions.Categorical(logits=logits).log_prob(batch["agents", "action"])
    ratio = batch["agents", "action_log_prob"].detach() - reference
    torch.testing.assert_close(before - batch["next", "agents", "reward"], 0.5 * ratio.unsqueeze(-1))
    assert means["kl_from_initial"] == pytest.approx(ratio.mean().item(), abs=1e-5)


def test_a_fine_tuned_run_resumes(tmp_path, start):
    config = with_ppo(dataclasses.replace(TINY, agent_steps=384, initial_policy=start), kl_coeff=0.1)
    folder = train(dataclasses.replace(config, agent_steps=192), tmp_path / "run")
    resume(folder, agent_steps=384)
    once = train(config, tmp_path / "once")
    assert untimed(folder)[0] == untimed(once)[0]
    assert "kl_from_initial" in rows(folder)[-1]


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"kl_coeff": 0.1}, "kl_coeff=0.1: expected 0 without an initial_policy"),
        ({"kl_coeff": -1.0}, "kl_coeff=-1.0"),
        ({"warmup_updates": -1}, "warmup_updates=-1"),
    ],
)
def test_bad_numbers(fields, message):
    with pytest.raises(ValueError, match=message):
        with_ppo(TINY, **fields)


def test_the_temperature_is_positive():
    with pytest.raises(ValueError, match="initial_temperature=0"):
        dataclasses.replace(TINY, initial_temperature=0.0)


def test_other_networks_are_refused(tmp_path, start):
    model = dataclasses.replace(TINY.model, hidden=8)
    with pytest.raises(ValueError, match="initial_policy: not the networks of this configuration"):
        train(dataclasses.replace(TINY, initial_policy=start, model=model), tmp_path)
    with pytest.raises(FileNotFoundError, match="policy 'nobody'"):
        train(dataclasses.replace(TINY, initial_policy="nobody"), tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["mappo", "ippo"])
@pytest.mark.parametrize("action_model", ["cardinal", "rotate"])
def test_the_safety_layer_executes_the_actions(name, action_model):
    config = dataclasses.replace(TINY, task=changed(TINY.task, action_model=action_model, shield=True))
    algorithm = ALGORITHMS[name](config)
    env = MakeEnv(algorithm, config, 3, 4)()
    torch.manual_seed(0)
    check_env_specs(env)
    env.set_seed(3)
    steps = env.rollout(10, algorithm.actor, break_when_any_done=False)
    again = BatchedMapfEnv(4, **config.task.env_keywords())
    again.set_seed(3)
    again.reset()
    shield = BatchShield(again.simulator)
    for t in range(10):
        assert np.array_equal(
            steps["agents", "position"][:, t].numpy(), again.simulator.coordinates(again.simulator.agents["cell"])
        )
        preferences = steps["agents", "preferences"][:, t].detach()
        assert torch.equal(preferences.argmax(-1), steps["agents", "action"][:, t])
        again.simulator.step(shield.actions(preferences.numpy()))
        over = np.flatnonzero(again.simulator.over).tolist()
        if over:
            again.simulator.reset(over)
            shield.reset(over)


def test_central_ppo_has_no_safety_layer():
    config = dataclasses.replace(TINY, algorithm="central-ppo", task=changed(TINY.task, shield=True))
    with pytest.raises(ValueError, match="shield: expected False with central-ppo"):
        ALGORITHMS["central-ppo"](config)


def test_training_under_the_safety_layer(tmp_path):
    config = dataclasses.replace(TINY, task=changed(TINY.task, shield=True, max_steps=60), validation_interval=192)
    last = rows(train(config, tmp_path))[-1]
    assert float(last["validation_ISR"]) > 0.3  # newly initialized, but PIBT leads the agents that make no progress
