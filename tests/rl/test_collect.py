import dataclasses

import numpy as np
import pytest
import torch

from mapf_pz.guidance import GuidanceGraph
from mapf_pz.instances import load_map
from mapf_pz.rl import load_policy, train
from mapf_pz.rl.algorithms.named import ALGORITHMS
from mapf_pz.rl.environments.collect import MakeEnv, collecting
from tests.helpers.small_run import TINY, changed, rows

GRAPH = GuidanceGraph.random(load_map("empty-8-8").free, np.random.default_rng(0))


def collected(config, folder):
    """Train for three updates, and return the batches; after the first, the policy becomes one that always waits."""
    algorithms, batches = [], []

    def make_algorithm(config):
        algorithms.append(ALGORITHMS[config.algorithm](config))
        value_estimator = algorithms[0].loss.value_estimator
        value_estimator.register_forward_pre_hook(lambda _module, inputs: batches.append(inputs[0].clone()))
        return algorithms[0]

    def always_wait(_row):
        with torch.no_grad():
            layer = algorithms[0].network.head[-1]
            layer.weight.zero_()
            layer.bias.fill_(-50.0).view(-1, 4)[:, 3] = 50.0

    train(config, folder, always_wait, make_algorithm)
    steps = [batch.reshape(config.optimization.num_envs, -1) for batch in batches]
    return [(batch[algorithms[0].action_key], batch["agents", "position"], batch["agents"]) for batch in steps]


def check_workers(config, folder):
    """Check that training with workers gives what training in this process does, apart from random actions."""
    (first, _, last), (single, _, last_single) = (
        collected(dataclasses.replace(config, collector=collector), folder / collector)
        for collector in (config.collector, "single")
    )
    for (actions, positions, _), (waiting, _, _) in ((first, last), (single, last_single)):
        assert actions.shape == (4, 16, 3)
        assert len(actions.unique()) == 4
        assert len(positions[:, 0].unique(dim=0)) == 4
        assert (waiting == 3).all()  # every step obeys the new policy
    assert torch.equal(first[1][:, 0], single[1][:, 0])  # the same instances
    several, one = rows(folder / config.collector), rows(folder / "single")
    assert [row.keys() for row in one] == [row.keys() for row in several]
    assert [row["agent_steps"] for row in one] == [row["agent_steps"] for row in several]
    assert all(float(row["acting_share"]) == 0 for row in several)  # workers act
    assert all(float(row["collecting_share"]) > 0 for row in several)
    assert load_policy(folder / config.collector).config == config
    return first[2], single[2]


@pytest.mark.usefixtures("forked_processes")
def test_processes(tmp_path):
    task = changed(TINY.task, map="empty-8-8", edge_weights=GRAPH, channels=("view", "edge_weights"))
    config = dataclasses.replace(TINY, task=task, collector="processes", num_workers=2)
    agents, expected = check_workers(config, tmp_path)
    observed, wanted = (group["observation", "image"][:, 0, :, 1:] for group in (agents, expected))
    assert torch.equal(observed, wanted)  # the edge weights of the graph
    assert len(observed.unique()) > 50


@pytest.mark.slow
def test_ray(tmp_path, monkeypatch):
    ray = pytest.importorskip("ray")
    monkeypatch.setenv("RAY_AUTH_MODE", "disabled")
    monkeypatch.setenv("RAY_worker_niceness", "0")  # on a busy machine, its workers would never get their turn
    started, init = [], ray.init
    monkeypatch.setattr(ray, "init", lambda **options: started.append(options) or init(**options))
    config = dataclasses.replace(TINY, algorithm="central-ppo", collector="ray", num_workers=1)
    check_workers(config, tmp_path)
    assert [options["num_cpus"] for options in started] == [1]  # one for each worker
    assert not ray.is_initialized()


def test_environments_are_divided_evenly():
    with pytest.raises(ValueError, match="num_envs=4: expected a multiple of num_workers=3"):
        dataclasses.replace(TINY, collector="processes", num_workers=3)


def test_a_batch_is_overwritten_by_the_next_one():
    algorithm = ALGORITHMS["mappo"](TINY)
    with collecting(algorithm, TINY, seed=0, updates=2) as collector:
        batches = iter(collector)
        first = next(batches)
        first["agents", "mine"] = first["agents", "action"] + 1
        actions = first["agents", "action"].clone()
        second = next(batches)
        assert "mine" not in second["agents"].keys()  # noqa: SIM118 (a TensorDict is not a dict)
        assert torch.equal(first["agents", "action"], second["agents", "action"])
        assert not torch.equal(first["agents", "action"], actions)


@pytest.mark.parametrize("algorithm", ["mappo", "central-ppo", "dagger"])
@pytest.mark.parametrize("recurrent", [0, 8])
def test_transforms_keep_the_device_of_the_specs(algorithm, recurrent):
    """Torch distinguishes the device `cpu:0` from `cpu`, as it does a GPU."""
    if recurrent and algorithm != "mappo":
        pytest.skip("its networks are not recurrent")
    model, device = dataclasses.replace(TINY.model, recurrent=recurrent), torch.device("cpu", 0)
    imitation = dataclasses.replace(TINY.imitation, expert="pibt", replay="states")
    config = dataclasses.replace(TINY, algorithm=algorithm, model=model, imitation=imitation)
    env = MakeEnv(ALGORITHMS[algorithm](config), config, 0, 2, device=device)()
    specs = (env.full_observation_spec, env.full_action_spec, env.full_reward_spec, env.full_done_spec)
    assert all(spec.device == device for whole in specs for spec in whole.values(True, True))
