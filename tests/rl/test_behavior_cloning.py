"""Behavior cloning: a policy learns the actions of stored demonstrations."""

import dataclasses
from itertools import islice

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from mapf_pz._internal.parallel import job_runner
from mapf_pz.errors import FormatError
from mapf_pz.instances.mixture import MapMixture
from mapf_pz.rl import load_policy, train
from mapf_pz.rl.algorithms.behavior_cloning import of_size
from mapf_pz.rl.algorithms.named import ALGORITHMS
from mapf_pz.rl.config import ImitationConfig
from mapf_pz.rl.demonstrations import DatasetConfig, load_dataset, make_dataset
from mapf_pz.rl.training.train import resume
from mapf_pz.simulator.config import EnvConfig
from tests.helpers.small_run import TINY, changed, rows, untimed

RULES = {"action_model": "cardinal", "on_target": "restart"}
SHIELDED = changed(TINY.task, shield=True, **RULES)


def make(folder, **changes):
    """Make demonstrations of 2 and of 5 agents, neither of which is the number of agents of the task."""
    keywords = {"planner": "pibt", "mixture": MapMixture(height=6, width=6), "num_agents": (2, 5), "episodes": 6}
    config = DatasetConfig(**(keywords | {"env": EnvConfig(max_steps=30, **RULES)} | changes))
    with job_runner(1) as run:
        make_dataset(config, folder, run)
    return str(folder)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    return make(tmp_path_factory.mktemp("demonstrations"))


def cloning(dataset, **changes):
    """Return the configuration of a short run."""
    imitation = ImitationConfig(dataset=dataset, wait_share=1.0)
    return dataclasses.replace(TINY, **({"algorithm": "bc", "task": SHIELDED, "imitation": imitation} | changes))


def agreement(network, dataset):
    """Return the fraction of the demonstrations' actions that are the most likely ones of the network."""
    keywords = SHIELDED.env.keywords()
    same = []
    for batch in islice(load_dataset(dataset).batches(keywords, num_envs=6, seed=9), 60):
        with torch.no_grad():
            (logits,) = network(torch.from_numpy(batch.image), torch.from_numpy(batch.features))
        same.append((logits.argmax(-1).numpy() == batch.actions).ravel())
    return np.concatenate(same).mean()


def test_a_policy_learns_the_actions_of_the_demonstrations(tmp_path, dataset):
    optimization = dataclasses.replace(TINY.optimization, learning_rate=5e-3, num_epochs=4)
    config = cloning(dataset, optimization=optimization, agent_steps=20 * TINY.steps_per_update)
    torch.manual_seed(0)
    before = agreement(ALGORITHMS["bc"](config).network, dataset)
    folder = train(config, tmp_path / "run")
    after = agreement(load_policy(folder).network, dataset)
    assert before < 0.5
    assert after > 0.75
    losses, shown = ([float(row[name]) for row in rows(folder)] for name in ("loss", "agreement"))
    assert losses[-1] < 0.6 * losses[0]
    assert np.mean(shown[-5:]) == pytest.approx(after, abs=0.1)


@pytest.mark.figure
@pytest.mark.parametrize("shield", [False, True])
def test_a_run_is_trained_resumed_and_validated(tmp_path, dataset, shield):
    task = changed(SHIELDED, shield=shield)
    config = cloning(dataset, task=task, agent_steps=384, validation_interval=192, validation_episodes=4)
    once = train(config, tmp_path / "once")
    again = train(config, tmp_path / "again")
    folder = train(dataclasses.replace(config, agent_steps=192), tmp_path / "run")
    resume(folder, agent_steps=384)
    assert untimed(once) == untimed(again)
    assert untimed(folder)[0] == untimed(once)[0]
    first, last = rows(folder)
    assert [int(row["agent_steps"]) for row in (first, last)] == [192, 384]
    assert 0 < float(last["agreement"]) <= 1
    assert float(last["validation_throughput"]) >= (0.1 if shield else 0)
    assert not last.keys() & {"episodes", "throughput", "return"}  # no episodes are played for the data
    assert (folder / "learning_curve.png").is_file()
    assert load_policy(folder).config.imitation.dataset == dataset


def entries(config, seed, number):
    """Return the entries of the first batches, joined."""
    torch.manual_seed(0)
    with ALGORITHMS["bc"](config).batches(seed, number) as batches:
        found = [*islice(batches, number)]
    assert {len(batch) for batch in found} == {config.steps_per_update}
    return torch.cat(found)["agents"]


def test_batches_are_the_agent_steps_of_the_demonstrations_in_order(dataset):
    config = cloning(dataset)
    batches = entries(config, 5, 4)
    steps = load_dataset(dataset).batches(SHIELDED.env.keywords(), num_envs=config.optimization.num_envs, seed=5)
    steps = [*islice(steps, 100)]
    for name, key in [("actions", "expert_action"), ("at_goal", "at_goal"), ("active", "active")]:
        expected = np.concatenate([getattr(step, name).ravel() for step in steps])[: len(batches)]
        assert np.array_equal(batches[key].numpy().ravel(), expected), name
    assert {step.actions.shape[1] for step in steps} == {2, 5}
    for name in ("image", "features"):
        expected = [part for step in steps for part in getattr(step, name).reshape(-1, *getattr(step, name).shape[2:])]
        assert np.array_equal(batches["observation", name].numpy(), np.stack(expected[: len(batches)])), name
    torch.manual_seed(0)
    network = ALGORITHMS["bc"](config).network
    (logits,) = network(batches["observation", "image"], batches["observation", "features"])
    assert torch.allclose(batches["logits"], logits.detach(), atol=1e-5)


def test_a_resumed_run_continues_with_other_batches(tmp_path, monkeypatch, dataset):
    seeds = []

    class Recorded(ALGORITHMS["bc"]):
        def batches(self, seed, updates):
            seeds.append((seed, updates))
            return super().batches(seed, updates)

    config = cloning(dataset, agent_steps=192)
    folder = train(config, tmp_path / "run", make_algorithm=Recorded)
    resume(folder, agent_steps=576, make_algorithm=Recorded)
    assert [updates for _, updates in seeds] == [1, 2]
    one, same, other = (entries(config, seed, 1)["expert_action"] for seed in (seeds[0][0], seeds[0][0], seeds[1][0]))
    assert torch.equal(one, same)
    assert not torch.equal(one, other)


def test_observations_without_features(tmp_path, dataset):
    config = cloning(dataset, task=changed(SHIELDED, features=()), agent_steps=192)
    assert load_policy(train(config, tmp_path)).config == config


def test_agents_that_have_disappeared_are_not_learned_from(tmp_path):
    rules = {"on_target": "finish", "action_model": "rotate"}
    folder = make(tmp_path / "dataset", env=EnvConfig(max_steps=60, **rules), num_agents=(4,))
    config = cloning(folder, task=changed(SHIELDED, **rules))
    batches = entries(config, 0, 4)
    active = int(batches["active"].sum())
    assert 0 < active < len(batches)
    with ALGORITHMS["bc"](config).batches(0, 4) as found:
        learner = ALGORITHMS["bc"](config).make_learner()
        buffer = [learner.learn(batch, 0)["buffer"] for batch in islice(found, 4)][-1]
    assert buffer == active


@pytest.mark.parametrize("algorithm", ["dagger", "mappo"])
def test_other_algorithms_start_from_the_policy(tmp_path, dataset, algorithm):
    cloned = train(cloning(dataset, agent_steps=192), tmp_path / "cloned")
    imitation = ImitationConfig(expert="pibt")
    start = dataclasses.replace(TINY, algorithm=algorithm, task=SHIELDED, imitation=imitation, agent_steps=192, seed=1)
    before = load_policy(cloned).network.state_dict()
    far = {}
    for initial_policy in (None, str(cloned)):
        config = dataclasses.replace(start, initial_policy=initial_policy)
        after = load_policy(train(config, tmp_path / str(initial_policy is None))).network.state_dict()
        far[initial_policy] = max(float((after[name] - before[name]).abs().max()) for name in before)
    assert far[str(cloned)] < 0.02 < 0.2 < far[None]  # one small update


def refused(tmp_path, config, error, message):
    with pytest.raises(error, match=message) as caught:
        train(config, tmp_path / "run")
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "run").exists()


def test_a_run_without_a_dataset_is_refused(tmp_path):
    refused(tmp_path, cloning(None), ValueError, "^dataset=None: expected the folder of a dataset with bc")


def test_folders_without_demonstrations_are_refused(tmp_path, dataset):
    refused(tmp_path, cloning(str(tmp_path / "none")), FileNotFoundError, "none/dataset.json: no such file")
    (tmp_path / "dataset.json").write_text("{}")
    refused(tmp_path, cloning(str(tmp_path)), FormatError, "expected a dataset of the format")


@pytest.mark.parametrize(
    ("rule", "value", "made"),
    [
        ("action_model", "rotate", "cardinal"),
        ("on_target", "nothing", "restart"),
        ("collision_system", "priority", "soft"),
    ],
)
def test_demonstrations_with_other_rules_are_refused(tmp_path, dataset, rule, value, made):
    config = cloning(dataset, task=changed(SHIELDED, **{rule: value}))
    refused(tmp_path, config, ValueError, f"^{rule}='{value}': the demonstrations have {rule}='{made}'$")


def test_recurrent_policies_are_refused(tmp_path, dataset):
    config = cloning(dataset, model=dataclasses.replace(TINY.model, recurrent=8))
    refused(tmp_path, config, ValueError, "^recurrent=8: expected 0 with bc, which uses single steps$")


def test_augmented_locations_are_refused(tmp_path, dataset):
    imitation = ImitationConfig(dataset=dataset, augment=True)
    config = cloning(dataset, imitation=imitation, task=changed(SHIELDED, features=("location",)))
    message = "^augment: expected no feature 'location' with bc, whose maps have any size$"
    refused(tmp_path, config, ValueError, message)


@pytest.mark.parametrize("sizes", [[3], [5, 1, 4], [1, 1, 1, 1], [20], []])
def test_parts_are_divided_into_batches_of_one_size(sizes):
    numbers = torch.arange(sum(sizes))
    parts = [TensorDict({"number": part}, batch_size=len(part)) for part in numbers.split(sizes)]
    batches = [batch["number"].tolist() for batch in of_size(4, parts)]
    assert batches == numbers[: len(numbers) // 4 * 4].reshape(-1, 4).tolist()
