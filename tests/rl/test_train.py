import csv
import dataclasses
import json

import pytest
import torch
from torchrl.envs import Compose, TransformedEnv

import mapf_pz
from mapf_pz.rl import BatchedMapfEnv, load_policy, train
from mapf_pz.rl.algorithms import ALGORITHMS
from mapf_pz.rl.config import ModelConfig, PPOConfig, TaskConfig, TrainConfig
from mapf_pz.rl.train import Progress

TINY = TrainConfig(
    task=TaskConfig(height=6, width=6, num_agents=3, max_steps=12, view_size=(3, 3)),
    model=ModelConfig(conv_channels=(4,), hidden=16),
    ppo=PPOConfig(num_envs=4, steps_per_batch=16, num_epochs=1, minibatch_size=32),
    agent_steps=600,
    num_threads=1,
)


def rows(folder):
    with (folder / "progress.csv").open() as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize("algorithm", ["mappo", "ippo", "central-ppo"])
def test_a_run_leaves_its_files_and_a_policy_that_acts(tmp_path, algorithm):
    folder = train(dataclasses.replace(TINY, algorithm=algorithm), tmp_path / "run")
    files = {file.name for file in folder.iterdir()}
    assert files == {"config.json", "policy.safetensors", "progress.csv", "learning_curve.png", "checkpoints"}
    assert [int(row["agent_steps"]) for row in rows(folder)] == [192, 384, 576]
    policy = load_policy(folder)
    env = mapf_pz.parallel_env(
        **policy.env_kwargs, map="empty-16-16", num_agents=3 if algorithm == "central-ppo" else 20
    )
    observations, _ = env.reset(seed=0)
    policy.reset_states()
    actions = policy.act(observations)
    assert actions.keys() == observations.keys()
    env.step(actions)


def test_same_seed_same_run(tmp_path):
    for name in ("a", "b"):
        train(TINY, tmp_path / name)
    first, second = rows(tmp_path / "a"), rows(tmp_path / "b")
    timings = {"seconds", "agent_steps_per_second"}
    for one, two in zip(first, second, strict=True):
        assert {k: v for k, v in one.items() if k not in timings} == {k: v for k, v in two.items() if k not in timings}


def test_interrupt_saves_the_policy(tmp_path):
    def interrupt(_row):
        raise KeyboardInterrupt

    on_progress: Progress = interrupt
    with pytest.raises(KeyboardInterrupt):
        train(TINY, tmp_path, on_progress)
    assert load_policy(tmp_path).act({}) == {}


@pytest.mark.parametrize(
    ("name", "credit", "group"),
    [("mappo", "agent", "agents"), ("ippo", "agent", "agents")]
    + [("central-ppo", credit, "team") for credit in ("team", "agent")],
)
def test_truncation_bootstraps_and_termination_does_not(name, credit, group):
    env = BatchedMapfEnv(2, **TINY.task.env_keywords())
    algorithm = ALGORITHMS[name](dataclasses.replace(TINY, ppo=dataclasses.replace(TINY.ppo, credit=credit)))
    loss = algorithm.loss
    batch = TransformedEnv(env, Compose(*algorithm.transforms())).rollout(1, algorithm.actor)
    batch["next", algorithm.reward_key] = torch.zeros_like(batch["next", algorithm.reward_key])
    batch["next", "done"] = torch.ones_like(batch["next", "done"])
    batch["next", "terminated"] = torch.tensor([[[True]], [[False]]])
    with torch.no_grad():
        loss.value_estimator(batch, params=loss.critic_network_params)
    value, following = batch[group, "state_value"], batch["next", group, "state_value"]
    torch.testing.assert_close(batch["advantage"][0], -value[0])
    torch.testing.assert_close(batch["advantage"][1], TINY.ppo.gamma * following[1] - value[1])


def test_missing_and_damaged_policies_are_one_line(tmp_path):
    with pytest.raises(FileNotFoundError, match="expected the folder of a training run"):
        load_policy(tmp_path / "nothing")
    folder = train(dataclasses.replace(TINY, agent_steps=200), tmp_path / "run")
    config = json.loads((folder / "config.json").read_text())
    config["model"]["hidden"] = 32
    (folder / "config.json").write_text(json.dumps(config))
    with pytest.raises(mapf_pz.FormatError, match=r"not the weights that config\.json describes") as caught:
        load_policy(folder)
    assert "\n" not in str(caught.value)
    (folder / "policy.safetensors").write_bytes(b"\xff" * 100)
    with pytest.raises(mapf_pz.FormatError, match="not the weights"):
        load_policy(folder)
    (folder / "config.json").write_text('{"algorithm": "dqn"}')
    with pytest.raises(mapf_pz.FormatError, match="algorithm"):
        load_policy(folder)


def test_a_team_policy_says_how_many_agents_it_acts_for(tmp_path):
    policy = load_policy(train(dataclasses.replace(TINY, algorithm="central-ppo", agent_steps=200), tmp_path))
    env = mapf_pz.parallel_env(**policy.env_kwargs, num_agents=4)
    with pytest.raises(ValueError, match="exactly 3 agents, 4 observe"):
        policy.act(env.reset(seed=0)[0])
