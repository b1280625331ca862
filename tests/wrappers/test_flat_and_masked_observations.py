import numpy as np
import pytest
from gymnasium import spaces
from pettingzoo.test import parallel_api_test

import mapf_pz
from mapf_pz.wrappers import FlatObservations, MaskedObservations

VARIANTS = [{}, {**mapf_pz.RECOMMENDED, "view_size": (5, 5)}, {"on_target": "finish", "action_model": "cardinal"}]


def make(wrapper, keywords):
    return wrapper(mapf_pz.parallel_env(**{"num_agents": 3, "max_steps": 20, **keywords}))


@pytest.mark.filterwarnings("ignore:Observation is not a NumPy array")
@pytest.mark.filterwarnings("ignore:Observation space for each agent probably should be gymnasium.spaces.box")
@pytest.mark.parametrize("wrapper", [FlatObservations, MaskedObservations])
@pytest.mark.parametrize("keywords", VARIANTS, ids=["image", "features", "finish"])
def test_parallel_api(wrapper, keywords):
    env = make(wrapper, keywords)
    parallel_api_test(env, num_cycles=50)
    assert env.observation_space("agent_0") is env.observation_space("agent_2")


def steps(env, twin):
    """Yield observations and infos of the wrapped and of the plain environment, with the same random actions."""
    rng = np.random.default_rng(0)
    seen, _ = env.reset(seed=4)
    plain, infos = twin.reset(seed=4)
    yield seen, plain, infos
    while env.agents:
        actions = {agent: int(rng.integers(4)) for agent in env.agents}
        seen = env.step(actions)[0]
        plain, *_, infos = twin.step(actions)
        yield seen, plain, infos


@pytest.mark.parametrize("keywords", VARIANTS, ids=["image", "features", "finish"])
def test_a_flat_observation_is_the_image_and_the_features(keywords):
    env, twin = make(FlatObservations, keywords), make(lambda env: env, keywords)
    for seen, plain, _ in steps(env, twin):
        assert seen.keys() == plain.keys()
        for agent, vector in seen.items():
            space = env.observation_space(agent)
            assert space.contains(vector)
            parts = plain[agent] if isinstance(plain[agent], dict) else {"image": plain[agent], "features": []}
            assert vector.tolist() == [*parts["image"].ravel().tolist(), *map(float, parts["features"])]


def test_a_masked_observation_has_the_mask_of_the_infos():
    env, twin = make(MaskedObservations, VARIANTS[1]), make(lambda env: env, VARIANTS[1])
    space = env.observation_space("agent_0")
    assert space["action_mask"] == spaces.Box(0, 1, (4,), np.int8)
    blocked = 0
    for seen, plain, infos in steps(env, twin):
        for agent, parts in seen.items():
            assert space.contains(parts)
            assert np.array_equal(parts["action_mask"], infos[agent]["action_mask"])
            assert all(np.array_equal(parts["observation"][key], part) for key, part in plain[agent].items())
            blocked += (parts["action_mask"] == 0).sum()
    assert blocked > 0


def test_supersuit_stacks_flat_observations():
    supersuit = pytest.importorskip("supersuit")
    env = supersuit.frame_stack_v1(make(FlatObservations, VARIANTS[1]), 3)
    size = 5 * 5 * 5 + 14
    seen = env.reset(seed=0)[0]["agent_0"].copy()  # SuperSuit overwrites it
    assert seen.shape == env.observation_space("agent_0").shape == (3 * size,)
    again = env.step(dict.fromkeys(env.agents, 3))[0]["agent_0"]
    assert np.array_equal(again[size : 2 * size], seen[2 * size :])
