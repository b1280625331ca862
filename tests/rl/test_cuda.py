"""Training on a GPU: needs one, and skips without."""

import dataclasses

import numpy as np
import pytest
import torch

from mapf_pz.rl import BatchedMapfEnv, load_policy, resume, train
from mapf_pz.rl.algorithms.named import ALGORITHMS
from mapf_pz.rl.config import CuriosityConfig, ImitationConfig
from mapf_pz.rl.environments.collect import collecting
from tests.helpers.small_run import TINY, changed, rows

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="torch finds no GPU")

ON_CUDA = dataclasses.replace(TINY, device="cuda", validation_interval=300, validation_episodes=4)
DAGGER = {
    "algorithm": "dagger",
    "task": changed(TINY.task, action_model="cardinal", channels=("view", "heuristic")),
    "imitation": ImitationConfig("pibt", expert_share=0.5, segment_steps=4, augment=True),
}


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


OPTIONS = [
    {"observation_precision": "float16"},
    {"compile": True},
    {"collector": "processes", "num_workers": 2, "overlap": True},
]


@pytest.mark.filterwarnings("ignore::FutureWarning", "ignore::DeprecationWarning", "ignore::UserWarning")
@pytest.mark.parametrize("options", OPTIONS, ids=str)
@pytest.mark.parametrize("algorithm", ["mappo", "central-ppo", "dagger"])
def test_options(tmp_path, algorithm, options):
    config = dataclasses.replace(ON_CUDA, **(DAGGER if algorithm == "dagger" else {"algorithm": algorithm}), **options)
    folder = train(config, tmp_path)
    assert len(rows(folder)) == 3


@pytest.mark.parametrize("replay", ["observations", "states"])
@pytest.mark.parametrize(("shield", "augment"), [(False, False), (True, False), (False, True)])
def test_dagger_trains(tmp_path, shield, augment, replay):
    imitation = dataclasses.replace(DAGGER["imitation"], augment=augment, replay=replay)
    fields = DAGGER | {"task": dataclasses.replace(DAGGER["task"], shield=shield), "imitation": imitation}
    folder = train(dataclasses.replace(ON_CUDA, **fields), tmp_path)
    assert len(rows(folder)) == 3
    assert float(rows(folder)[-1]["buffer"]) > 0


@pytest.mark.parametrize("precision", ["float32", "float16"])
def test_observations_are_those_of_the_cpu(precision):
    """Those of every step: copies from pinned memory are complete before they are read, and are not overwritten."""
    actions = torch.from_numpy(np.random.default_rng(0).integers(4, size=(32, 64, 8)))
    steps = []
    for device in ("cpu", "cuda"):
        env = BatchedMapfEnv(64, device=device, observation_precision=precision, num_agents=8, max_steps=64)
        env.set_seed(0)
        now, seen = env.reset(), []
        for t in range(32):
            seen.append(now["agents", "observation"])
            now["agents", "action"] = actions[t].to(device)
            now = env.step(now)["next"]
        steps.append(torch.stack(seen).cpu())
    assert torch.equal(*steps)


def test_batches_are_collected_on_the_gpu():
    with torch.device("cuda"):
        algorithm = ALGORITHMS["mappo"](ON_CUDA)
    with collecting(algorithm, ON_CUDA, seed=0, updates=1) as collector:
        batch = next(iter(collector))
    assert all(tensor.is_cuda for tensor in batch.values(True, True))


def test_a_run_is_resumed_on_the_cpu(tmp_path):
    train(dataclasses.replace(ON_CUDA, agent_steps=200), tmp_path)
    resume(tmp_path, agent_steps=600, device="cpu")
    assert int(rows(tmp_path)[-1]["agent_steps"]) >= 576


@pytest.mark.parametrize("kind", ["rnd", "random-features", "inverse-dynamics", "disagreement"])
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


@pytest.mark.parametrize("fields", [{}, {"observation_precision": "float16"}, {"algorithm": "central-ppo"}], ids=str)
def test_losses_are_those_of_the_cpu(fields):
    # One minibatch of all steps: permutations are drawn on each device.
    optimization = dataclasses.replace(TINY.optimization, minibatch_size=64)
    config = dataclasses.replace(TINY, optimization=optimization, curiosity=CuriosityConfig("rnd", update_fraction=1.0))
    config = dataclasses.replace(config, **fields)
    algorithms = []
    for device in ("cpu", "cuda"):
        with torch.device(device):
            algorithms.append(ALGORITHMS[config.algorithm](config))
    on_cpu, on_cuda = (algorithm.make_learner() for algorithm in algorithms)
    with collecting(algorithms[0], config, seed=0, updates=1) as collector:
        batch = next(iter(collector))
    on_cuda.restore(on_cpu.tensors())
    losses = []
    for learner in (on_cpu, on_cuda):
        torch.manual_seed(0)
        losses.append(learner.learn(batch.clone(), 0.0))
    assert losses[1] == pytest.approx(losses[0], rel=1e-2, abs=1e-4)
