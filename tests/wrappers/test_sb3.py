import numpy as np
import pytest

from mapf_pz.wrappers import AgentVectorEnv, CentralizedVectorEnv

pytest.importorskip("stable_baselines3")

from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecCheckNan, VecMonitor

from mapf_pz.wrappers.sb3 import AgentVecEnv, CentralizedVecEnv

SMALL = {"map": ".....\n..@..\n.....\n", "num_agents": 3, "max_steps": 7, "view_size": (3, 3), "features": ("time",)}


@pytest.mark.parametrize(("ours", "theirs"), [(AgentVecEnv, AgentVectorEnv), (CentralizedVecEnv, CentralizedVectorEnv)])
def test_equal_to_the_vector_environment_of_gymnasium(ours, theirs):
    keywords = SMALL | ({"action_mode": "discrete"} if ours is CentralizedVecEnv else {})
    ours, theirs = ours(2, **keywords), theirs(2, autoreset_mode="SameStep", **keywords)
    assert ours.observation_space == theirs.single_observation_space
    assert ours.action_space == theirs.single_action_space
    ours.seed(4)
    observations, (expected, infos) = ours.reset(), theirs.reset(seed=4)
    theirs.action_space.seed(0)
    ends = 0
    for _ in range(30):
        np.testing.assert_equal(observations, expected)
        masks = infos["action_mask"].reshape(ours.num_envs, -1)
        np.testing.assert_array_equal(ours.env_method("action_masks"), masks)
        np.testing.assert_array_equal(ours.env_method("action_masks", indices=[1]), masks[1:2])
        actions = theirs.action_space.sample()
        observations, rewards, dones, dictionaries = ours.step(actions)
        expected, their_rewards, terminated, truncated, infos = theirs.step(actions)
        assert rewards.dtype == np.float32
        np.testing.assert_array_equal(rewards, their_rewards.astype(np.float32))
        np.testing.assert_array_equal(dones, terminated | truncated)
        for i, info in enumerate(dictionaries):
            assert bool(info) == dones[i]
            if info:
                np.testing.assert_equal(info["terminal_observation"], infos["final_obs"][i])
                assert info["TimeLimit.truncated"] == truncated[i]
                assert info["CSR"] == infos["final_info"]["CSR"][i] == float(info["is_success"])
        ends += dones.sum()
    assert ends >= 4 * ours.num_envs


def test_a_matrix_has_no_masks():
    envs = CentralizedVecEnv(2, **SMALL)
    envs.reset()
    with pytest.raises(RuntimeError, match=r"action_masks\(\): expected discrete actions, and reset\(\) before"):
        envs.action_masks()


def test_seeds_are_used_once():
    envs = AgentVecEnv(2, **SMALL)
    envs.seed(4)
    first, second = envs.reset(), envs.reset()
    assert not np.array_equal(first["image"], second["image"])
    envs.seed(4)
    np.testing.assert_equal(envs.reset(), first)


def test_interface():
    envs = AgentVecEnv(2, **SMALL)
    assert envs.has_attr("action_masks")
    assert envs.get_attr("num_envs", indices=0) == [6]
    assert not envs.has_attr("nothing")
    assert envs.env_is_wrapped(VecMonitor) == [False] * 6
    with pytest.raises(AttributeError, match="expected 'action_masks'"):
        envs.env_method("render")
    with pytest.raises(NotImplementedError, match="set_attr"):
        envs.set_attr("a", 1)
    envs.close()


def test_an_image_of_all_environments():
    envs = AgentVecEnv(2, render_mode="rgb_array", **SMALL)
    envs.reset()
    first, second = envs.env.render()[::3]
    np.testing.assert_array_equal(envs.render(), np.concatenate([first, second]))
    teams = CentralizedVecEnv(2, render_mode="rgb_array", **SMALL)
    teams.reset()
    np.testing.assert_array_equal(teams.render(), np.concatenate(teams.env.render()))
    assert AgentVecEnv(2, **SMALL).render_mode is None


def test_options_are_refused():
    envs = AgentVecEnv(2, **SMALL)
    for options in ({"instance": None}, [{}, {"instance": None}, *[{}] * 4]):
        with pytest.raises(ValueError, match=r"options=.*instance.*: expected none"):
            envs.set_options(options)
    for nothing in (None, {}, [{}] * 6):
        envs.set_options(nothing)
    envs.reset()


@pytest.mark.slow
def test_algorithms_learn():
    masked = pytest.importorskip("sb3_contrib").MaskablePPO
    options = {"n_steps": 16, "batch_size": 48, "n_epochs": 1, "device": "cpu", "seed": 0}
    for model in (
        PPO("MultiInputPolicy", VecCheckNan(VecMonitor(AgentVecEnv(2, **SMALL)), raise_exception=True), **options),
        PPO("MultiInputPolicy", CentralizedVecEnv(12, **SMALL), **options),
        masked("MultiInputPolicy", CentralizedVecEnv(12, action_mode="discrete", **SMALL), **options),
        masked("MultiInputPolicy", AgentVecEnv(2, **SMALL), **options),
    ):
        model.learn(192)
        assert model.num_timesteps == 192
    taken, _ = model.predict(AgentVecEnv(2, **SMALL).reset(), action_masks=np.eye(4, dtype=bool)[[3, 3, 3, 2, 1, 0]])
    assert taken.tolist() == [3, 3, 3, 2, 1, 0]
