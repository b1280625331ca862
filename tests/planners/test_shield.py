import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mapf_pz
from mapf_pz.actions import Action, CardinalAction
from mapf_pz.instance import Scenario
from mapf_pz.instances import RandomObstacles
from mapf_pz.planners import Shield

MODELS = {"rotate": Action, "cardinal": CardinalAction}


class Preferences:
    """A policy with the preferences that a function returns for each agent."""

    def __init__(self, preferences):
        self.preferences_of = preferences
        self.resets = 0

    def preferences(self, observations):
        return {name: self.preferences_of(name) for name in observations}

    def reset_states(self):
        self.resets += 1


@pytest.mark.parametrize("model", list(MODELS))
@settings(max_examples=20)
@given(seed=st.integers(0, 2**31), on_target=st.sampled_from(["nothing", "restart", "finish"]))
def test_no_move_is_blocked(model, seed, on_target):
    env = mapf_pz.parallel_env(
        source=RandomObstacles(6, 6, 0.2, 10), action_model=model, on_target=on_target, max_steps=30
    )
    observations, _ = env.reset(seed=seed)
    rng = np.random.default_rng(seed)
    shield = Shield(Preferences(lambda name: rng.random(len(MODELS[model]))), env)
    while env.agents:
        actions = shield.act(observations)
        assert actions.keys() == observations.keys()
        observations, _, _, _, infos = env.step(actions)
        assert not any(info["blocked"] for info in infos.values())


@pytest.mark.parametrize("model", list(MODELS))
@given(seed=st.integers(0, 2**31))
@settings(max_examples=20)
def test_a_single_agent_takes_its_preferred_action(model, seed):
    env = mapf_pz.parallel_env(map="empty-8-8", num_agents=1, action_model=model, max_steps=20)
    observations, infos = env.reset(seed=seed)
    rng = np.random.default_rng(seed)
    while env.agents:
        preferred = np.where(infos["agent_0"]["action_mask"], rng.random(len(MODELS[model])), -1)
        actions = Shield(Preferences(lambda name, preferred=preferred: preferred), env).act(observations)
        assert actions["agent_0"] == preferred.argmax()
        observations, _, _, _, infos = env.step(actions)


def test_an_agent_in_the_way_moves_away():
    scenario = Scenario([[0, 0], [0, 1]], [[0, 1], [0, 3]])  # the first agent is nearer to its goal and has priority
    env = mapf_pz.parallel_env(map="....\n", scenario=scenario, num_agents=2, action_model="cardinal", view_size=(1, 1))
    observations, _ = env.reset(seed=0)
    preferences = {"agent_0": {"RIGHT": 1}, "agent_1": {"WAIT": 1, "LEFT": 0.5, "RIGHT": 0.2}}
    shield = Shield(Preferences(lambda name: [preferences[name].get(action.name, 0) for action in CardinalAction]), env)
    env.step(shield.act(observations))
    assert env.positions.tolist() == [[0, 1], [0, 2]]


def test_it_resets_its_policy():
    env = mapf_pz.parallel_env(map="empty-8-8", num_agents=2)
    policy = Preferences(lambda name: np.zeros(4))
    Shield(policy, env).reset_states()
    assert policy.resets == 1
