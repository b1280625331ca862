"""Training on a GPU: needs one, and skips without."""

import dataclasses

import pytest
import torch

from mapf_pz.rl import load_policy, resume, train
from mapf_pz.rl.algorithms import ALGORITHMS
from mapf_pz.rl.collect import collecting
from mapf_pz.rl.config import CuriosityConfig
from tests.helpers.small_run import TINY, rows

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="torch finds no GPU")

ON_CUDA = dataclasses.replace(TINY, device="cuda", validation_interval=300, validation_episodes=4)


@pytest.mark.parametrize("algorithm", ["mappo", "ippo", "central-ppo"])
@pytest.mark.parametrize("recurrent", [0, 8])
def test_every_algorithm_trains_and_is_loaded_without_a_gpu(tmp_path, monkeypatch, algorithm, recurrent):
    if recurrent and algorithm == "central-ppo":
        pytest.skip("central-ppo has no recurrent networks")
    model = dataclasses.replace(TINY.model, recurrent=recurrent)
    folder = train(dataclasses.replace(ON_CUDA, algorithm=algorithm, model=model), tmp_path)
    assert len(rows(folder)) == 3
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert load_policy(folder) is not None


@pytest.mark.parametrize("kind", ["rnd", "random-features", "inverse-dynamics"])
def test_curiosity_trains(tmp_path, kind):
    folder = train(dataclasses.replace(ON_CUDA, curiosity=CuriosityConfig(kind)), tmp_path)
    assert float(rows(folder)[-1]["intrinsic_reward"]) > 0


def test_a_run_is_resumed(tmp_path):
    train(dataclasses.replace(ON_CUDA, agent_steps=200), tmp_path)
    resume(tmp_path, agent_steps=600)
    assert int(rows(tmp_path)[-1]["agent_steps"]) >= 576


def test_worker_processes_collect_for_it(tmp_path):
    folder = train(dataclasses.replace(ON_CUDA, collector="processes", num_workers=2), tmp_path)
    assert len(rows(folder)) == 3


def test_losses_are_those_of_the_cpu():
    # One minibatch of all steps: permutations are drawn on each device.
    optimization = dataclasses.replace(TINY.optimization, minibatch_size=64)
    config = dataclasses.replace(TINY, optimization=optimization, curiosity=CuriosityConfig("rnd", update_fraction=1.0))
    algorithms = []
    for device in ("cpu", "cuda"):
        with torch.device(device):
            algorithms.append(ALGORITHMS["mappo"](config))
    on_cpu, on_cuda = (algorithm.make_learner() for algorithm in algorithms)
    with collecting(algorithms[0], config, seed=0, updates=1) as collector:
        batch = next(iter(collector))
    on_cuda.restore(on_cpu.tensors())
    losses = []
    for learner in (on_cpu, on_cuda):
        torch.manual_seed(0)
        losses.append(learner.learn(batch.clone(), 0.0))
    assert losses[1] == pytest.approx(losses[0], rel=1e-2, abs=1e-4)
