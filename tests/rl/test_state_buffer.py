"""The replay buffer of states: what is learned from is what was observed."""

import dataclasses
import shutil
from itertools import pairwise

import numpy as np
import pytest
import torch

from mapf_pz._internal.npz import read_npz, write_npz
from mapf_pz.errors import FormatError
from mapf_pz.rl import train
from mapf_pz.rl.algorithms.expert import NO_LABEL
from mapf_pz.rl.algorithms.named import ALGORITHMS
from mapf_pz.rl.algorithms.state_buffer import STEP_FIELDS, StateBuffer
from mapf_pz.rl.environments.collect import MakeEnv
from mapf_pz.rl.environments.recorded_states import states_of
from mapf_pz.rl.training.train import resume
from tests.helpers.small_run import TINY, changed, rows

TASK = changed(TINY.task, on_target="restart", action_model="cardinal", delays="0.2:1-3")
CONFIG = dataclasses.replace(TINY, algorithm="dagger", task=TASK)
CONFIG = dataclasses.replace(CONFIG, imitation=dataclasses.replace(CONFIG.imitation, replay="states", expert="pibt"))


def collected(config=CONFIG, number=4, num_steps=20):
    """Return a rollout of an untrained policy with the expert's labels."""
    algorithm = ALGORITHMS["dagger"](config)
    env = MakeEnv(algorithm, config, 5, number)()
    torch.manual_seed(0)
    return env.rollout(num_steps, algorithm.actor, break_when_any_done=False)


def buffer_of(config=CONFIG, capacity=10_000, batch_size=16):
    return StateBuffer(config.task.env_config(), capacity, batch_size)


def filled(batch, **options):
    buffer = buffer_of(**options)
    labels = batch["agents", "expert_action"].flatten(0, 1).numpy()
    buffer.extend(states_of(batch, np.ones(len(labels), bool)), labels)
    return buffer


@pytest.mark.parametrize("action_model", ["rotate", "cardinal"])
@pytest.mark.parametrize(
    ("on_target", "weights"), [("restart", "uniform"), ("nothing", "crisscross"), ("nothing", "random")]
)
def test_samples_are_what_was_observed_and_labeled(action_model, on_target, weights):
    fields = {"action_model": action_model, "on_target": on_target, "edge_weights": weights}
    config = dataclasses.replace(CONFIG, task=changed(CONFIG.task, **fields))
    batch = collected(config)
    buffer = filled(batch, config=config)
    observed = batch["agents", "observation"]
    images = (observed if isinstance(observed, torch.Tensor) else observed["image"]).flatten(0, 1).numpy()
    labels = batch["agents", "expert_action"].flatten(0, 1).numpy()
    at_goal = batch["agents", "position"].eq(batch["agents", "goal"]).all(-1).flatten(0, 1).numpy()
    known = {image.tobytes(): k for k, image in enumerate(images)}
    assert len(known) > 40
    found = set()
    for seed in range(10):
        sample = buffer.sample(np.random.default_rng(seed), recent=1000)
        for image, label, at in zip(sample.image, sample.labels, sample.at_goal, strict=True):
            k = known[image.tobytes()]
            found.add(k)
            same = [j for j in range(len(images)) if images[j].tobytes() == image.tobytes()]
            assert any(np.array_equal(labels[j], label) and np.array_equal(at_goal[j], at) for j in same)
    assert len(found) > 30


def test_half_of_a_sample_is_recent():
    batch = collected(num_steps=40)
    buffer = buffer_of(batch_size=64)
    for k in range(4):
        steps = batch[:, 10 * k : 10 * k + 10]
        labels = np.full((40, TASK.num_agents), k)
        buffer.extend(states_of(steps, np.ones(40, bool)), labels)
    drawn = np.concatenate([buffer.sample(np.random.default_rng(s), recent=40).labels[:, 0] for s in range(20)])
    shares = np.bincount(drawn, minlength=4) / len(drawn)
    assert shares == pytest.approx([1 / 8, 1 / 8, 1 / 8, 5 / 8], abs=0.04)


def test_the_oldest_steps_are_dropped():
    batch = collected()
    buffer = buffer_of(capacity=100)
    for k in range(5):
        buffer.extend(states_of(batch[:, :10], np.ones(40, bool)), np.full((40, TASK.num_agents), k))
    assert len(buffer) == 120  # whole parts are dropped
    labels = [buffer.sample(np.random.default_rng(s), recent=1000).labels[:, 0] for s in range(10)]
    assert set(np.concatenate(labels)) == {2, 3, 4}


def test_files(tmp_path):
    batch = collected()
    buffer = filled(batch)
    buffer.save(tmp_path / "a.npz")
    buffer.save(tmp_path / "none.npz")  # nothing new
    assert not (tmp_path / "none.npz").exists()
    loaded = buffer_of()
    loaded.load(tmp_path / "a.npz")
    assert len(loaded) == len(buffer) == 80
    for one, other in zip(*(each.sample(np.random.default_rng(1), 30) for each in (buffer, loaded)), strict=True):
        np.testing.assert_array_equal(one, other)
    loaded.save(tmp_path / "again.npz")
    assert not (tmp_path / "again.npz").exists()  # what was loaded is in a file


def test_malformed_files(tmp_path):
    file = tmp_path / "a.npz"
    filled(collected()).save(file)
    arrays = read_npz(file, ("free", "weight", *STEP_FIELDS))
    for changes in (
        {"cells": arrays["cells"][:, :1]},
        {"labels": arrays["labels"].astype(np.int64)},
        {"free": arrays["free"][:, :-1]},
        {"map": arrays["map"] + 100},
        {"time": arrays["time"][1:]},
        {"labels": arrays["labels"] + np.int8(50)},
    ):
        write_npz(file, arrays | changes)
        with pytest.raises(FormatError, match=r"a\.npz: expected steps of \d+ agents on maps of"):
            buffer_of().load(file)
    file.write_bytes(b"PK")
    with pytest.raises(FormatError, match=r"a\.npz: expected an \.npz file with the arrays free, weight"):
        buffer_of().load(file)


def test_a_run_that_is_resumed_has_all_steps(tmp_path):
    run = tmp_path / "run"
    train(CONFIG, run)
    first = rows(run)
    resume(run, agent_steps=2 * CONFIG.agent_steps)
    sizes = [float(row["buffer"]) for row in rows(run)]
    assert len(sizes) > len(first) > 0
    assert all(b > a for a, b in pairwise(sizes))
    assert len(list((run / "data").glob("*.npz"))) >= 2


def learning_from(run, config=CONFIG):
    return dataclasses.replace(config, imitation=dataclasses.replace(config.imitation, dataset=str(run)))


def test_a_run_learns_from_the_steps_of_another(tmp_path):
    first, second = tmp_path / "first", tmp_path / "second"
    train(CONFIG, first)
    collected = float(rows(first)[-1]["buffer"])
    train(learning_from(first), second)
    resume(second, agent_steps=2 * CONFIG.agent_steps)
    sizes = [float(row["buffer"]) for row in rows(second)]
    assert sizes[: len(rows(first))] == [collected + float(row["buffer"]) for row in rows(first)]
    assert all(b > a for a, b in pairwise(sizes))
    saved = sum(len(read_npz(file, ("time",))["time"]) for file in (second / "data").glob("*.npz"))
    assert saved * TASK.num_agents == sizes[-1] - collected  # its own


def test_steps_that_cannot_be_learned_from(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"first/config\.json: no such file$"):
        train(learning_from(tmp_path / "first"), tmp_path / "second")
    train(CONFIG, tmp_path / "first")
    turning = dataclasses.replace(CONFIG, task=changed(CONFIG.task, action_model="rotate"))
    with pytest.raises(ValueError, match=r"first': expected a run with action_model='rotate', got 'cardinal'$"):
        train(learning_from(tmp_path / "first", turning), tmp_path / "second")
    other = dataclasses.replace(CONFIG, task=changed(CONFIG.task, num_agents=TASK.num_agents + 1))
    with pytest.raises(FormatError, match=r"\.npz: expected steps of \d+ agents on maps of"):
        train(learning_from(tmp_path / "first", other), tmp_path / "second")
    shutil.rmtree(tmp_path / "first" / "data")
    with pytest.raises(FileNotFoundError, match=r"first: expected the folder of a run with replay='states', and a che"):
        train(learning_from(tmp_path / "first"), tmp_path / "second")
    (tmp_path / "first" / "config.json").write_text("[]")
    with pytest.raises(FormatError, match=r"config\.json: "):
        train(learning_from(tmp_path / "first"), tmp_path / "second")
    with pytest.raises(ValueError, match=r"^dataset='.*first': expected replay='states' with dagger$"):
        learning_from(tmp_path / "first", dataclasses.replace(CONFIG, imitation=TINY.imitation))
    assert not (tmp_path / "second").exists()


@pytest.mark.parametrize("fields", [{"on_target": "finish"}, {"num_frames": 2}])
def test_environments_whose_states_are_not_kept(fields):
    config = dataclasses.replace(CONFIG, task=changed(CONFIG.task, **fields))
    message = "replay='states': expected num_frames=1, and agents that stay on the map"
    with pytest.raises(ValueError, match=message):
        ALGORITHMS["dagger"](config).make_learner()


def test_steps_without_labels_are_not_kept():
    config = dataclasses.replace(
        CONFIG, imitation=dataclasses.replace(CONFIG.imitation, expert="lacam:anytime=False", expert_share=0.5)
    )
    algorithm = ALGORITHMS["dagger"](config)
    learner = algorithm.make_learner()
    batch = collected(config, number=8)
    labeled = (batch["agents", "expert_action"] != NO_LABEL).any(-1).sum()
    assert 0 < labeled < 160
    assert learner.learn(batch, 0)["buffer"] == labeled * TASK.num_agents
