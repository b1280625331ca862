import warnings
from importlib.util import find_spec

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.utils.env_checker import check_env
from pettingzoo.utils import BaseParallelWrapper

import mapf_pz
from mapf_pz.environment import env as aec_env
from mapf_pz.instances.instance import Scenario
from mapf_pz.render.modes import DISPLAY_VARIABLES
from mapf_pz.simulator.actions import Action
from mapf_pz.wrappers import ACTION_MODES, CentralizedEnv, ContinuousActions, MaskedObservations

CORRIDOR = ".....\n.....\n.....\n.....\n.....\n"
TWO_STEPS = Scenario([(4, 0), (4, 4)], [(4, 1), (4, 2)])  # heading east, agent 0 needs 1 step; agent 1 a U-turn and 2
METRICS = ["CSR", "ISR", "SoC", "makespan", "ep_length", "SoC_ratio"]


def make(action_mode="argmax", team_reward="sum", **keywords):
    env = mapf_pz.parallel_env(**{"num_agents": 3, "max_steps": 20, **keywords})
    return CentralizedEnv(env, action_mode, team_reward)


def make_two(**keywords):
    return make(map=CORRIDOR, scenario=TWO_STEPS, num_agents=2, initial_heading="east", **keywords)


def rows(*actions):
    return 2 * np.eye(4, dtype=np.float32)[list(actions)] - 1


# The checkers of others.


@pytest.mark.parametrize("mode", [*ACTION_MODES, "discrete"])
@pytest.mark.parametrize(
    "keywords",
    [{}, {"on_target": "finish", "features": ("goal_vector", "time")}, {"on_target": "restart"}],
    ids=str,
)
def test_gymnasium_check(mode, keywords):
    check_env(make(mode, **keywords), skip_render_check=True)


@pytest.mark.parametrize("render_mode", [None, "rgb_array", "ansi"])
def test_gymnasium_make(render_mode):
    pytest.importorskip("pygame")  # Gymnasium tries all render modes, whichever was asked for
    env = gymnasium.make(
        "mapf_pz:Mapf-Centralized-v0",
        map="random-12-12-15",
        num_agents=4,
        action_mode="softmax",
        team_reward="mean",
        render_mode=render_mode,
    )
    assert env.observation_space.shape == (28, 5, 5)
    with warnings.catch_warnings():
        # Gymnasium says so of every wrapped environment; unwrapped it could not make the other render modes.
        warnings.filterwarnings("ignore", message=".*is different from the unwrapped version")
        check_env(env.unwrapped)
    env.reset(seed=0)
    env.action_space.seed(0)
    env.step(env.action_space.sample())
    assert isinstance(env.render(), {None: type(None), "rgb_array": np.ndarray, "ansi": str}[render_mode])
    assert env.render_mode == render_mode
    env.close()


def test_gymnasium_check_without_a_display(monkeypatch):
    for variable in DISPLAY_VARIABLES:
        monkeypatch.delenv(variable, raising=False)
    env = gymnasium.make("mapf_pz:Mapf-Centralized-v0").unwrapped
    assert env.metadata["render_modes"] == ["rgb_array", "ansi"]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env)
    monkeypatch.setenv("DISPLAY", ":0")
    assert ("human" in mapf_pz.parallel_env().metadata["render_modes"]) == (find_spec("pygame") is not None)


# SB3 takes any three-dimensional Box for a picture of bytes; the policies that are no CNN flatten it.
@pytest.mark.filterwarnings("ignore:It seems that your observation")
@pytest.mark.filterwarnings("ignore:The minimal resolution for an image")
@pytest.mark.filterwarnings("ignore:Treating image space as channels-last")
@pytest.mark.parametrize("keywords", [{}, {"features": ("goal_vector",), "on_target": "finish"}], ids=str)
def test_stable_baselines_check(keywords):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(make("affine", **keywords), skip_render_check=False)


@pytest.mark.parametrize(
    ("policy", "keywords"), [("MlpPolicy", {}), ("MultiInputPolicy", {"features": ("goal_vector",)})]
)
def test_stable_baselines_learns(policy, keywords):
    algorithms = pytest.importorskip("stable_baselines3")
    env = make("affine", **keywords)
    model = algorithms.PPO(policy, env, n_steps=64, batch_size=32, n_epochs=1, seed=0, device="cpu").learn(128)
    assert len(model.ep_info_buffer) == 6
    assert len(model.ep_success_buffer) == 6
    action, _ = model.predict(env.reset(seed=0)[0])
    assert action in env.action_space


# Observations.


def test_observations_are_stacked_in_agent_order():
    env, plain = make(), mapf_pz.parallel_env(num_agents=3, max_steps=20)
    for team, agents in zip(env.reset(seed=5), plain.reset(seed=5), strict=True):
        if isinstance(team, np.ndarray):
            assert (team == np.concatenate([agents[name] for name in plain.agents])).all()
    assert isinstance(env.observation_space, spaces.Box)
    assert env.observation_space.shape == (21, 5, 5)
    one = plain.observation_space("agent_0")
    assert (env.observation_space.low == np.concatenate([one.low] * 3)).all()
    assert (env.observation_space.high == np.concatenate([one.high] * 3)).all()
    assert (env.observation_space.low == 0).any()
    assert env.action_space == spaces.Box(-1, 1, (3, 4), np.float32)


def test_observations_with_features():
    keywords = {"features": ("goal_vector", "time"), "view_size": (4, 6), "num_agents": 2}
    env, plain = make(**keywords), mapf_pz.parallel_env(**keywords)
    observation, agents = env.reset(seed=5)[0], plain.reset(seed=5)[0]
    assert observation in env.observation_space
    assert env.observation_space["image"].shape == (14, 4, 6)
    assert env.observation_space["features"].shape == observation["features"].shape
    for key in ("image", "features"):
        assert (observation[key] == np.concatenate([agents[name][key] for name in plain.agents])).all()


def test_observations_are_never_reused():
    env = make()
    first, _ = env.reset(seed=0)
    kept = first.copy()
    second, *_ = env.step(rows(0, 1, 2))
    assert not np.shares_memory(first, second)
    second[:] = 9
    assert (first == kept).all()
    assert (env.reset(seed=0)[0] == kept).all()


# Ends, rewards, infos.


def test_success_terminates():
    env = make_two(reward="report")
    _, info = env.reset(seed=0)
    assert info == {"is_success": False, **dict.fromkeys(METRICS, 0.0)}
    _, reward, terminated, truncated, info = env.step(rows(Action.FORWARD, Action.ROTATE_LEFT))
    assert (reward, terminated, truncated) == (pytest.approx(20.01), False, False)
    assert info == {"is_success": False, **dict.fromkeys(METRICS, 0.0)}
    env.step(rows(Action.WAIT, Action.ROTATE_LEFT))
    env.step(rows(Action.WAIT, Action.FORWARD))
    _, reward, terminated, truncated, info = env.step(rows(Action.WAIT, Action.FORWARD))
    assert (reward, terminated, truncated) == (20, True, False)
    assert info == {
        "is_success": True,
        "CSR": 1.0,
        "ISR": 1.0,
        "SoC": 5.0,
        "makespan": 4.0,
        "ep_length": 4.0,
        "SoC_ratio": 1.0,
    }
    assert {type(value) for value in info.values()} == {bool, float}
    with pytest.raises(RuntimeError, match="the episode is over, call reset"):
        env.step(rows(0, 0))


def test_the_time_limit_truncates():
    env = make_two(max_steps=2)
    env.reset(seed=0)
    env.step(rows(Action.FORWARD, Action.WAIT))
    _, _, terminated, truncated, info = env.step(rows(Action.WAIT, Action.WAIT))
    assert (terminated, truncated) == (False, True)
    assert (info["is_success"], info["CSR"], info["ISR"], info["ep_length"]) == (False, 0.0, 0.5, 2.0)


def test_success_in_the_last_step_terminates():
    env = make_two(max_steps=4)
    env.reset(seed=0)
    for second in (Action.ROTATE_LEFT, Action.ROTATE_LEFT, Action.FORWARD):
        env.step(rows(Action.FORWARD if second == Action.FORWARD else Action.WAIT, second))
    _, _, terminated, truncated, info = env.step(rows(Action.WAIT, Action.FORWARD))
    assert (terminated, truncated, info["is_success"]) == (True, False, True)


def test_agents_that_have_disappeared_observe_zeros_and_get_no_reward():
    env = make_two(on_target="finish", team_reward="mean")
    env.reset(seed=0)
    observation, reward, *_ = env.step(rows(Action.FORWARD, Action.ROTATE_LEFT))
    assert reward == pytest.approx((20 + 0.01) / 2)
    assert observation[:7].any()
    observation, reward, terminated, *_ = env.step(rows(Action.FORWARD, Action.ROTATE_LEFT))
    assert reward == pytest.approx(0.01 / 2)
    assert not terminated
    assert not observation[:7].any()
    assert observation[7:].any()
    wrong = rows(Action.WAIT, Action.FORWARD)
    wrong[0] = np.nan
    env.step(wrong)
    _, _, terminated, truncated, info = env.step(wrong)
    assert (terminated, truncated, info["is_success"]) == (True, False, True)


def test_left_and_late_together_truncate():
    env = make_two(on_target="finish", max_steps=3)
    env.reset(seed=0)
    env.step(rows(Action.FORWARD, Action.WAIT))
    env.step(rows(Action.WAIT, Action.WAIT))
    _, _, terminated, truncated, info = env.step(rows(Action.WAIT, Action.WAIT))
    assert (terminated, truncated, info["is_success"], info["ISR"]) == (False, True, False, 0.5)


def test_lifelong_episodes_only_truncate():
    env = make(on_target="restart", max_steps=30)
    _, info = env.reset(seed=0)
    assert list(info) == ["is_success", "avg_throughput", "ep_length", "exhausted_agents"]
    env.action_space.seed(0)
    ends = [env.step(env.action_space.sample())[2:4] for _ in range(30)]
    assert ends == [(False, False)] * 29 + [(False, True)]


def test_the_seed_decides_the_episode():
    def play(env, seed):
        env.reset(seed=seed)
        return [env.step(np.zeros((3, 4)))[0].tolist() for _ in range(20)]

    env = make("softmax")
    first = play(env, 3)
    assert play(env, 3) == play(make("softmax"), 3) == first
    assert play(env, 4) != first
    assert play(env, None) != play(env, None)


def test_options_set_the_instance():
    env = make(map=CORRIDOR, num_agents=2)
    env.reset(options={"instance": TWO_STEPS})
    assert env.env.positions.tolist() == TWO_STEPS.starts.tolist()


# Discrete actions.


def test_discrete_actions_are_those_of_the_agents():
    matrix, discrete = make_two(), make_two(action_mode="discrete")
    assert discrete.action_space == spaces.MultiDiscrete([4, 4])
    for env in (matrix, discrete):
        env.reset(seed=0)
    for actions in ([Action.FORWARD, Action.ROTATE_LEFT], [Action.WAIT, Action.ROTATE_LEFT]):
        observed, *rest, _ = matrix.step(rows(*actions))
        same, *of_numbers, _ = discrete.step(np.array(actions))
        np.testing.assert_array_equal(observed, same)
        assert rest == of_numbers


def test_masks_of_discrete_actions():
    """Agent 0 faces the border, agent 1 a free cell; agent 0 disappears when it arrives."""
    start = Scenario([(0, 0), (4, 0)], [(0, 1), (4, 4)])
    env = make(
        "discrete", map=CORRIDOR, scenario=start, num_agents=2, initial_heading=(3, 3), on_target="finish", max_steps=9
    )
    with pytest.raises(RuntimeError, match=r"action_masks\(\): expected action_mode='discrete', and reset\(\) before"):
        env.action_masks()
    _, info = env.reset(seed=0)
    walled, free = [0, 1, 1, 1], [1, 1, 1, 1]
    assert info["action_mask"].tolist() == [walled, free]
    assert env.action_masks().tolist() == [*map(bool, walled), *map(bool, free)]
    _, _, _, _, info = env.step([Action.ROTATE_RIGHT, Action.ROTATE_LEFT])
    assert info["action_mask"].tolist() == [free, walled]
    env.step([Action.FORWARD, Action.WAIT])
    _, _, _, _, info = env.step([Action.WAIT, Action.WAIT])
    assert info["action_mask"].tolist() == [free, walled]  # of an agent that has disappeared: ones
    assert "action_mask" not in make().reset(seed=0)[1]
    with pytest.raises(RuntimeError, match=r"expected action_mode='discrete'"):
        make().action_masks()


def test_masked_ppo_learns_with_discrete_actions():
    masked = pytest.importorskip("sb3_contrib").MaskablePPO
    env = make("discrete", features=("goal_vector",))
    options = {"n_steps": 32, "batch_size": 16, "n_epochs": 1, "seed": 0, "device": "cpu"}
    model = masked("MultiInputPolicy", env, **options).learn(64)
    assert model.num_timesteps == 64
    only = np.eye(4, dtype=np.bool_)[[3, 1, 2]]
    assert model.predict(env.reset(seed=0)[0], action_masks=only.reshape(-1))[0].tolist() == [3, 1, 2]


# Arguments.


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (np.zeros((2, 4)), r"action: expected the shape \(3, 4\), got \(2, 4\)"),
        (np.zeros(12), r"action: expected the shape \(3, 4\), got \(12,\)"),
        (np.full((3, 4), np.nan), "action of 'agent_0': expected numbers"),
    ],
)
def test_wrong_actions_are_refused(action, message):
    env = make()
    env.reset(seed=0)
    with pytest.raises(ValueError, match=message):
        env.step(action)


@pytest.mark.parametrize(
    ("action", "message"),
    [
        ([0, 1], r"action: expected the shape \(3,\), got \(2,\)"),
        ([0, 1, 4], "action .*4.* of 'agent_2': expected a whole number from 0 to 3"),
        ([0.0, 1.0, 2.0], "action .*0.0.* of 'agent_0': expected a whole number from 0 to 3"),
    ],
)
def test_wrong_discrete_actions_are_refused(action, message):
    env = make("discrete")
    env.reset(seed=0)
    with pytest.raises(ValueError, match=message):
        env.step(action)


def test_wrong_arguments_are_refused():
    env = mapf_pz.parallel_env()
    with pytest.raises(RuntimeError, match=r"call reset\(\) before step\(\)"):
        CentralizedEnv(env).step(np.zeros((4, 4)))
    with pytest.raises(ValueError, match="team_reward='max': expected one of 'sum', 'mean'"):
        CentralizedEnv(env, team_reward="max")
    with pytest.raises(ValueError, match=r"action_mode='max': expected one of 'argmax', .*, 'discrete'"):
        CentralizedEnv(env, "max")
    for mode in ("argmax", "discrete"):
        with pytest.raises(TypeError, match="expected observations without action masks"):
            CentralizedEnv(MaskedObservations(env), mode)
    for wrong in (None, True, aec_env(), CentralizedEnv(env)):
        with pytest.raises(TypeError, match="env: expected a MapfEnv or a wrapper of one"):
            CentralizedEnv(wrong)
    with pytest.raises(TypeError, match="expected discrete actions"):
        CentralizedEnv(ContinuousActions(env))


def test_it_stands_on_wrappers():
    env = CentralizedEnv(BaseParallelWrapper(mapf_pz.parallel_env(num_agents=2)))
    observation, _ = env.reset(seed=0)
    assert observation in env.observation_space
