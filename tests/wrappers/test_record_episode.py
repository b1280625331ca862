import re

import numpy as np
import pytest
from pettingzoo.utils import BaseParallelWrapper

import mapf_pz
from mapf_pz.instances.instance import Scenario
from mapf_pz.simulator.actions import Action
from mapf_pz.wrappers import ContinuousActions, RecordEpisode


def drawn(**keywords):
    options = {"map": ".....\n..@..\n.....\n", "num_agents": 2, "max_steps": 6, "view_size": (3, 3)} | keywords
    return mapf_pz.parallel_env(**options)


def play(env, seed=0):
    """Play an episode of random actions, and return what the environment told of each step."""
    env.reset(seed=seed)
    rng, inner, told = np.random.default_rng(seed), env.unwrapped, []
    told.append((inner.positions, inner.headings, inner.goals, inner.simulator.observe().image[0]))
    while env.agents:
        env.step({agent: int(rng.integers(inner.simulator.num_actions)) for agent in env.agents})
        told.append((inner.positions, inner.headings, inner.goals, inner.simulator.observe().image[0]))
    return [np.stack(column) for column in zip(*told, strict=True)]


@pytest.mark.parametrize("on_target", ["nothing", "finish", "restart"])
def test_everything_that_happened_is_recorded(on_target):
    env = RecordEpisode(drawn(on_target=on_target, edge_weights="crisscross"))
    positions, headings, goals, images = play(env)
    recording = env.recording
    np.testing.assert_array_equal(recording.positions, positions)
    np.testing.assert_array_equal(recording.headings, headings)
    np.testing.assert_array_equal(recording.goals, goals)
    np.testing.assert_allclose(recording.observed / 127, images.reshape(recording.observed.shape), atol=0.5 / 127)
    assert recording.num_steps == len(positions) - 1
    assert recording.planes == ("view", "goal", "orientation", *(f"edge_weights {k}" for k in (1, 2, 3, 4)))
    np.testing.assert_array_equal(recording.free, env.unwrapped.grid)
    assert recording.weights[0, 0, 0] == 0.5
    assert recording.weights[1, 0, 2] == np.inf  # into the obstacle


def test_refused_moves_and_agents_that_disappear():
    env = RecordEpisode(drawn(map="....\n", view_size=(1, 3), on_target="finish", initial_heading="east", num_agents=2))
    scenario = Scenario([[0, 0], [0, 2]], [[0, 1], [0, 3]])
    env.reset(options={"instance": scenario})
    env.step({"agent_0": Action.WAIT, "agent_1": Action.FORWARD})
    env.step({"agent_0": Action.ROTATE_LEFT})
    env.step({"agent_0": Action.FORWARD})
    recording = env.recording
    assert recording.active[:, 1].tolist() == [True, False, False, False]
    assert recording.blocked.tolist() == [[False, False], [False, False], [False, False], [True, False]]
    assert not recording.observed[2:, 1].any()


@pytest.mark.parametrize("action_model", ["rotate", "cardinal"])
def test_actions_rewards_and_metrics_are_recorded(action_model):
    env = RecordEpisode(drawn(action_model=action_model, on_target="finish", collision_system="priority"))
    env.reset(seed=0)
    rng, actions, rewards = np.random.default_rng(0), [[-1, -1]], [[0, 0]]
    while env.agents:
        chosen = {agent: int(rng.integers(env.action_space(agent).n)) for agent in env.agents}
        _, paid, *_ = env.step(chosen)
        actions.append([chosen.get(agent, -1) for agent in env.possible_agents])
        rewards.append([paid.get(agent, 0) for agent in env.possible_agents])
    recording = env.recording
    assert recording.actions.tolist() == actions
    np.testing.assert_allclose(recording.rewards, rewards, rtol=1e-6)
    assert recording.metrics == env.metrics()
    assert recording.collision_system == "priority"


def test_actions_that_are_not_discrete_are_not_recorded():
    env = RecordEpisode(ContinuousActions(drawn()))
    env.reset(seed=0)
    env.step({agent: np.zeros(4, np.float32) for agent in env.agents})
    assert env.recording.actions is None


@pytest.mark.parametrize("on_target", ["nothing", "finish"])
def test_delays_are_recorded(on_target):
    env = RecordEpisode(drawn(on_target=on_target, delays="0.4:1-2", num_agents=6, max_steps=100))
    env.reset(seed=0)
    rng, told = np.random.default_rng(0), [[False] * 6]
    while env.agents:
        *_, infos = env.step({agent: int(rng.integers(4)) for agent in env.agents})
        told.append([agent in infos and infos[agent]["delayed"] > 0 for agent in env.possible_agents])
    assert 0.2 < np.mean(told) < 0.8
    assert env.recording.delayed.tolist() == told
    assert env.recording.active.all() == (on_target == "nothing")
    env = RecordEpisode(drawn())
    play(env)
    assert env.recording.delayed is None


@pytest.mark.parametrize(("on_target", "lifelong"), [("nothing", False), ("restart", True)])
def test_the_rules_are_recorded(on_target, lifelong):
    env = RecordEpisode(drawn(on_target=on_target, view="centered"))
    env.reset(seed=0)
    assert (env.recording.lifelong, env.recording.view, env.recording.frame) == (lifelong, "centered", "egocentric")


def test_an_episode_is_recorded_alone():
    env = RecordEpisode(drawn())
    play(env)
    env.reset(seed=1)
    assert env.recording.num_steps == 0
    env.step(dict.fromkeys(env.agents, Action.WAIT))
    assert env.recording.num_steps == 1


def test_cardinal_agents_have_no_headings_and_equal_weights_are_left_out():
    env = RecordEpisode(drawn(action_model="cardinal", view="centered"))
    play(env)
    assert env.recording.headings is None
    assert env.recording.weights is None


@pytest.mark.parametrize(("bytes_free", "shape"), [(0, 2), (-1, 1)])
def test_the_observations_that_fit(monkeypatch, bytes_free, shape):
    """Of 7 planes of 3 x 3 cells, before and after each of 6 steps."""
    monkeypatch.setattr("mapf_pz.wrappers.record_episode.MAX_OBSERVED_BYTES", 2 * (6 + 1) * 7 * 3 * 3 + bytes_free)
    env = RecordEpisode(drawn())
    play(env)
    assert env.recording.observed.shape[1] == shape


@pytest.mark.parametrize(("observed", "shape"), [(0, 0), (1, 1), (None, 2), (5, 2)])
def test_how_many_agents_observations_are_kept(observed, shape):
    env = RecordEpisode(drawn(), observed)
    play(env)
    assert env.recording.observed.shape[1] == shape


def test_negative_numbers_are_refused():
    with pytest.raises(ValueError, match="observed=-1: expected 0 or more"):
        RecordEpisode(drawn(), -1)


def test_only_as_many_as_fit():
    env = RecordEpisode(mapf_pz.parallel_env(map="empty-32-32", num_agents=60, max_steps=8192, view_size=(7, 7)))
    env.reset(seed=0)
    assert 0 < env.recording.observed.shape[1] < 60


def test_other_wrappers_change_nothing():
    class Blind(BaseParallelWrapper):
        def reset(self, seed=None, options=None):
            observations, infos = self.env.reset(seed, options)
            return dict.fromkeys(observations), infos

        def step(self, actions):
            observations, *rest = self.env.step(actions)
            return dict.fromkeys(observations), *rest

    env = RecordEpisode(Blind(drawn()))
    *_, images = play(env)
    np.testing.assert_allclose(env.recording.observed / 127, images.reshape(env.recording.observed.shape), atol=0.004)


def test_no_episode():
    with pytest.raises(RuntimeError, match="reset"):
        _ = RecordEpisode(drawn()).recording


def test_episodes_are_saved_in_a_folder(tmp_path):
    folder = tmp_path / "of" / "episodes"
    env = RecordEpisode(
        drawn(), folder=folder, trigger=lambda episode: episode in (1, 3, 4), extensions=(".svg", ".html")
    )
    for seed in range(4):
        play(env, seed)
        with pytest.raises(RuntimeError, match="no episode is recorded"):
            env.recording  # noqa: B018
    assert {file.name for file in folder.iterdir()} == {
        f"episode-{k}.{kind}" for k in (1, 3) for kind in ("svg", "html")
    }
    env.reset()  # without a step
    env.close()
    assert len(list(folder.iterdir())) == 4


@pytest.mark.parametrize("end", ["close", "reset"])
def test_an_unfinished_episode_is_saved(tmp_path, end):
    env = RecordEpisode(drawn(), folder=tmp_path)
    env.reset(seed=0)
    env.step(dict.fromkeys(env.agents, Action.WAIT))
    assert re.fullmatch(r"Recording\('.*, 2 agents', num_steps=1\)", repr(env.recording))
    assert not list(tmp_path.iterdir())
    getattr(env, end)()
    assert [file.name for file in tmp_path.iterdir()] == ["episode-0.html"]


def test_wrong_kinds_of_files(tmp_path):
    with pytest.raises(ValueError, match=r"episode\.avi: expected a file name that ends in \.html"):
        RecordEpisode(drawn(), folder=tmp_path, extensions=(".avi",))
