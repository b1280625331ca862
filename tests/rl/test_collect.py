import dataclasses

import pytest
import torch

from mapf_pz.rl import load_policy, train
from mapf_pz.rl.algorithms import ALGORITHMS
from mapf_pz.rl.collect import collecting
from tests.helpers.small_run import TINY, rows


@pytest.fixture
def config():
    return dataclasses.replace(TINY, num_workers=2)


def collected(config, updates):
    """Collect some batches; between them the policy becomes one that always waits."""
    algorithm = ALGORITHMS[config.algorithm](config)
    batches = []
    with collecting(algorithm, config, config.seed, updates) as collector:
        for batch in collector:
            batches.append(batch.reshape(config.ppo.num_envs, -1).clone())
            with torch.no_grad():
                for parameter in algorithm.network.head[-1].parameters():
                    parameter.zero_()
                algorithm.network.head[-1].bias[3] = 50.0
            collector.update_policy_weights_()
    return batches


def check(config, batches):
    """Every step of the second batch obeys the new policy, and instances are those of a single process."""
    single = collected(dataclasses.replace(config, collector="single"), 2)
    assert [tuple(batch.shape) for batch in batches] == [(4, 16), (4, 16)]
    for first, second in (batches, single):
        assert len(first["agents", "action"].unique()) == 4
        assert (second["agents", "action"] == 3).all()
    one, other = batches[0]["agents", "position"][:, 0], single[0]["agents", "position"][:, 0]
    assert torch.equal(one, other)
    assert len(one.unique(dim=0)) == 4


def test_processes(config):
    config = dataclasses.replace(config, collector="processes")
    check(config, collected(config, 2))


def test_ray(config, monkeypatch, tmp_path):
    ray = pytest.importorskip("ray")
    monkeypatch.setenv("RAY_AUTH_MODE", "disabled")
    monkeypatch.setenv("RAY_worker_niceness", "0")  # on a busy machine, its workers would never get their turn
    config = dataclasses.replace(config, collector="ray")
    check(config, collected(config, 2))
    train(config, tmp_path / "ray")
    assert not ray.is_initialized()
    train(dataclasses.replace(config, collector="single"), tmp_path / "single")
    one, several = rows(tmp_path / "single"), rows(tmp_path / "ray")
    assert [row.keys() for row in one] == [row.keys() for row in several]
    assert [row["agent_steps"] for row in one] == [row["agent_steps"] for row in several]
    load_policy(tmp_path / "ray")


@pytest.mark.parametrize("algorithm", ["mappo", "central-ppo"])
def test_processes_train_like_one(tmp_path, config, algorithm):
    config = dataclasses.replace(config, algorithm=algorithm)
    for collector in ("single", "processes"):
        train(dataclasses.replace(config, collector=collector), tmp_path / collector)
    one, several = rows(tmp_path / "single"), rows(tmp_path / "processes")
    assert [row.keys() for row in one] == [row.keys() for row in several]
    assert [row["agent_steps"] for row in one] == [row["agent_steps"] for row in several]
    load_policy(tmp_path / "processes")


def test_environments_are_shared_out_evenly(config):
    with pytest.raises(ValueError, match="num_envs=4: expected a multiple of num_workers=3"):
        dataclasses.replace(config, collector="processes", num_workers=3)
