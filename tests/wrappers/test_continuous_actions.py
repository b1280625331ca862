import numpy as np
import pytest
from gymnasium import spaces
from pettingzoo.test import parallel_api_test
from pettingzoo.utils import BaseParallelWrapper

import mapf_pz
from mapf_pz.environment import env as aec_env
from mapf_pz.simulator.actions import Action
from mapf_pz.wrappers import ACTION_MODES, ContinuousActions


def make(action_mode="argmax", **keywords):
    return ContinuousActions(mapf_pz.parallel_env(**{"num_agents": 3, "max_steps": 20, **keywords}), action_mode)


def one_hot(env, action):
    values = -np.ones(env.num_actions, np.float32)
    values[action] = 1
    return dict.fromkeys(env.agents, values)


@pytest.mark.parametrize("mode", ACTION_MODES)
@pytest.mark.parametrize("keywords", [{}, {"action_model": "cardinal", "on_target": "finish"}], ids=str)
def test_parallel_api(mode, keywords):
    parallel_api_test(make(mode, **keywords), num_cycles=50)


def test_the_action_space_is_one_object():
    env = make()
    assert env.action_space("agent_0") == spaces.Box(-1, 1, (4,), np.float32)
    assert env.action_space("agent_0") is env.action_space("agent_2") is env.action_spaces["agent_1"]
    assert make(action_model="cardinal").action_space("agent_0").shape == (5,)
    with pytest.raises(KeyError):
        env.action_space("agent_3")


@pytest.mark.parametrize("mode", ["argmax", "affine"])
def test_a_certain_row_is_the_action(mode):
    env, plain = make(mode), mapf_pz.parallel_env(num_agents=3, max_steps=20)
    env.reset(seed=4)
    plain.reset(seed=4)
    for action in [Action.FORWARD, Action.ROTATE_LEFT, Action.WAIT, Action.FORWARD]:
        _, rewards, *_ = env.step(one_hot(env, action))
        _, expected, *_ = plain.step(dict.fromkeys(plain.agents, int(action)))
        assert rewards == expected
        assert (env.positions == plain.positions).all()
        assert (env.headings == plain.headings).all()


@pytest.mark.parametrize("beyond", [1.5, 100.0])
def test_values_beyond_the_space_count_as_its_bounds(beyond):
    def play(scale):
        env = make("softmax")
        env.reset(seed=0)
        states = []
        for step in range(20):
            env.step({agent: scale * np.roll([1.0, -1.0, -1.0, 1.0], step) for agent in env.agents})
            states.append([env.positions.tolist(), env.headings.tolist()])
        return states

    assert play(beyond) == play(1.0)


def test_the_seed_decides_what_is_drawn():
    def play(env, seed):
        env.reset(seed=seed)
        values = dict.fromkeys(env.agents, np.zeros(4))
        states = []
        while env.agents:
            env.step(values)
            states.append([env.positions.tolist(), env.headings.tolist()])
        return states

    env = make("affine")
    first = play(env, 1)
    assert play(env, 1) == first
    assert play(make("affine"), 1) == first
    assert play(env, 2) != first
    assert play(env, None) != play(env, None)


def test_the_order_of_the_dictionary_does_not_matter():
    ends = []
    for order in (1, -1):
        env = make("softmax")
        env.reset(seed=0)
        for _ in range(10):
            env.step({agent: np.zeros(4) for agent in env.agents[::order]})
        ends.append((env.positions.tolist(), env.headings.tolist()))
    assert ends[0] == ends[1]


def test_values_out_of_bounds_count_as_the_bound():
    env = make("affine")
    env.reset(seed=0)
    before = env.headings
    env.step(dict.fromkeys(env.agents, (-5, -1.01, np.inf, -np.inf)))
    assert (env.headings == (before + 1) % 4).all()


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ([0, np.nan, 0, 0], "action of 'agent_1': expected numbers, got [0.0, nan, 0.0, 0.0]"),
        ([0, 0, 0], "action of 'agent_1': expected the shape (4,), got (3,)"),
        (2, "action of 'agent_1': expected the shape (4,), got ()"),
        (np.zeros((1, 4)), "action of 'agent_1': expected the shape (4,), got (1, 4)"),
    ],
)
def test_wrong_values_are_refused(value, message):
    env = make()
    env.reset(seed=0)
    with pytest.raises(ValueError) as caught:  # noqa: PT011 (the whole text is compared)
        env.step({**dict.fromkeys(env.agents, np.zeros(4)), "agent_1": value})
    assert str(caught.value) == message
    assert env.step_count == 0


def test_wrong_agents_and_times_are_refused_as_by_the_environment():
    env = make()
    with pytest.raises(RuntimeError, match="call reset"):
        env.step({})
    env.reset(seed=0)
    with pytest.raises(ValueError, match="no action for 'agent_1'"):
        env.step({"agent_0": np.zeros(4), "agent_2": np.zeros(4)})
    with pytest.raises(ValueError, match="unknown agent 'agent_9'"):
        env.step({**dict.fromkeys(env.agents, np.zeros(4)), "agent_9": np.zeros(4)})


def test_wrong_arguments_are_refused():
    env = mapf_pz.parallel_env()
    with pytest.raises(ValueError, match="action_mode='greedy': expected one of 'argmax', 'affine'"):
        ContinuousActions(env, "greedy")
    for wrong in (None, True, aec_env(), env.simulator):
        with pytest.raises(TypeError, match="expected a MapfEnv"):
            ContinuousActions(wrong)
    with pytest.raises(TypeError, match="expected discrete actions"):
        ContinuousActions(ContinuousActions(env))


def test_attributes_of_the_wrapped_environment_are_accessible():
    env = ContinuousActions(BaseParallelWrapper(mapf_pz.parallel_env(num_agents=2, render_mode="ansi")))
    env.reset(seed=0)
    assert env.unwrapped.positions.tolist() == env.positions.tolist()
    assert env.num_agents == 2
    assert env.metrics()["CSR"] == 0
    assert env.render() == env.unwrapped.render()
