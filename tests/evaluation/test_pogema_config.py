from types import SimpleNamespace

import numpy as np
import pytest

import mapf_pz
from mapf_pz.evaluation.pogema.config import pogema_keywords


def env_of(config, **keywords):
    env = mapf_pz.parallel_env(**(pogema_keywords(config) | keywords))
    env.reset(seed=0)
    return env


def test_the_defaults_are_those_of_pogema():
    env = env_of({})
    config = env.config
    assert (config.action_model, config.collision_system, config.on_target) == ("cardinal", "priority", "finish")
    assert (config.max_steps, len(env.possible_agents), env.grid.shape) == (64, 1, (8, 8))
    assert config.view_size == (11, 11)
    assert (config.channels, config.features) == (("view", "goal"), ("goal_vector",))


@pytest.mark.parametrize("as_object", [False, True])
def test_all_fields_are_converted(as_object):
    fields = {"on_target": "restart", "collision_system": "block_both", "observation_type": "POMAPF", "obs_radius": 2}
    fields |= {"num_agents": 3, "width": 9, "height": 7, "density": 0.2, "max_episode_steps": 20, "seed": 5}
    env = env_of(SimpleNamespace(**fields) if as_object else fields)
    assert (env.grid.shape, len(env.possible_agents)) == ((7, 9), 3)
    assert env.config.on_target == "restart"
    assert env.config.collision_system == "block_both"
    assert (env.config.view_size, env.config.features) == ((5, 5), ("goal_vector", "location"))
    assert env.config.max_steps == 20


def test_letters_of_a_map_are_starts_and_goals():
    env = env_of({"map": "b..#B\n.....\na...A", "on_target": "nothing", "obs_radius": 1})
    assert env.grid.tolist() == [[True, True, True, False, True], [True] * 5, [True] * 5]
    assert env.positions.tolist() == [[2, 0], [0, 0]]
    assert env.goals.tolist() == [[2, 4], [0, 4]]


def test_rows_of_numbers_and_given_positions():
    env = env_of({"map": [[0, 0, 0], [0, 1, 0], [0, 0, 0]], "agents_xy": [[0, 0]], "targets_xy": [[2, 2]]})
    assert not env.grid[1, 1]
    assert np.array_equal(np.concatenate([env.positions, env.goals]), [[0, 0], [2, 2]])


@pytest.mark.parametrize(("on_target", "rewards"), [("nothing", [0, 1]), ("finish", [1, 1])])
def test_rewards_are_pogemas(on_target, rewards):
    env = env_of({"map": "aA.\n...\nb.B", "on_target": on_target, "obs_radius": 1})
    right, wait = mapf_pz.CardinalAction.RIGHT, mapf_pz.CardinalAction.WAIT
    first = env.step({"agent_0": right, "agent_1": right})[1]
    assert first["agent_0"] == rewards[0]
    second = env.step({agent: right if agent == "agent_1" else wait for agent in env.agents})[1]
    assert second["agent_1"] == rewards[1]
    assert not env.agents


@pytest.mark.parametrize(
    ("fields", "error"),
    [
        ({"map_name": "maze"}, "map_name: cannot be converted"),
        ({"possible_agents_xy": [[0, 0]]}, "possible_agents_xy: cannot be converted"),
        ({"agents_xy": [[0, 0]]}, "agents_xy, targets_xy: expected both or neither"),
    ],
)
def test_what_cannot_be_converted_is_named(fields, error):
    with pytest.raises(ValueError, match=error):
        pogema_keywords(fields)
