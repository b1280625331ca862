import dataclasses

import numpy as np
import pytest
import torch
from gymnasium import spaces
from torchrl.envs import Compose, EnvCreator, ParallelEnv, TransformedEnv, check_env_specs

import mapf_pz
from mapf_pz.commands.render import EpisodeOptions, render
from mapf_pz.config import EnvConfig
from mapf_pz.evaluation import EvaluationTask, evaluate, make_env
from mapf_pz.instances.sources import RandomObstacles
from mapf_pz.rl import BatchedMapfEnv, load_policy, train
from mapf_pz.rl.config import ModelConfig, PPOConfig, TaskConfig, TrainConfig
from mapf_pz.rl.config_file import CONFIG, config_files, load_config
from mapf_pz.rl.observation_shape import ObservationShape, observation_transforms
from mapf_pz.rl.share import Share
from mapf_pz.wrappers import FrameStack, NeighborObservations
from tests.helpers.small_run import changed

FIELDS = {"num_agents": 4, "max_steps": 9, "view_size": (3, 3), "features": ("time", "goal_vector")}
TASK = changed(TaskConfig(), height=7, width=6, **FIELDS)
PLAIN = changed(TASK, features=())
CHANGES = [{"neighbors": 2, "neighbor_radius": 3}, {"num_frames": 3}]
CHANGES += [CHANGES[0] | CHANGES[1], {"num_frames": 2, "neighbors": 5}]


def make(task, num_envs=3, **keywords):
    base = BatchedMapfEnv(num_envs, **(task.env_keywords() | keywords))
    base.set_seed(20)
    return TransformedEnv(base, Compose(*observation_transforms(task)))


def parts(seen):
    """The image and the features of an observation, or of its space."""
    return [seen["image"], seen["features"]] if isinstance(seen, (dict, spaces.Dict)) else [seen]


def batched_parts(task, now):
    seen = now["agents", "observation"]
    return [seen["image"].numpy(), seen["features"].numpy()] if task.env.features else [seen.numpy()]


@pytest.mark.parametrize("changes", CHANGES, ids=str)
@pytest.mark.parametrize("task", [TASK, PLAIN], ids=["dict", "box"])
def test_specs_hold_and_are_the_shapes_that_networks_are_built_for(task, changes):
    task = dataclasses.replace(task, **changes)
    env = make(task)
    check_env_specs(env)
    observed = ObservationShape.of_task(task)
    expected = [observed.image, (observed.features,)] if task.env.features else [observed.image]
    assert [part.shape[2:] for part in batched_parts(task, env.reset())] == expected
    space = make_env(Asking(task), **task.env_keywords()).observation_space("agent_0")
    assert [box.shape for box in parts(space)] == expected


class Asking:
    """A policy only in that it says what it needs."""

    def __init__(self, task):
        self.env_kwargs = task.observation_keywords()
        self.env_wrappers = task.env_wrappers()


@pytest.mark.parametrize("on_target", ["nothing", "finish", "restart"])
@pytest.mark.parametrize("changes", CHANGES, ids=str)
@pytest.mark.parametrize("task", [TASK, PLAIN], ids=["dict", "box"])
def test_a_row_is_the_wrapped_environment(task, changes, on_target):
    """Over several episodes that begin at different times in different rows."""
    task = dataclasses.replace(task, **changes)
    source = RandomObstacles(7, 6, 0.1, 4, 20 if on_target == "restart" else 1)
    keywords = task.env_keywords() | {"source": source, "on_target": on_target}
    env = make(task, **keywords)
    now = env.reset()
    singles = [make_env(Asking(task), **keywords) for _ in range(3)]
    seen = [single.reset(seed=20 + b)[0] for b, single in enumerate(singles)]
    rng = np.random.default_rng(3)
    began = np.zeros(3, int)
    for step in range(40):
        batch = batched_parts(task, now)
        for b, single in enumerate(singles):
            assert set(single.agents) <= seen[b].keys()
            for agent, observation in seen[b].items():
                i = single.possible_agents.index(agent)
                for part, whole in zip(parts(observation), batch, strict=True):
                    assert np.array_equal(part, whole[b, i])
        over = now["done"].clone()
        if step in (4, 6):  # rows 0 and 2 begin anew before their episode's end
            over |= torch.tensor([[True], [False], [step == 6]])
        if over.any():
            now["_reset"] = over
            now = env.reset(now)
            for b in over.flatten().nonzero().flatten().tolist():
                seen[b] = singles[b].reset()[0]
                began[b] += 1
            continue
        actions = rng.choice([0, 0, 0, 1, 2], (3, 4))
        now["agents", "action"] = torch.from_numpy(actions)
        now = env.step(now)["next"]
        for b, single in enumerate(singles):
            acting = {agent: int(actions[b, int(agent[-1])]) for agent in single.agents}
            seen[b] = single.step(acting)[0]
    assert began.min() >= 3
    assert len(set(began.tolist())) > 1


def test_positions():
    env = BatchedMapfEnv(2, num_agents=5, max_steps=100, map=".....\n" * 5, on_target="finish")
    env.set_seed(0)
    torch.manual_seed(0)
    now = env.reset()
    for _ in range(60):
        for b in range(2):
            active = env.simulator.agents["active"][b]
            expected = np.where(active[:, None], env.simulator.positions(b), -1)
            assert np.array_equal(now["agents", "position"][b].numpy(), expected)
        now = env.rand_step(now)["next"]
    assert (now["agents", "position"] == -1).any()


def test_in_a_worker_process():
    task = dataclasses.replace(TASK, num_frames=2, neighbors=2)

    def begin():  # of library names only: a worker cannot import this module
        base = BatchedMapfEnv(3, **task.env_keywords())
        base.set_seed(20)
        return TransformedEnv(base, Compose(*observation_transforms(task)))

    here = begin()
    there = ParallelEnv(1, EnvCreator(begin), mp_start_method="spawn")
    try:
        now, theirs = here.reset(), there.reset()
        for _ in range(3):
            assert (theirs["agents", "observation"][0] == now["agents", "observation"]).all()
            now = here.rand_action(now)
            theirs["agents", "action"] = now["agents", "action"].unsqueeze(0)
            now, theirs = here.step(now)["next"], there.step(theirs)["next"]
    finally:
        there.close()


@pytest.mark.parametrize("algorithm", ["mappo", "central-ppo"])
def test_train_then_play(tmp_path, algorithm):
    config = TrainConfig(
        task=dataclasses.replace(TASK, num_frames=2, neighbors=2, neighbor_radius=3),
        algorithm=algorithm,
        model=ModelConfig(conv_channels=(4,), hidden=16),
        ppo=PPOConfig(num_envs=4, steps_per_batch=16, num_epochs=1, minibatch_size=32),
        agent_steps=600,
    )
    policy = load_policy(train(config, tmp_path))
    assert policy.env_wrappers == (
        ("NeighborObservations", {"neighbors": 2, "radius": 3}),
        ("FrameStack", {"num_frames": 2}),
    )
    task = EvaluationTask("maps", 4, {"source": RandomObstacles(9, 9, 0.2, 4), "max_steps": 10}, episodes=2)
    env = make_env(policy, **task.keywords)
    assert isinstance(env, FrameStack)
    assert isinstance(env.env, NeighborObservations)
    assert [episode.metrics["ep_length"] for episode in evaluate({"it": policy}, [task])] == [10, 10]
    render(EpisodeOptions(tmp_path / "end.png", str(tmp_path), EnvConfig(map="empty-8-8", num_agents=4, max_steps=3)))
    assert (tmp_path / "end.png").stat().st_size > 0


def test_a_plain_task_changes_nothing():
    assert observation_transforms(TASK) == []
    assert TASK.env_wrappers() == ()
    assert isinstance(make_env(Asking(TASK)), mapf_pz.MapfEnv)


@pytest.mark.parametrize(("name", "value"), [("num_frames", 0), ("neighbors", -1), ("neighbor_radius", -1)])
def test_wrong_numbers_are_refused(tmp_path, name, value):
    with pytest.raises(ValueError, match=f"{name}={value}: expected a whole number, "):
        TaskConfig(**{name: value})
    file = tmp_path / "config.json"
    text = config_files(TrainConfig(task=TaskConfig(neighbor_radius=7)))[CONFIG].decode()
    before = {"num_frames": 1, "neighbors": 0, "neighbor_radius": 7}[name]
    file.write_text(text.replace(f'"{name}": {before}', f'"{name}": {value}'))
    with pytest.raises(mapf_pz.FormatError, match=f"{name}={value}"):
        load_config(file)
    if name != "num_frames":
        with pytest.raises(ValueError, match="expected a whole number, 0 or more"):
            Share(*((value, 1) if name == "neighbors" else (1, value)))
