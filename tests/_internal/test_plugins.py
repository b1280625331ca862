"""Parts that users plug in: channels, features, rewards, sources, encoders and algorithms from outside the package."""

import csv
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import nn

import mapf_pz
from mapf_pz import Channel, EnvConfig, Feature
from mapf_pz.commands.main import main
from mapf_pz.instances import Scenario
from mapf_pz.planners import PIBT
from mapf_pz.rl import BatchedMapfEnv, load_policy, train
from mapf_pz.rl.algorithms.ppo import MAPPO
from mapf_pz.rl.config_file import load_config
from mapf_pz.simulator import Simulator
from tests.helpers.small_run import TINY, changed

pytestmark = pytest.mark.usefixtures("without_figures")

FREE = np.array([[True, True, True, True], [True, False, True, True], [True, True, True, True]])
STATIC = {"map": FREE, "num_agents": 3, "view_size": (3, 3), "view": "centered", "frame": "map"}


def draw_rows(inputs, image, plane):
    """Each agent's row and the number of others in view, everywhere."""
    image[:, :, plane] = inputs.positions[..., 0, None, None]
    image[:, :, plane + 1] = inputs.others.count[..., None, None]


def draw_free(inputs, image, plane):
    b = np.arange(len(inputs.free))[:, None, None]
    image[:, :, plane] = inputs.free[b, inputs.cells].reshape(image[:, :, plane].shape)


def write_distance(inputs, values, at):
    b, n = np.indices(inputs.active.shape)
    width = inputs.world.width
    values[..., at] = inputs.cost_to_go[b, n, inputs.positions[..., 0] * width + inputs.positions[..., 1]] / 100


def write_rows(inputs, values, at):
    values[..., at] = inputs.positions[..., 0]


def write_nan(inputs, values, at):
    values[..., at] = np.nan


def write_two_if_gone(inputs, values, at):
    values[..., at] = np.where(inputs.state.agents["was_active"], 0, 2)


rows = Channel(draw_rows, planes=2, high=9)
free = Channel(draw_free)
distance = Feature(write_distance, needs_cost_to_go=True)


def moved(transition):
    """Reward for moving, and for being closer to the goal."""
    gain = transition.cost_to_go_before - transition.cost_to_go
    return (transition.positions != transition.positions_before).any(-1) + np.where(np.isfinite(gain), gain, 0) / 8


def wrong_shape(transition):
    return np.zeros(transition.actions.shape[0])


class HalfLoss(MAPPO):
    """An algorithm from outside."""


class Flat(nn.Module):
    """An encoder from outside."""

    def __init__(self, observed, config):
        super().__init__()
        size = int(np.prod(observed.image)) + observed.features
        self.layer = nn.Linear(size, config.hidden)

    def forward(self, image, features=None):
        flat = image.flatten(-3)
        return self.layer(flat if features is None else torch.cat([flat, features], -1))


HERE = __name__
OWN = {
    "channels": ("view", f"{HERE}:rows", f"{HERE}:free"),
    "features": (f"{HERE}:distance",),
    "reward": f"{HERE}:moved",
}


@pytest.mark.parametrize("by", ["name", "object"])
def test_custom_channel_feature_and_reward_in_an_environment(by):
    own = OWN if by == "name" else {"channels": ("view", rows, free), "features": (distance,), "reward": moved}
    env = mapf_pz.parallel_env(**STATIC, **own, initial_heading="east")
    observations, _ = env.reset(seed=1)
    for _ in range(6):
        positions = {agent: tuple(env.positions[i]) for i, agent in enumerate(env.possible_agents)}
        for agent, observation in observations.items():
            row, col = positions[agent]
            near = sum(max(abs(r - row), abs(c - col)) == 1 for other, (r, c) in positions.items() if other != agent)
            around = np.pad(FREE, 1)[row : row + 3, col : col + 3]
            assert (observation["image"][1] == row).all()
            assert (observation["image"][2] == near).all()
            assert np.array_equal(observation["image"][3], around)
            assert env.observation_space(agent).contains(observation)
        before = {agent: observations[agent]["features"][0] * 100 for agent in observations}
        observations, rewards, *_ = env.step(dict.fromkeys(env.agents, 0))
        for i, agent in enumerate(env.agents):
            gain = before[agent] - observations[agent]["features"][0] * 100  # over headings, as the reward's is not
            assert rewards[agent] >= (tuple(env.positions[i]) != positions[agent]) + min(gain, 0) / 8 - 0.3


@pytest.mark.parametrize("others", [(), ("action_advantage",)])
def test_a_feature_that_does_not_declare_that_it_reads_the_cost_to_go(others):
    """Without the declaration, it would read memory that was never written."""
    undeclared = replace(distance, needs_cost_to_go=False)
    env = mapf_pz.parallel_env(**STATIC, features=(undeclared, *others))
    if others:  # which have the cost to go computed
        assert env.observation_space("agent_0").contains(env.reset(seed=0)[0]["agent_0"])
        return
    with pytest.raises(RuntimeError, match=r"^cost_to_go: expected needs_cost_to_go=True in the Channel or Feature"):
        env.reset(seed=0)


@pytest.mark.parametrize(
    ("part", "message"),
    [
        ({"channels": ("view", Channel(draw_rows, planes=2))}, "channel draw_rows: expected numbers from 0 to 1, got"),
        ({"features": (Feature(write_rows),)}, "feature write_rows: expected numbers from -1 to 1, got"),
        ({"features": ("location", Feature(write_nan))}, "feature write_nan: expected numbers from -1 to 1, got nan"),
    ],
)
@pytest.mark.parametrize("stacked", [{}, {"num_frames": 2, "num_neighbors": 1}])
def test_parts_of_users_that_leave_their_bounds(part, message, stacked):
    starts = [[0, 0], [0, 3], [2, 0]]
    env = mapf_pz.parallel_env(**STATIC, **part, **stacked, scenario=Scenario(starts, starts[::-1]))
    with pytest.raises(ValueError, match=message):
        env.reset(seed=0)


def test_agents_that_have_disappeared_may_leave_the_bounds():
    part = Feature(write_two_if_gone)
    env = mapf_pz.parallel_env(**STATIC, features=(part,), on_target="finish", action_model="cardinal")
    planner = PIBT(env)
    observations, _ = env.reset(seed=0)
    while env.agents:
        observations, *_ = env.step(planner.act(observations))
    assert env.metrics()["CSR"] == 1


def test_a_batch_draws_what_single_environments_draw():
    batch = Simulator(EnvConfig(**STATIC, **OWN), 3, 2)
    batch.reset(seeds={b: b for b in range(3)})
    batch.step(np.zeros((3, 3), np.int64))
    image, features, _ = batch.observe()
    for b in range(3):
        single = Simulator(EnvConfig(**STATIC, **OWN))
        single.reset(seeds={0: b})
        single.step(np.zeros((1, 3), np.int64))
        assert np.array_equal(single.observe().image[0], image[b])
        assert np.array_equal(single.observe().features[0], features[b])
        assert np.array_equal(single.agents["reward"][0], batch.agents["reward"][b])
    torch_env = BatchedMapfEnv(2, **STATIC, **OWN)
    assert torch_env.rollout(3)["agents", "observation", "image"].shape == (2, 3, 3, 4, 3, 3)


def test_the_reward_of_agents_that_have_left_is_zero():
    env = mapf_pz.parallel_env(
        map=np.ones((1, 4), np.bool_),
        scenario=mapf_pz.Scenario([[0, 0], [0, 3]], [[0, 1], [0, 2]]),
        view_size=(1, 1),
        action_model="cardinal",
        on_target="finish",
        reward=lambda transition: np.ones(transition.actions.shape),
    )
    env.reset(seed=0)
    assert env.step({"agent_0": 4, "agent_1": 0})[1] == {"agent_0": 1, "agent_1": 1}
    assert env.simulator.agents["reward"].tolist() == [[1, 1]]
    env.step({"agent_1": 0})
    assert env.simulator.agents["reward"].tolist() == [[0, 1]]


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"channels": ("view", "no_such_module:x")}, "channels='no_such_module:x': No module named 'no_such_module'"),
        ({"channels": (f"{HERE}:nothing",)}, f"channels='{HERE}:nothing': module '{HERE}' has no attribute 'nothing'"),
        ({"channels": (f"{HERE}:moved",)}, f"channels='{HERE}:moved': expected a Channel, got a function"),
        ({"features": (f"{HERE}:rows",)}, f"features='{HERE}:rows': expected a Feature, got a Channel"),
        ({"channels": (rows, rows)}, "expected a tuple or list of different names"),
        ({"reward": f"{HERE}:FREE"}, r"reward='.*_plugins:FREE': expected a name, a RewardConfig or a function"),
        ({"source": f"{HERE}:FREE"}, "source=.*: expected an InstanceSource"),
    ],
)
def test_objects_that_are_not_parts_are_refused_in_one_line(fields, message):
    with pytest.raises((ValueError, TypeError), match=message) as caught:
        EnvConfig(**fields)
    assert "\n" not in str(caught.value)


def test_rewards_of_another_shape_are_refused():
    env = mapf_pz.parallel_env(**STATIC, reward=wrong_shape)
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"reward: expected finite numbers of the shape \(1, 3\).*float64 \(1,\)"):
        env.step(dict.fromkeys(env.agents, 0))


@pytest.mark.parametrize("algorithm", ["mappo", "ippo", "central-ppo"])
def test_runs_with_custom_parts_are_saved_and_loaded(tmp_path, algorithm):
    config = replace(replace(TINY, task=changed(TINY.task, **OWN)), algorithm=algorithm)
    config = replace(config, model=replace(config.model, encoder=f"{HERE}:Flat"))
    train(config, tmp_path / "run")
    assert load_config(tmp_path / "run" / "config.json", trust_remote_code=True) == config
    policy = load_policy(tmp_path / "run", trust_remote_code=True)
    env = mapf_pz.parallel_env(**config.task.env_keywords())
    observations, _ = env.reset(seed=0)
    assert policy.act(observations).keys() == observations.keys()


def test_an_object_that_has_no_name_cannot_be_saved(tmp_path):
    with pytest.raises(ValueError, match=r"channels: a run cannot save Channel\(.*only its name, package.module:name"):
        train(replace(TINY, task=changed(TINY.task, channels=(rows,))), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_a_custom_algorithm_on_the_command_line(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "outside", sys.modules[HERE])
    suite = tmp_path / "suite.json"
    suite.write_text('{"tasks": [{"map": "empty-8-8", "num_agents": 2, "max_steps": 5, "episodes": 1}]}')
    words = ["train", "outside:HalfLoss", "--output", tmp_path / "run", "--agent-steps", "500", "--num-envs", "4"]
    words += ["--steps-per-batch", "4", "--evaluate", suite, "--reward", "outside:moved"]
    assert main(list(map(str, words))) == 0  # what has been trained is trusted
    assert (tmp_path / "run" / "episodes.csv").exists()
    config = load_config(tmp_path / "run" / "config.json", trust_remote_code=True)
    assert (config.algorithm, config.task.env.reward) == ("outside:HalfLoss", "outside:moved")
    with (tmp_path / "run" / "progress.csv").open() as file:
        assert len(list(csv.DictReader(file))) >= 1
