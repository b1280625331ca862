import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from mapf_pz.simulator.actions import Action
from mapf_pz.simulator.config import RewardConfig
from mapf_pz.wrappers import CentralizedVectorEnv, centralized_env

SMALL = {"map": ".....\n..@..\n.....\n", "num_agents": 3, "max_steps": 7, "view_size": (3, 3)}


def assert_same(ours, theirs):
    for mine, other in zip(ours, theirs, strict=True):
        if isinstance(mine, dict):
            assert mine.keys() == other.keys()
            assert_same([mine[name] for name in other], other.values())
        elif isinstance(mine, np.ndarray) and mine.dtype == object:  # observations of those that have ended
            assert [one is None for one in mine] == [one is None for one in other]
            for one, same in zip(mine, other, strict=True):
                if one is not None:
                    assert_same([one], [same])
        else:
            np.testing.assert_array_equal(mine, other)


@pytest.mark.parametrize("autoreset_mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
@pytest.mark.parametrize("on_target", ["nothing", "finish", "restart"])
@pytest.mark.parametrize(
    ("action_mode", "team_reward", "keywords"),
    [
        ("argmax", "sum", {}),
        ("softmax", "mean", {"features": ("goal_vector", "time"), "reward": "progress"}),
        ("affine", "sum", {"action_model": "cardinal", "view": "centered"}),
        ("discrete", "sum", {"features": ("time",)}),
    ],
)
def test_parallel_episodes_equal_sequential_ones(autoreset_mode, on_target, action_mode, team_reward, keywords):
    options = {**SMALL, "on_target": on_target, "action_mode": action_mode, "team_reward": team_reward, **keywords}
    ours = CentralizedVectorEnv(num_envs=4, autoreset_mode=autoreset_mode, **options)
    theirs = SyncVectorEnv([lambda: centralized_env(**options)] * 4, autoreset_mode=autoreset_mode)
    assert ours.single_observation_space == theirs.single_observation_space
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    assert ours.metadata["autoreset_mode"] == theirs.metadata["autoreset_mode"]
    assert_same(ours.reset(seed=5), theirs.reset(seed=5))
    ours.action_space.seed(0)
    for _ in range(40):
        actions = ours.action_space.sample()
        assert_same(ours.step(actions), theirs.step(actions))
    assert_same(ours.reset(seed=[3, None, 4, None]), theirs.reset(seed=[3, None, 4, None]))
    assert_same(ours.reset(), theirs.reset())


@pytest.mark.parametrize(("team_reward", "each_step"), [("sum", -3.0), ("mean", -1.0)])
def test_the_step_after_an_episode_resets_it_without_a_reward(team_reward, each_step):
    """Gymnasium's `AutoresetMode.NEXT_STEP`, with agents that wait away from their goals."""
    options = SMALL | {"max_steps": 4, "reward": RewardConfig(step_cost=1), "team_reward": team_reward}
    envs = CentralizedVectorEnv(2, **options)
    assert envs.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    envs.reset(seed=0)
    actions = np.zeros(envs.action_space.shape)
    actions[..., Action.WAIT] = 1
    for _ in range(2):
        for step in range(5):  # four of the episode, and the one that resets it
            _, rewards, terminated, truncated, infos = envs.step(actions)
            assert rewards.tolist() == [each_step if step < 4 else 0.0] * 2
            assert truncated.tolist() == [step == 3] * 2
            assert infos["ep_length"].tolist() == [4.0 if step == 3 else 0.0] * 2
            assert not terminated.any()


def test_make_vec():
    envs = gymnasium.make_vec("mapf_pz:Mapf-Centralized-v0", num_envs=3, num_threads=2, **SMALL)
    assert isinstance(envs.unwrapped, CentralizedVectorEnv)
    observations, infos = envs.reset(seed=0)
    assert observations.shape == (3, 3 * 7, 3, 3)
    assert envs.observation_space.contains(observations)
    assert infos["_is_success"].all()
    envs.close()


def test_observations_are_never_reused():
    envs = CentralizedVectorEnv(2, **SMALL)
    first, _ = envs.reset(seed=0)
    kept = first.copy()
    envs.action_space.seed(0)
    second, *_ = envs.step(envs.action_space.sample())
    second[:] = 9
    assert (first == kept).all()


def test_invalid_arguments_are_refused():
    with pytest.raises(ValueError, match="team_reward='most': expected one of 'sum', 'mean'"):
        CentralizedVectorEnv(2, team_reward="most", **SMALL)
    with pytest.raises(ValueError, match="action_mode='best': expected one of 'argmax'"):
        CentralizedVectorEnv(2, action_mode="best", **SMALL)
    envs = CentralizedVectorEnv(2, **SMALL)
    with pytest.raises(RuntimeError, match=r"call reset\(\) before step"):
        envs.step(envs.action_space.sample())
    with pytest.raises(ValueError, match="seed: expected 2 seeds, got 1"):
        envs.reset(seed=[1])
    with pytest.raises(ValueError, match="options="):
        envs.reset(options={"instance": 3})
    envs.reset(seed=0)
    with pytest.raises(ValueError, match=r"actions: expected the shape \(2, 3, 4\), got \(3, 4\)"):
        envs.step(np.zeros((3, 4)))
    with pytest.raises(ValueError, match="actions contain NaN"):
        envs.step(np.full((2, 3, 4), np.nan))
    envs = CentralizedVectorEnv(2, action_mode="discrete", **SMALL)
    envs.reset(seed=0)
    with pytest.raises(
        ValueError, match=r"actions: expected integers of shape \(2, 3\), got float64 of shape \(2, 3\)"
    ):
        envs.step(np.zeros((2, 3)))
    with pytest.raises(ValueError, match="actions: expected numbers from 0 to 3, got 0 to 4"):
        envs.step(np.array([[0, 0, 0], [0, 0, 4]]))
