import dataclasses
import shutil

import numpy as np
import pytest
import safetensors.torch as safetensors

import mapf_pz
from mapf_pz.commands.main import main
from mapf_pz.commands.train import SUITES
from mapf_pz.evaluation import EvaluationTask, load_suite, make_env, policy_factory
from mapf_pz.evaluation.episodes import run_episodes
from mapf_pz.instances import MapMixture
from mapf_pz.rl import load_policy, policy_names, train
from mapf_pz.rl.policies.folder import bundled
from mapf_pz.rl.presets import PRESETS
from tests.helpers.small_run import TINY, changed

NAMES = policy_names()


def test_the_policies_that_come_with_the_package():
    assert NAMES == [
        "central",
        "central-ppo",
        "central-warehouse",
        "ippo",
        "lifelong",
        "lifelong-cardinal",
        "mappo",
        "mappo-cardinal",
        "oneshot",
        "oneshot-cardinal",
        "report-repaired",
    ]


@pytest.mark.parametrize("name", NAMES)
def test_a_policy_is_small_and_what_its_preset_makes(name):
    folder = bundled() / name
    assert sum(file.stat().st_size for file in folder.iterdir()) < 2_000_000
    config, preset = load_policy(name).config, PRESETS[name]
    if config.initial_policy is not None:  # it was trained in several runs: see the README of the policies
        others = {name: getattr(preset, name) for name in ("agent_steps", "validation_interval", "validation_episodes")}
        config = dataclasses.replace(config, initial_policy=None, **others)
    if config.imitation.expert.endswith("time_limit=0.1"):  # it was trained when time limits were not counted as work
        preset = dataclasses.replace(preset, imitation=config.imitation)
    # Of several seeds, the best is chosen; the precision of learning is that of the machine.
    assert config == dataclasses.replace(preset, seed=config.seed, precision=config.precision)


@pytest.mark.parametrize("episodes", [4, pytest.param(12, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", [name for name in NAMES if name != "lifelong"])
def test_a_policy_routes_agents(name, episodes):
    task = load_suite(SUITES.get(name, "standard"))[0]
    ends = run_episodes(policy_factory(name), task, range(episodes))
    assert np.mean([episode["ISR"] for episode in ends]) > 0.95


@pytest.mark.slow
def test_an_imitated_policy_solves_more_mazes_than_pibt():
    task = PRESETS["oneshot-cardinal"].task
    source = MapMixture(("maze",), 21, 21, loops=0.3).source(48)
    task = EvaluationTask("mazes", 48, task.env_keywords() | {"source": source}, seed=7)
    solved = {
        name: sum(episode["CSR"] for episode in run_episodes(policy_factory(name), task, range(16)))
        for name in ("oneshot-cardinal+pibt", "pibt")
    }
    assert solved["oneshot-cardinal+pibt"] > solved["pibt"]


@pytest.mark.slow
@pytest.mark.parametrize("preset", ["lifelong-cardinal", "lifelong"])
def test_an_imitated_policy_reaches_more_goals_than_pibt_on_maps_like_those_of_its_training(preset):
    keywords = PRESETS[preset].task.env_keywords() | {"max_steps": 128}
    task = EvaluationTask("training maps", 48, keywords, seed=7)
    policy = f"{preset}+pibt:temperature=0,patience=0"
    throughput = {
        name: np.mean([episode["avg_throughput"] for episode in run_episodes(policy_factory(name), task, range(12))])
        for name in (policy, "pibt")
    }
    assert throughput[policy] > throughput["pibt"]


def test_evaluate_by_name(capsys):
    words = "--map empty-8-8 --num-agents 4 --max-steps 64 --episodes 2"
    assert main(["evaluate", "--policy", "mappo", *words.split()]) == 0
    assert "│ empty-8-8 │ 4 " in capsys.readouterr().out


def test_unknown_policies_list_the_known_ones():
    with pytest.raises(
        FileNotFoundError,
        match="expected the folder of a training run, or one of central, central-ppo, central-warehouse, ippo",
    ):
        load_policy("mapo")


def test_a_policy_in_ten_lines():
    policy = load_policy("mappo")
    env = mapf_pz.parallel_env(**policy.env_kwargs, map="random-16-16-20", num_agents=12, max_steps=128)
    observations, _ = env.reset(seed=0)
    policy.reset_states()
    while env.agents:
        observations = env.step(policy.act(observations))[0]
    assert env.metrics()["ISR"] > 0.7


@pytest.mark.parametrize(
    ("name", "keywords", "told"),
    [
        ("mappo", {}, "observes a Dict of image (5, 7, 7), features (14,), got an image (7, 5, 5)"),
        ("mappo", {"view_size": (5, 5)}, "got a Dict of image (5, 5, 5), features (14,)"),
        ("mappo", {"num_last_actions": 3}, "got a Dict of image (5, 7, 7), features (19,)"),
        ("central-ppo", {"view_size": (7, 7)}, "got a Dict of image (5, 7, 7), features (14,)"),
    ],
)
def test_observations_of_another_kind_are_refused(name, keywords, told):
    policy = load_policy(name)
    env = mapf_pz.parallel_env(**(policy.env_kwargs | keywords if keywords else {}), num_agents=4)
    observations, _ = env.reset(seed=0)
    for respond in (policy.act, policy.preferences):
        with pytest.raises(ValueError, match=r"^observation of 'agent_0': ") as caught:
            respond(observations)
        assert told in str(caught.value)
        assert "make_env(policy, ...)" in str(caught.value)
    env = make_env(policy, num_agents=4)
    assert policy.act(env.reset(seed=0)[0]).keys() == set(env.agents)


def test_a_policy_of_images_refuses_more(tmp_path):
    task = changed(TINY.task, features=(), num_neighbors=1)
    policy = load_policy(train(dataclasses.replace(TINY, task=task, agent_steps=192), tmp_path))
    for keywords in ({"num_neighbors": 0}, {"features": ("goal_vector",)}):
        env = mapf_pz.parallel_env(**(policy.env_kwargs | keywords))
        with pytest.raises(ValueError, match=r"this policy observes an image \(10, 3, 3\), got a"):
            policy.act(env.reset(seed=0)[0])
    policy.act(make_env(policy).reset(seed=0)[0])


def test_a_loaded_policy_does_not_change_with_its_file(tmp_path):
    shutil.copytree(bundled() / "mappo", tmp_path / "mine")
    file = tmp_path / "mine" / "policy.safetensors"
    # Weights of 32 bits, which need no conversion, are not a view of the file either.
    safetensors.save_file({name: weight.float() for name, weight in safetensors.load_file(file).items()}, file)
    policy = load_policy(tmp_path / "mine")
    before = policy.identity
    header = 8 + int.from_bytes(file.read_bytes()[:8], "little")
    with file.open("r+b") as out:  # in place, as `cp` does
        out.seek(header)
        out.write(bytes(file.stat().st_size - header))
    assert policy.identity == before
    assert load_policy(tmp_path / "mine").identity != before


def test_a_file_of_weights_that_is_too_large(monkeypatch):
    monkeypatch.setattr("mapf_pz.rl.policies.load.MAX_WEIGHTS_BYTES", 1000)
    with pytest.raises(mapf_pz.FormatError, match=r"policy\.safetensors: expected at most 1000 bytes"):
        load_policy("mappo")
