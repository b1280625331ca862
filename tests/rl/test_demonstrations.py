"""Exported demonstrations: what `BatchedMapfEnv` returns when it takes their actions."""

import numpy as np
import pytest

pytest.importorskip("torch")

import torch
from tensordict import TensorDict
from torchrl.data import TensorDictReplayBuffer, TensorStorage
from torchrl.data.replay_buffers.samplers import SliceSampler
from torchrl.envs.utils import step_mdp

from mapf_pz.instances import InstanceList
from mapf_pz.rl.demonstrations import export as exporting
from mapf_pz.rl.demonstrations import load_dataset, make_dataset
from mapf_pz.rl.demonstrations.export import export_demonstrations
from mapf_pz.rl.environments.batched_env import BatchedMapfEnv
from mapf_pz.simulator.config import EnvConfig
from tests.rl.demonstrations.small_dataset import small

STORED = ["observation", "action_mask", "at_goal", "arrivals", "active", "position", "action"]


def dataset(folder, on_target="nothing"):
    make_dataset(small(episodes=7, env=EnvConfig(max_steps=30, on_target=on_target), solved_only=False), folder)
    return load_dataset(folder)


@pytest.mark.parametrize("on_target", ["nothing", "finish", "restart"])
@pytest.mark.parametrize("features", [(), ("time",)])
@pytest.mark.parametrize(
    "num_envs", [pytest.param(1, marks=pytest.mark.slow), 3, pytest.param(32, marks=pytest.mark.slow)]
)
def test_steps_are_those_of_the_environment(tmp_path, monkeypatch, on_target, features, num_envs):
    monkeypatch.setattr(exporting, "NUM_ENVS", num_envs)
    data = dataset(tmp_path / "data", on_target)
    keywords = {"channels": ("view", "cost_to_go"), "features": features, "reward": "progress"}
    export_demonstrations(data, tmp_path / "steps", keywords)
    for group in data.groups():
        exported = TensorDict.load_memmap(tmp_path / "steps" / f"agents-{group[0].num_agents}")
        assert len(exported) == group.num_steps.sum()
        row = 0
        for number, demonstration in enumerate(group):
            source = InstanceList([demonstration.instance])
            env = BatchedMapfEnv(
                num_envs=1, source=source, max_steps=30, on_target=on_target, collision_system="soft", **keywords
            )
            state = env.reset()
            for actions in demonstration.actions.astype(np.int64):
                state["agents", "action"] = torch.from_numpy(actions[None])
                state = env.step(state)
                found = exported[row]
                assert sorted(found["agents"].keys()) == sorted(STORED)
                assert (found["agents"] == state["agents"][0].select(*STORED)).all()
                assert torch.equal(found["next", "agents", "reward"], state["next", "agents", "reward"][0])
                for flag in ("done", "terminated", "truncated"):
                    assert torch.equal(found["next", flag], state["next", flag][0])
                assert found["episode"] == number
                state = step_mdp(state)
                row += 1
            assert exported["next", "done"][row - 1]


def test_a_replay_buffer_samples_parts_of_episodes(tmp_path):
    exported = export_demonstrations(dataset(tmp_path / "data", "restart"), tmp_path / "steps")
    assert exported.keys() == {2, 4}
    sampler = SliceSampler(slice_len=5, traj_key="episode", strict_length=True)
    buffer = TensorDictReplayBuffer(storage=TensorStorage(exported[4]), sampler=sampler, batch_size=20)
    parts = buffer.sample().reshape(4, 5)
    assert (parts["episode"] == parts["episode"][:, :1]).all()
    assert parts["agents", "action"].shape == (4, 5, 4)


def test_the_folder_must_not_exist(tmp_path):
    (tmp_path / "steps").mkdir()
    with pytest.raises(FileExistsError):
        export_demonstrations(dataset(tmp_path / "data"), tmp_path / "steps")


def test_other_rules_are_refused(tmp_path):
    with pytest.raises(ValueError, match="the demonstrations have action_model='rotate'"):
        export_demonstrations(dataset(tmp_path / "data"), tmp_path / "steps", {"action_model": "cardinal"})
