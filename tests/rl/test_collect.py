import dataclasses
import math

import pytest
import torch

from mapf_pz.rl import load_policy, train
from mapf_pz.rl.algorithms import ALGORITHMS
from mapf_pz.rl.collect import collecting
from mapf_pz.rl.learner import Learner
from tests.helpers.small_run import TINY, rows


@pytest.fixture
def config():
    return dataclasses.replace(TINY, num_workers=2)


def collected(config, updates):
    """Collect some batches and learn from each; between them the policy becomes one that always waits."""
    algorithm = ALGORITHMS[config.algorithm](config)
    learner = Learner(algorithm, config)
    batches = []
    with collecting(algorithm, config, config.seed, updates) as collector:
        for batch in collector:
            batches.append(batch.reshape(config.ppo.num_envs, -1).clone())
            assert all(map(math.isfinite, learner.learn(batch, 0.0).values()))
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


def test_ray(config, monkeypatch):
    ray = pytest.importorskip("ray")
    monkeypatch.setenv("RAY_AUTH_MODE", "disabled")
    monkeypatch.setenv("RAY_worker_niceness", "0")  # on a busy machine, its workers would never get their turn
    started, init = [], ray.init
    monkeypatch.setattr(ray, "init", lambda **options: started.append(options) or init(**options))
    config = dataclasses.replace(config, collector="ray")
    check(config, collected(config, 2))
    assert [options["num_cpus"] for options in started] == [2]  # one for each worker
    assert not ray.is_initialized()


def test_processes_train_like_one(tmp_path, config):
    config = dataclasses.replace(config, algorithm="central-ppo")
    for collector in ("single", "processes"):
        train(dataclasses.replace(config, collector=collector), tmp_path / collector)
    one, several = rows(tmp_path / "single"), rows(tmp_path / "processes")
    assert [row.keys() for row in one] == [row.keys() for row in several]
    assert [row["agent_steps"] for row in one] == [row["agent_steps"] for row in several]
    assert all(float(row["acting_share"]) == 0 for row in several)  # workers act
    assert all(float(row["collecting_share"]) > 0 for row in several)
    load_policy(tmp_path / "processes")


def test_environments_are_divided_evenly(config):
    with pytest.raises(ValueError, match="num_envs=4: expected a multiple of num_workers=3"):
        dataclasses.replace(config, collector="processes", num_workers=3)
