"""Training under a guidance graph of one's own."""

import dataclasses
import json

import numpy as np
import pytest

import mapf_pz
from mapf_pz.evaluation import make_env
from mapf_pz.guidance import GuidanceGraph
from mapf_pz.instances import load_map
from mapf_pz.rl import load_policy, train
from mapf_pz.rl.training.train import resume
from tests.helpers.small_run import TINY, changed

GRAPH = GuidanceGraph.random(load_map("empty-8-8").free, np.random.default_rng(0))
CONFIG = dataclasses.replace(TINY, task=changed(TINY.task, map="empty-8-8", edge_weights=GRAPH), agent_steps=192)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    return train(CONFIG, tmp_path_factory.mktemp("run"))


@pytest.fixture
def run(trained, tmp_path):
    """A copy of the run's files that a policy is loaded from."""
    for name in ("config.json", "edge_weights.safetensors", "policy.safetensors"):
        (tmp_path / name).write_bytes((trained / name).read_bytes())
    return tmp_path


def test_a_policy_observes_under_the_graph_that_it_was_trained_with(trained):
    policy = load_policy(trained)
    loaded = policy.env_kwargs["edge_weights"]
    np.testing.assert_array_equal(loaded.move, GRAPH.move)
    np.testing.assert_array_equal(loaded.wait, GRAPH.wait)
    env = make_env(policy, map="empty-8-8", num_agents=3)
    same = mapf_pz.parallel_env(**CONFIG.task.observation_keywords(), map="empty-8-8", num_agents=3)
    seen, expected = env.reset(seed=0)[0], same.reset(seed=0)[0]
    for agent, observation in expected.items():
        np.testing.assert_array_equal(seen[agent]["image"], observation["image"])
    env.step(policy.act(seen))


def test_the_graph_has_a_file_of_its_own(trained):
    config = json.loads((trained / "config.json").read_text())
    assert config["task"]["env"]["edge_weights"] == "edge_weights.safetensors"


def test_a_run_with_a_graph_continues(tmp_path):
    folder = train(CONFIG, tmp_path)
    resume(folder, agent_steps=384)
    np.testing.assert_array_equal(load_policy(folder).env_kwargs["edge_weights"].move, GRAPH.move)


def test_a_run_without_a_graph_leaves_none_behind(tmp_path):
    train(CONFIG, tmp_path)
    train(dataclasses.replace(TINY, agent_steps=192), tmp_path, overwrite=True)
    assert not (tmp_path / "edge_weights.safetensors").exists()
    assert load_policy(tmp_path).env_kwargs["edge_weights"] == "uniform"


@pytest.mark.parametrize("change", [{"map": None}, {"map": "empty-16-16"}])
def test_a_graph_of_another_shape_is_refused(tmp_path, change):
    config = dataclasses.replace(CONFIG, task=changed(CONFIG.task, **change))
    with pytest.raises(ValueError, match=r"edge_weights of shape \(8, 8\): the map's shape is "):
        train(config, tmp_path / "run")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("content", [None, b"", b"\x80\x05pickle", b"\x02\0\0\0\0\0\0\0{}"])
def test_a_damaged_graph_is_one_line(run, content):
    file = run / "edge_weights.safetensors"
    file.unlink()
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(
        mapf_pz.FormatError, match=r"edge_weights\.safetensors: not a saved value of edge_weights: "
    ) as caught:
        load_policy(run)
    assert "\n" not in str(caught.value)


def test_a_name_that_is_not_known_is_refused(run):
    file = run / "config.json"
    file.write_text(file.read_text().replace("edge_weights.safetensors", "../elsewhere.safetensors"))
    with pytest.raises(
        mapf_pz.FormatError, match=r"task\.env: .*edge_weights='\.\./elsewhere.*': expected one of 'uniform'"
    ):
        load_policy(run)


@pytest.mark.parametrize("weights", ["random", "random:0.5"])
def test_random_weights_vary_the_episodes_of_training_alone(weights):
    task = dataclasses.replace(CONFIG.task, env=dataclasses.replace(CONFIG.task.env, edge_weights=weights))
    assert task.env_keywords()["edge_weights"] == weights
    assert task.observation_keywords()["edge_weights"] == "uniform"
