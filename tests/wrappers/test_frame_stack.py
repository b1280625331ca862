import numpy as np
import pytest
from gymnasium import spaces
from pettingzoo.test import parallel_api_test, parallel_seed_test

import mapf_pz
from mapf_pz.actions import Action
from mapf_pz.instance import Scenario
from mapf_pz.wrappers import CentralizedEnv, ContinuousActions, FrameStack

MODES = [{}, {"features": ("goal_vector", "time"), "on_target": "finish"}, {"action_model": "cardinal"}]


def make(num_frames=3, **keywords):
    return FrameStack(mapf_pz.parallel_env(**{"num_agents": 3, "max_steps": 20, **keywords}), num_frames)


@pytest.mark.parametrize("keywords", MODES, ids=str)
def test_parallel_api_and_seeds(keywords):
    parallel_api_test(make(**keywords), num_cycles=50)
    parallel_seed_test(lambda: make(**keywords))


def test_spaces():
    env, plain = make(), mapf_pz.parallel_env(num_agents=3).observation_space("agent_0")
    space = env.observation_space("agent_0")
    assert space is env.observation_space("agent_2") is env.observation_spaces["agent_1"]
    assert space == spaces.Box(np.concatenate([plain.low] * 3), np.concatenate([plain.high] * 3), dtype=np.float32)
    assert space.shape == (21, 5, 5)
    both = make(num_frames=2, features=("time", "location")).observation_space("agent_0")
    assert (both["image"].shape, both["features"].shape) == ((14, 5, 5), (14,))


def test_oldest_first_and_the_first_one_repeated():
    env = make(features=("time",), max_steps=4)
    times = [env.reset(seed=0)[0]["agent_1"]["features"].tolist()]
    while env.agents:
        times.append(env.step(dict.fromkeys(env.agents, int(Action.WAIT)))[0]["agent_1"]["features"].tolist())
    assert times == [[0, 0, 0], [0, 0, 0.25], [0, 0.25, 0.5], [0.25, 0.5, 0.75], [0.5, 0.75, 1]]
    assert env.reset()[0]["agent_1"]["features"].tolist() == [0, 0, 0]


def test_each_agent_has_a_history_of_its_own():
    env, plain = make(), mapf_pz.parallel_env(num_agents=3, max_steps=20)
    frames = [plain.reset(seed=1)[0]] * 3
    seen = env.reset(seed=1)[0]
    rng = np.random.default_rng(0)
    while env.agents:
        assert seen.keys() == frames[-1].keys()
        for agent in seen:
            assert seen[agent].dtype == np.float32
            assert np.array_equal(seen[agent], np.concatenate([frame[agent] for frame in frames[-3:]]))
        actions = {agent: int(rng.integers(4)) for agent in env.agents}
        frames.append(plain.step(actions)[0])
        seen = env.step(actions)[0]


def test_one_frame_changes_nothing():
    env, plain = make(num_frames=1), mapf_pz.parallel_env(num_agents=3)
    assert env.observation_space("agent_0") == plain.observation_space("agent_0")
    seen, expected = env.reset(seed=0)[0], plain.reset(seed=0)[0]
    assert all(np.array_equal(seen[agent], expected[agent]) for agent in plain.agents)


def test_agents_that_have_left_observe_no_more():
    scenario = Scenario([(0, 0), (1, 0)], [(0, 1), (1, 4)])
    env = make(
        map=".....\n.....\n.....\n.....\n.....\n",
        scenario=scenario,
        num_agents=2,
        initial_heading="east",
        on_target="finish",
    )
    env.reset()
    seen = [env.step(dict.fromkeys(env.agents, int(Action.FORWARD)))[0] for _ in range(2)]
    assert [list(observations) for observations in seen] == [["agent_0", "agent_1"], ["agent_1"]]


def test_observations_are_the_callers_own():
    env, same = make(), make()
    env.reset(seed=0)[0]["agent_0"][:] = 9
    same.reset(seed=0)
    actions = dict.fromkeys(env.agents, 0)
    assert np.array_equal(env.step(actions)[0]["agent_0"], same.step(actions)[0]["agent_0"])


def test_other_wrappers_around_it_and_within():
    env = CentralizedEnv(make())
    assert env.observation_space.shape == env.reset(seed=0)[0].shape == (3 * 21, 5, 5)
    assert FrameStack(ContinuousActions(mapf_pz.parallel_env()), 2).observation_space("agent_0").shape == (14, 5, 5)


@pytest.mark.parametrize("num_frames", [0, -2])
def test_too_few_frames_are_refused(num_frames):
    with pytest.raises(ValueError, match=f"num_frames={num_frames}: expected a whole number, 1 or more"):
        make(num_frames=num_frames)
