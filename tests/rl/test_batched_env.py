import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import MarlGroupMapType, PettingZooWrapper, check_env_specs

import mapf_pz
from mapf_pz.instances.sources import RandomObstacles
from mapf_pz.rl import BatchedMapfEnv

MODES = [
    {},
    {"features": ("goal_vector", "last_actions")},
    {"on_target": "finish"},
    {"on_target": "restart", "action_model": "cardinal"},
    {"state": True, "metrics": True},
    {"state": True, "metrics": True, "edge_weights": "crisscross"},
    {"state": True, "metrics": True, "on_target": "restart"},
]


@pytest.mark.parametrize("keywords", MODES, ids=str)
def test_specs_hold(keywords):
    check_env_specs(BatchedMapfEnv(3, num_agents=5, max_steps=8, **keywords))


@pytest.mark.filterwarnings("ignore:PettingZoo in TorchRL is tested using version")
def test_torchrl_wraps_the_pettingzoo_environment():
    env = mapf_pz.parallel_env(num_agents=3, max_steps=10)
    check_env_specs(PettingZooWrapper(env, group_map=MarlGroupMapType.ALL_IN_ONE_GROUP))


@pytest.mark.parametrize("on_target", ["nothing", "restart"])
def test_a_row_is_the_pettingzoo_environment(on_target):
    keywords = {
        "source": RandomObstacles(7, 6, 0.2, 5, 30 if on_target == "restart" else 1),
        "max_steps": 12,
        "on_target": on_target,
        "reward": "progress",
        "channels": ("view", "cost_to_go", "others_next"),
        "features": ("action_advantage",),
    }
    batched = BatchedMapfEnv(4, **keywords)
    batched.set_seed(20)
    now = batched.reset()
    rng = np.random.default_rng(0)
    actions = rng.integers(4, size=(12, 4, 5))
    singles = [mapf_pz.parallel_env(**keywords) for _ in range(4)]
    seen = [env.reset(seed=20 + b)[0] for b, env in enumerate(singles)]
    for step in range(12):
        for b, env in enumerate(singles):
            for i, agent in enumerate(env.possible_agents if seen[b] else []):
                for part in ("image", "features"):
                    expected = now["agents", "observation", part][b, i].numpy()
                    assert np.array_equal(seen[b][agent][part], expected)
        now["agents", "action"] = torch.from_numpy(actions[step])
        now = batched.step(now)["next"]
        for b, env in enumerate(singles):
            if not env.agents:
                seen[b] = {}
                continue
            result = env.step({agent: actions[step, b, i] for i, agent in enumerate(env.agents)})
            seen[b], rewards, terminated, truncated, _ = result
            assert list(rewards.values()) == pytest.approx(now["agents", "reward"][b, :, 0].tolist())
            assert all(terminated.values()) == now["terminated"][b].item()
            assert all(truncated.values()) == now["truncated"][b].item()


@pytest.mark.parametrize("edge_weights", ["uniform", "random"])
@pytest.mark.parametrize("on_target", ["nothing", "finish", "restart"])
def test_state_goals_and_metrics_are_those_of_the_pettingzoo_environment(on_target, edge_weights):
    keywords = {"source": RandomObstacles(5, 6, 0.1, 3, 30 if on_target == "restart" else 1), "max_steps": 40}
    keywords |= {"on_target": on_target, "edge_weights": edge_weights}
    keywords |= {"channels": ("view", "cost_to_go"), "reward": "progress"}
    batched = BatchedMapfEnv(3, state=True, metrics=True, **keywords)
    batched.set_seed(7)
    now = batched.reset()
    singles = [mapf_pz.parallel_env(**keywords) for _ in range(3)]
    for b, env in enumerate(singles):
        env.reset(seed=7 + b)
    assert set(now["metrics"].keys()) == set(singles[0].metrics())
    rng = np.random.default_rng(0)
    for _ in range(40):
        for b, env in enumerate(singles):
            assert np.array_equal(now["state"][b].numpy(), env.state())
            assert np.array_equal(now["agents", "goal"][b].numpy(), env.goals)
            assert all(np.isnan(value[b].item()) for value in now["metrics"].values())
        actions = rng.integers(4, size=(3, 3))
        now = batched.step(now.set(("agents", "action"), torch.from_numpy(actions)))["next"]
        for b, env in enumerate(singles):
            env.step({agent: actions[b, env.possible_agents.index(agent)] for agent in env.agents})
            if not env.agents:
                expected = env.metrics()
                assert {name: value[b].item() for name, value in now["metrics"].items()} == pytest.approx(expected)
        if now["done"].any():
            break
    assert now["done"].any()


def test_partial_reset_leaves_the_others_alone():
    env = BatchedMapfEnv(3, num_agents=4, max_steps=5, map="empty-8-8")
    env.set_seed(0)
    now = env.reset()
    for _ in range(3):
        now = env.rand_step(now)["next"]
    before = env.simulator.agents.copy()
    now["_reset"] = torch.tensor([[False], [True], [False]])
    env.reset(now)
    after = env.simulator.state
    assert after.time.tolist() == [3, 0, 3]
    assert np.array_equal(before[[0, 2]], after.agents[[0, 2]])


def test_a_partial_first_reset_keeps_the_seeds_of_the_others():
    def reset(*masks):
        env = BatchedMapfEnv(3, num_agents=4, map="random-12-12-15")
        env.set_seed(5)
        for mask in masks:
            env.reset(TensorDict({"_reset": torch.tensor(mask)[:, None]}, [3]))
        return env.simulator.agents["cell"].tolist()

    together = reset([True] * 3)
    assert reset([False, True, False], [True, False, True]) == together
    assert reset([False, True, False], [True, True, True])[1] != together[1]  # has its second episode


def test_last_observation_before_a_reset_is_the_true_one():
    env = BatchedMapfEnv(2, num_agents=4, max_steps=5, channels=("view",), features=("time",))
    rollout = env.rollout(11, break_when_any_done=False)
    times = rollout["next", "agents", "observation", "features"][0, :, 0, 0]
    assert times.tolist() == pytest.approx([0.2, 0.4, 0.6, 0.8, 1, 0.2, 0.4, 0.6, 0.8, 1, 0.2])
    assert rollout["next", "truncated"][0, :, 0].tolist() == ([False] * 4 + [True]) * 2 + [False]
    assert not rollout["next", "terminated"].any()


def test_seed_decides_everything():
    def run():
        env = BatchedMapfEnv(2, num_agents=4, max_steps=6)
        env.set_seed(5)
        torch.manual_seed(0)
        return env.rollout(20, break_when_any_done=False)

    first, second = run(), run()
    assert (first == second).all()


def test_keywords_of_a_reset_are_refused():
    env = BatchedMapfEnv(1)
    with pytest.raises(TypeError, match="reset: expected no keywords, got options"):
        env.reset(options={"instance": None})
    env.reset(env.reset(set_state=False), set_state=False)


def test_unknown_keyword_is_named():
    with pytest.raises(TypeError, match="did you mean 'num_agents'"):
        BatchedMapfEnv(2, agents=4)


@pytest.mark.filterwarnings("ignore:PettingZoo in TorchRL is tested using version")
@pytest.mark.parametrize("action_model", ["rotate", "cardinal"])
def test_torchrls_wrapper_gives_the_same_episodes(action_model):
    keywords = {"source": RandomObstacles(6, 7, 0.2, 4), "max_steps": 9, "action_model": action_model}
    env = mapf_pz.parallel_env(**keywords)
    wrapped = PettingZooWrapper(env, group_map={"agents": env.possible_agents}, seed=5)
    batched = BatchedMapfEnv(1, **keywords)
    batched.set_seed(5)
    batched.reset()  # as the wrapper has done when it was seeded
    for flag in ("done", "terminated", "truncated"):
        assert batched.full_done_spec[flag][0] == wrapped.full_done_spec[flag]
    one, other = wrapped.reset(), batched.reset()
    rng = np.random.default_rng(0)
    for _ in range(2):  # the second episode goes on from the same generator
        while not other["done"].all():
            assert torch.equal(one["agents", "observation"], other["agents", "observation"][0])
            action = torch.from_numpy(rng.integers(4, size=4))
            one["agents", "action"], other["agents", "action"] = action, action[None]
            one, other = wrapped.step(one)["next"], batched.step(other)["next"]
            assert torch.equal(one["agents", "reward"], other["agents", "reward"][0])
            for flag in ("done", "terminated", "truncated"):
                assert torch.equal(one[flag], other[flag][0]), flag
        one, other = wrapped.reset(), batched.reset()


def test_positions():
    env = BatchedMapfEnv(2, num_agents=5, max_steps=100, map=".....\n" * 5, on_target="finish")
    env.set_seed(0)
    torch.manual_seed(0)
    now = env.reset()
    for _ in range(60):
        for b in range(2):
            active = env.simulator.agents["active"][b]
            expected = np.where(active[:, None], env.simulator.positions(b), -1)
            assert np.array_equal(now["agents", "position"][b].numpy(), expected)
        now = env.rand_step(now)["next"]
    assert (now["agents", "position"] == -1).any()


@pytest.mark.parametrize("model", ["rotate", "cardinal"])
@pytest.mark.parametrize("action", [-1, 7, 2**40, -(2**40)])
def test_impossible_actions_are_refused(model, action):
    env = BatchedMapfEnv(3, num_agents=2, action_model=model)
    start = env.reset()
    actions = torch.zeros(3, 2, dtype=torch.int64)
    actions[1, 1] = action
    highest = env.simulator.num_actions - 1
    with pytest.raises(ValueError, match=f"^action {action} of 'agent_1' in environment 1: .* from 0 to {highest}$"):
        env.step(start.set(("agents", "action"), actions))
    actions[1, 1] = highest
    env.step(start.set(("agents", "action"), actions))


@pytest.mark.parametrize(
    "actions",
    [
        torch.zeros(3, 2),
        torch.zeros(3, 2, dtype=torch.int32),
        torch.zeros(3, 2, 1, dtype=torch.int64),
        torch.zeros(3, 2, 4, dtype=torch.int64),
    ],
)
def test_actions_of_another_kind_are_refused(actions):
    env = BatchedMapfEnv(3, num_agents=2)
    with pytest.raises(ValueError, match=r"expected int64 of shape \(3, 2\), got ") as caught:
        env.step(env.reset().set(("agents", "action"), actions))
    assert "\n" not in str(caught.value)


def test_the_representation_has_the_sizes():
    env = BatchedMapfEnv(3, num_agents=5, map="empty-8-8")
    assert repr(env) == "BatchedMapfEnv(num_envs=3, num_agents=5, maps of 8 x 8, device=cpu)"
