import numpy as np
import pytest

import mapf_pz
from mapf_pz.cli import main
from mapf_pz.commands.train import SUITES
from mapf_pz.evaluate import load_suite, named_policy
from mapf_pz.evaluate.run import run_episodes
from mapf_pz.rl import load_policy, policy_names
from mapf_pz.rl import policy as policies
from mapf_pz.rl.presets import PRESETS

NAMES = policy_names()


def test_the_policies_that_come_with_the_package():
    assert NAMES == ["central-ppo", "ippo", "mappo", "mappo-cardinal"]


@pytest.mark.parametrize("name", NAMES)
def test_a_policy_is_small_and_what_its_preset_makes(name):
    folder = policies._bundled() / name
    assert sum(file.stat().st_size for file in folder.iterdir()) < 1_000_000
    assert load_policy(name).config == PRESETS[name]


@pytest.mark.parametrize("name", NAMES)
def test_a_policy_routes_agents(name):
    trial = load_suite(SUITES.get(name, "standard"))[0]
    assert np.mean([episode["ISR"] for episode in run_episodes(named_policy(name), trial, range(12))]) > 0.95


def test_evaluate_by_name(capsys):
    words = "--map empty-8-8 --num-agents 4 --max-steps 64 --episodes 2"
    assert main(["evaluate", "--policy", "mappo", *words.split()]) == 0
    assert "│ empty-8-8 │ 4 " in capsys.readouterr().out


def test_names_are_told():
    with pytest.raises(FileNotFoundError, match="expected the folder of a training run, or one of central-ppo, ippo"):
        load_policy("mapo")


def test_a_policy_in_ten_lines():
    policy = load_policy("mappo")
    env = mapf_pz.parallel_env(**policy.env_kwargs, map="random-16-16-20", num_agents=12, max_steps=128)
    observations, _ = env.reset(seed=0)
    policy.reset_states()
    while env.agents:
        observations = env.step(policy.act(observations))[0]
    assert env.metrics()["ISR"] > 0.7
