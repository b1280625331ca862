"""Exported networks act as the policies."""

import json
import sys
from dataclasses import fields

import numpy as np
import pytest
import torch

from mapf_pz.evaluation import make_env
from mapf_pz.rl import load_policy
from mapf_pz.rl.config import TrainConfig
from mapf_pz.rl.policies import onnx_export
from mapf_pz.rl.policies.onnx_export import export_onnx
from tests.helpers.untrained import untrained

POLICIES = {
    "mappo": lambda: load_policy("mappo", deterministic=True),
    "cardinal": lambda: load_policy("mappo-cardinal", deterministic=True),
    "images": lambda: untrained(task={"features": ()}),
    "stacked": lambda: untrained("central-ppo"),
    "communication": lambda: untrained(task={"features": ("pose",)}, communication=1, hidden=32),
    "rounds": lambda: untrained("dagger", task={"features": ("pose",)}, communication=1, hidden=32, decision_rounds=2),
    "residual": lambda: untrained(encoder="residual"),
}
SLOW = ("mappo", "stacked", "communication", "rounds", "residual")


@pytest.fixture(autouse=True)
def packages():
    for name in ("onnx", "onnxruntime", "onnxscript"):
        pytest.importorskip(name)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] if name in SLOW else []) for name in POLICIES]
)
def test_the_outputs_are_those_of_the_policy(name, tmp_path):
    import onnxruntime

    policy, file = POLICIES[name](), tmp_path / "policy.onnx"
    exported = export_onnx(policy, file)
    assert exported.difference < 1e-4
    session = onnxruntime.InferenceSession(file)
    assert exported.inputs.keys() == {part.name for part in session.get_inputs()}
    sizes = {"B": 3, "N": 7}
    inputs = {
        part: np.random.default_rng(0).random([sizes.get(size, size) for size in shape], np.float32)
        for part, shape in exported.inputs.items()
    }
    with torch.no_grad():
        names = [part for part in ("image", "features", "noise") if part in inputs]
        expected = policy.sampler(*(torch.from_numpy(inputs[part]) for part in names))
    expected = expected if isinstance(expected, tuple) else (expected,)
    found = session.run(None, inputs)
    assert len(found) == len(exported.outputs)
    for one, other, shape in zip(found, expected, exported.outputs.values(), strict=True):
        assert one.shape == tuple(sizes.get(size, size) for size in shape)
        np.testing.assert_allclose(one, other.numpy(), atol=1e-4)


@pytest.mark.parametrize("name", ["mappo", "cardinal"])
def test_an_episode_without_torch(name, tmp_path):
    import onnxruntime

    policy = POLICIES[name]()
    export_onnx(policy, tmp_path / "policy.onnx")
    session = onnxruntime.InferenceSession(tmp_path / "policy.onnx")
    env = make_env(policy, map="random-16-16-20", num_agents=8, max_steps=30)
    observations, _ = env.reset(seed=0)
    while env.agents:
        inputs = {part: np.stack([observations[a][part] for a in env.agents])[None] for part in ("image", "features")}
        (logits,) = session.run(["logits"], inputs)
        actions = dict(zip(env.agents, logits[0].argmax(-1).tolist(), strict=True))
        assert actions == policy.act(observations)
        observations = env.step(actions)[0]


@pytest.mark.slow
def test_the_metadata(tmp_path):
    import onnx

    policy = POLICIES["cardinal"]()
    export_onnx(policy, tmp_path / "policy.onnx")
    metadata = {part.key: part.value for part in onnx.load(tmp_path / "policy.onnx").metadata_props}
    assert json.loads(metadata["actions"]) == ["WAIT", "UP", "DOWN", "LEFT", "RIGHT"]
    assert json.loads(metadata["config"]).keys() == {field.name for field in fields(TrainConfig)}


def test_a_recurrent_policy(tmp_path):
    with pytest.raises(ValueError, match=r"^recurrent policies cannot be exported$"):
        export_onnx(untrained(recurrent=12), tmp_path / "policy.onnx")
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_network_that_differs_is_not_written(tmp_path, monkeypatch):
    monkeypatch.setattr(onnx_export, "TOLERANCE", 0.0)
    with pytest.raises(RuntimeError, match=r"^the exported network differs from the policy's by "):
        export_onnx(load_policy("mappo-cardinal"), tmp_path / "policy.onnx")
    assert not list(tmp_path.iterdir())


def test_without_the_packages(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnxscript", None)
    with pytest.raises(ImportError, match=r"pip install 'mapf-pz\[onnx\]'$"):
        export_onnx(load_policy("mappo"), tmp_path / "policy.onnx")
