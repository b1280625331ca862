"""Observations in float16: between environments, batches and the replay buffer."""

import dataclasses

import numpy as np
import pytest
import torch
from torchrl.envs import check_env_specs

from mapf_pz import EnvConfig
from mapf_pz._internal.parallel import job_runner
from mapf_pz.instances import MapMixture
from mapf_pz.rl import BatchedMapfEnv, load_policy, train
from mapf_pz.rl.algorithms.named import ALGORITHMS
from mapf_pz.rl.config import CuriosityConfig, ImitationConfig
from mapf_pz.rl.demonstrations import DatasetConfig, make_dataset
from mapf_pz.simulator.kernels.observation.channels import Channel
from tests.helpers.small_run import TINY, changed, rows

KEYWORDS = {"num_agents": 4, "channels": ("view", "cost_to_go"), "features": ("goal_vector", "pose"), "max_steps": 8}
CARDINAL = changed(TINY.task, action_model="cardinal")


def zeros(_inputs, image, plane):
    image[:, :, plane] = 0


def playing(precision):
    """Yield the observations of eight steps."""
    env = BatchedMapfEnv(3, observation_precision=precision, **KEYWORDS)
    env.set_seed(0)
    now = env.reset()
    for _ in range(8):
        yield now["agents", "observation"]
        now["agents", "action"] = torch.ones(3, 4, dtype=torch.int64)
        now = env.step(now)["next"]


def test_specs_hold():
    env = BatchedMapfEnv(3, observation_precision="float16", **KEYWORDS)
    check_env_specs(env)
    assert env.observation_spec["agents", "observation", "image"].dtype == torch.float16
    check_env_specs(BatchedMapfEnv(3, observation_precision="float16"))  # without features


def test_observations_are_rounded():
    for rounded, exact in zip(playing("float16"), playing("float32"), strict=True):
        for part in ("image", "features"):
            assert rounded[part].dtype == torch.float16
            assert torch.equal(rounded[part], exact[part].half())


def test_poses_are_exact():
    """Communication computes distances from them."""
    for rounded, exact in zip(playing("float16"), playing("float32"), strict=True):
        assert torch.equal(rounded["features"][..., -6:].float(), exact["features"][..., -6:])


@pytest.mark.parametrize("high", [1e6, np.inf])
def test_bounds_that_do_not_fit(high):
    channels = ("view", Channel(zeros, high=high))
    BatchedMapfEnv(2, channels=channels)
    with pytest.raises(ValueError, match=f"observation_precision='float16': .* at most 65504, got {high}"):
        BatchedMapfEnv(2, channels=channels, observation_precision="float16")


@pytest.mark.parametrize(
    "fields",
    [
        {"algorithm": "mappo"},
        {"algorithm": "ippo", "model": dataclasses.replace(TINY.model, recurrent=8)},
        {"algorithm": "central-ppo"},
        {"algorithm": "mappo", "curiosity": CuriosityConfig("inverse-dynamics")},
        {"algorithm": "dagger", "task": CARDINAL, "imitation": ImitationConfig("pibt")},
        {
            "algorithm": "mappo",
            "task": changed(TINY.task, features=("action_advantage", "pose")),
            "model": dataclasses.replace(TINY.model, communication=1, hidden=32),
        },
    ],
    ids=["mappo", "recurrent", "central-ppo", "curiosity", "dagger", "communication"],
)
def test_training_agrees_with_float32(tmp_path, fields):
    seen = {"float32": set(), "float16": set()}

    def make(config):
        algorithm = ALGORITHMS[config.algorithm](config)
        modules = dict(algorithm.network.named_modules())
        name = next(name for name, module in modules.items() if isinstance(module, torch.nn.Conv2d))

        def record(_, inputs):
            seen[config.observation_precision].add(inputs[0].dtype)

        modules[name].register_forward_pre_hook(record)
        return algorithm

    config = dataclasses.replace(TINY, **fields)
    exact, rounded = (
        rows(train(dataclasses.replace(config, observation_precision=name), tmp_path / name, make_algorithm=make))
        for name in ("float32", "float16")
    )
    names = [name for name in exact[0] if name.startswith(("loss", "entropy", "agreement"))]
    assert names
    for one, other in zip(exact, rounded, strict=True):
        for name in names:
            assert float(other[name]) == pytest.approx(float(one[name]), rel=0.01, abs=1e-3)
    assert seen == {"float32": {torch.float32}, "float16": {torch.float32}}
    assert load_policy(tmp_path / "float16").config.observation_precision == "float16"


@pytest.mark.parametrize("algorithm", ["mappo", "dagger"])
def test_what_is_stored(algorithm):
    task = CARDINAL if algorithm == "dagger" else TINY.task
    imitation = ImitationConfig("pibt")
    config = dataclasses.replace(
        TINY, algorithm=algorithm, task=task, imitation=imitation, observation_precision="float16"
    )
    algorithm = ALGORITHMS[config.algorithm](config)
    learner = algorithm.make_learner()
    with algorithm.batches(0, 1) as batches:
        batch = next(batches)
    assert batch["agents", "observation", "image"].dtype == torch.float16
    learner.learn(batch, 0.0)
    stored = learner._replay.sample() if config.algorithm == "dagger" else learner._buffer[:]
    shape = batch["agents", "observation", "image"].shape[-3:]
    images = [value for value in stored.values(True, True) if value.shape[-3:] == shape]
    assert images
    assert {image.dtype for image in images} == {torch.float16}


def test_demonstrations(tmp_path):
    env, mixture = EnvConfig(max_steps=16), MapMixture(height=6, width=6)
    with job_runner(1) as run:
        make_dataset(DatasetConfig("pibt", env, mixture, num_agents=(3,), episodes=4), tmp_path / "data", run)
    config = dataclasses.replace(
        TINY, algorithm="bc", imitation=ImitationConfig(dataset=str(tmp_path / "data")), observation_precision="float16"
    )
    exact, rounded = (
        rows(train(dataclasses.replace(config, observation_precision=name), tmp_path / name))
        for name in ("float32", "float16")
    )
    losses = [[float(row["loss"]) for row in part] for part in (exact, rounded)]
    assert losses[1] == pytest.approx(losses[0], rel=0.01)
