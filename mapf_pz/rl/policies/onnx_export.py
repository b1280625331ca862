"""A policy's network as an ONNX file, which acts without torch: in C++, in a browser, or on a robot.

Requires onnx, onnxscript and onnxruntime: `mapf-pz[onnx]`. The inputs are `image` and, if they are observed,
`features`, of B teams of N agents, which may be any numbers; of a network for a fixed number of agents, the channels
and features of all agents of a team, in sequence. The outputs are the `logits` of the actions, or of a
centralized policy the `means` and `scales` of the preferences. Agents that decide in rounds also have the input
`noise` (B, N, A), from the exponential distribution with the rate 1, and the output `preferences`: each agent takes
the action that it prefers.
"""

from __future__ import annotations

import json
import logging
import math
import warnings
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from mapf_pz._internal.atomic import write_whole
from mapf_pz.instances.sources import RandomObstacles
from mapf_pz.rl.config_file import config_values
from mapf_pz.rl.networks.batched_network import BatchedNetwork, Memory, Seen
from mapf_pz.rl.policies.policy import LearnedPolicy, TeamPolicy
from mapf_pz.simulator.actions import Action, CardinalAction
from mapf_pz.simulator.config import EnvConfig
from mapf_pz.simulator.simulator import Simulator

NUM_OBSERVATIONS = 1000
"""Number of observations on which the exported network is compared with the policy's."""
TOLERANCE = 1e-4
"""Largest difference of an output, as a fraction of the largest output, or of 1 if that is less."""
_AGENTS = 10


@dataclass(frozen=True)
class Exported:
    """An exported network."""

    inputs: dict[str, tuple[Any, ...]]
    """The shapes of the inputs by name; B and N are any numbers."""
    outputs: dict[str, tuple[Any, ...]]
    """The shapes of the outputs."""
    difference: float
    """The largest difference of an output from that of the policy's network, in `NUM_OBSERVATIONS` observations."""


def export_onnx(policy: LearnedPolicy, path: str | Path) -> Exported:
    """Write a policy's network to an ONNX file, whose metadata have the names of the actions and the configuration.

    Raises `ImportError` without the packages, `ValueError` for a recurrent policy, whose GRU (of TorchRL) has no ONNX
    form, and `RuntimeError` if the exported network has other outputs.
    """
    if policy.config.model.recurrent:
        raise ValueError("recurrent policies cannot be exported")
    onnx, onnxruntime = _packages()
    seen = _observations(policy)
    recorder = _Recorder(policy.sampler)
    expected = _run(policy, recorder, seen)
    inputs = ["image"] + ["features"] * (seen.features is not None) + ["noise"] * (seen.noise is not None)
    outputs = ["means", "scales"] if isinstance(policy, TeamPolicy) else ["logits", "preferences"][: len(expected)]
    dimensions = ("B", "N") if policy.num_agents is None else ("B",)
    dynamic = dict.fromkeys(range(len(dimensions)), torch.export.Dim.DYNAMIC)
    with _quiet():
        program = torch.onnx.export(
            policy.sampler,
            recorder.inputs,
            input_names=inputs,
            output_names=outputs,
            dynamic_shapes=tuple(dynamic for _ in recorder.inputs),
            dynamo=True,
            verbose=False,
        )
    assert program is not None
    model = program.model_proto
    onnx.helper.set_model_props(model, _metadata(policy))
    content = model.SerializeToString()
    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    found = _run(policy, _Session(session, inputs), seen)
    differences = [float((one - other).abs().max()) for one, other in zip(found, expected, strict=True)]
    if any(d > TOLERANCE * max(1.0, float(e.abs().max())) for d, e in zip(differences, expected, strict=True)):
        raise RuntimeError(f"the exported network differs from the policy's by {max(differences):.3g}")
    write_whole(Path(path), content)
    inputs_of, outputs_of = (
        {part.name: (*dimensions, *part.shape[len(dimensions) :]) for part in parts}
        for parts in (session.get_inputs(), session.get_outputs())
    )
    return Exported(inputs_of, outputs_of, max(differences))


def _packages() -> tuple[Any, Any]:
    """Return the modules onnx and onnxruntime."""
    try:
        import_module("onnxscript")  # torch.onnx imports it
        return import_module("onnx"), import_module("onnxruntime")
    except ImportError as error:
        raise ImportError(f"{error}: pip install 'mapf-pz[onnx]'") from error


def _metadata(policy: LearnedPolicy) -> dict[str, str]:
    actions = CardinalAction if policy.config.task.env.action_model == "cardinal" else Action
    names = [action.name for action in actions]
    return {"actions": json.dumps(names), "config": json.dumps(config_values(policy.config))}


def _observations(policy: LearnedPolicy) -> Seen:
    """Return `NUM_OBSERVATIONS` observations, or a few more, of agents that move at random on random maps."""
    num_agents = policy.num_agents or _AGENTS
    num_envs = math.ceil(NUM_OBSERVATIONS / num_agents)
    source = RandomObstacles(24, 24, 0.2, num_agents)
    keywords: dict[str, Any] = {**policy.env_kwargs, "source": source, "num_agents": num_agents}
    simulator = Simulator(EnvConfig(**keywords), num_envs)
    simulator.reset(seeds={b: b for b in range(num_envs)})
    rng = np.random.default_rng(0)
    for _ in range(4):
        simulator.step(rng.integers(simulator.num_actions, size=(num_envs, num_agents)))
    observed = simulator.observe()
    image, features = (torch.from_numpy(part.copy()).flatten(0, 1) for part in (observed.image, observed.features))
    agents = list(range(num_agents)) * num_envs
    seen = Seen([num_agents] * num_envs, agents, image, features if features.shape[-1] else None)
    if policy.config.model.decision_rounds == 1:
        return seen
    noise = rng.exponential(size=(num_envs * num_agents, simulator.num_actions))
    return seen._replace(noise=torch.from_numpy(noise.astype(np.float32)))


def _run(policy: LearnedPolicy, network: Any, seen: Seen) -> tuple[Tensor, ...]:
    """Return the outputs of a network that is called like the policy's."""
    batched = BatchedNetwork(network, policy.num_agents is None, policy.num_agents, recurrent=0)
    with torch.no_grad():
        return batched(seen, [Memory(0) for _ in seen.counts])


class _Recorder:
    """A network that remembers the inputs of its last call."""

    def __init__(self, network: torch.nn.Module) -> None:
        self._network = network
        self.inputs: tuple[Tensor, ...] = ()

    def __call__(self, *inputs: Tensor) -> Any:
        self.inputs = inputs
        return self._network(*inputs)


class _Session:
    """An exported network as one of torch."""

    def __init__(self, session: Any, names: Sequence[str]) -> None:
        self._session = session
        self._names = names

    def __call__(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        feed = {name: part.numpy() for name, part in zip(self._names, inputs, strict=True)}
        return tuple(map(torch.from_numpy, self._session.run(None, feed)))


@contextmanager
def _quiet() -> Generator[None, None, None]:
    """Hide warnings of the exporter about itself, and that torchvision is not installed, which no network needs."""
    logger = logging.getLogger("torch.onnx")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(level)
