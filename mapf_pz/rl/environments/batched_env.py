"""The TorchRL environment: B environments of N agents on the kernels, as one `EnvBase`."""

from __future__ import annotations

import inspect
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Bounded, Categorical, Composite, Unbounded, UnboundedDiscrete
from torchrl.envs import EnvBase

from mapf_pz._internal.arrays import Ints
from mapf_pz._internal.config import checked
from mapf_pz._internal.signatures import init_with_fields_of
from mapf_pz.rl.config import ObservationPrecision
from mapf_pz.rl.environments.transfer import to_device
from mapf_pz.simulator.config import BatchConfig, EnvConfig
from mapf_pz.simulator.global_state import STATE_PLANES, global_state
from mapf_pz.simulator.simulator import Simulator


@checked
@dataclass(frozen=True)
class BatchedMapfConfig(BatchConfig):
    """All keywords of `BatchedMapfEnv`; the first four may be given by position."""

    num_envs: int = 64
    """Number of environments B."""
    device: str | torch.device = "cpu"
    """Device of all tensors that the environment returns; it is always stepped on the CPU."""
    observation_precision: ObservationPrecision = "float32"
    """Data type of the observations; `float16` rounds them to 11 significant bits."""
    state: bool = False
    """Whether to return the global state, for centralized critics."""
    metrics: bool = False
    """Whether to return the metrics of each episode at its end."""


class BatchedMapfEnv(EnvBase):
    """Batched multi-agent path finding; all agents form one group, `agents`.

    | key | shape | |
    | --- | --- | --- |
    | `("agents", "observation")` | (B, N, K, h, w) float32 | with `features`: its entries `image` and `features` |
    | `("agents", "action_mask")` | (B, N, A) bool | what the map allows |
    | `("agents", "at_goal")` | (B, N, 1) bool | the last step ended on the agent's goal |
    | `("agents", "arrivals")` | (B, N, 1) int64 | goals reached in this episode (with `nothing`: 0 or 1) |
    | `("agents", "active")` | (B, N, 1) bool | False for agents that have disappeared |
    | `("agents", "delayed")` | (B, N, 1) bool | with `delays`: the agent was delayed in the last step |
    | `("agents", "position")` | (B, N, 2) int64 | [row, col]; -1 for agents that have disappeared |
    | `("agents", "goal")` | (B, N, 2) int64 | the current goal, [row, col] |
    | `("agents", "action")` | (B, N) int64 | |
    | `("agents", "reward")` | (B, N, 1) float32 | |
    | `done`, `terminated`, `truncated` | (B, 1) bool | flags of the team's episode |
    | `state` | (B, 7, H, W) float32 | with `state=True`: `mapf_pz.MapfEnv.state` |
    | `("metrics", "CSR")`, ... | (B, 1) float32 | with `metrics=True`: `mapf_pz.MapfEnv.metrics`; NaN before the end |

    An environment that is done keeps its true final observation until it is reset. With `on_target="finish"`, agents
    that have disappeared observe zeros, receive no reward, and may only wait. `step` raises `ValueError` for actions of
    another dtype, shape or range. With `observation_precision="float16"`, observations have this data type; they are
    rounded before they are copied to the device.
    """

    # The metaclass has a method `__call__`, which would hide the signature of `__init__`.
    __signature__ = inspect.signature(BatchedMapfConfig)

    @init_with_fields_of(BatchedMapfConfig)
    def __init__(self, *arguments: Any, **keywords: Any) -> None:
        """Create the environment; raises as `parallel_env`, and `ValueError` for bounds that float16 cannot hold."""
        config = BatchedMapfConfig(*arguments, **keywords)
        self.config = EnvConfig(**config.keywords())
        num_envs = config.num_envs
        self.simulator = Simulator(self.config, num_envs, config.num_threads)
        super().__init__(device=torch.device(config.device), batch_size=torch.Size([num_envs]))
        self._dtype = OBSERVATION_DTYPES[config.observation_precision]
        num_agents = self.simulator.num_agents
        self.group_map = {"agents": [f"agent_{i}" for i in range(num_agents)]}
        self._seeds: dict[int, int] = {}  # of environments that have not been reset since they were seeded
        self._has_state, self._has_metrics = config.state, config.metrics
        self._make_specs(torch.Size([num_envs, num_agents]))

    def __repr__(self) -> str:
        """Return the numbers of environments and agents, and the size of the maps."""
        height, width = self.simulator.shape
        numbers = f"num_envs={self.simulator.num_envs}, num_agents={self.simulator.num_agents}"
        return f"{type(self).__name__}({numbers}, maps of {height} x {width}, device={self.device})"

    def _make_specs(self, each: torch.Size) -> None:
        batch = self.batch_size
        one, num_actions = torch.Size([*each, 1]), self.simulator.num_actions
        observed = Composite(
            observation=_observation_spec(self.simulator.layout.space(), each, self._dtype),
            action_mask=Binary(num_actions, shape=torch.Size([*each, num_actions]), dtype=torch.bool),
            at_goal=Binary(1, shape=one, dtype=torch.bool),
            arrivals=UnboundedDiscrete(shape=one, dtype=torch.int64),
            active=Binary(1, shape=one, dtype=torch.bool),
            position=Bounded(-1, max(self.simulator.shape) - 1, shape=torch.Size([*each, 2]), dtype=torch.int64),
            goal=Bounded(0, max(self.simulator.shape) - 1, shape=torch.Size([*each, 2]), dtype=torch.int64),
            shape=each,
        )
        if self.simulator.delays is not None:
            observed["delayed"] = Binary(1, shape=one, dtype=torch.bool)
        spec = Composite(agents=observed, shape=batch)
        if self._has_state:
            size = torch.Size([*batch, len(STATE_PLANES), *self.simulator.shape])
            spec["state"] = Bounded(-1, 1, shape=size, dtype=torch.float32)
        if self._has_metrics:
            metrics = {name: Unbounded(shape=torch.Size([*batch, 1])) for name in self.simulator.metric_names}
            spec["metrics"] = Composite(metrics, shape=batch)
        self.observation_spec = spec
        action = Categorical(num_actions, shape=each, dtype=torch.int64)
        self.action_spec = Composite(agents=Composite(action=action, shape=each), shape=batch)
        reward = Unbounded(shape=one, dtype=torch.float32)
        self.reward_spec = Composite(agents=Composite(reward=reward, shape=each), shape=batch)
        flags = {name: Categorical(2, shape=torch.Size([*batch, 1]), dtype=torch.bool) for name in _DONE}
        self.done_spec = Composite(flags, shape=batch)

    def _reset(self, tensordict: TensorDictBase | None = None, **keywords: Any) -> TensorDictBase:
        """Start new episodes in the environments selected by `_reset`, or in all of them without it.

        Raises `TypeError` for keywords, such as the `options` of `MapfEnv.reset`.
        """
        if keywords:
            raise TypeError(f"reset: expected no keywords, got {', '.join(keywords)}")
        mask = None if tensordict is None else tensordict.get("_reset", None)
        chosen = range(self.batch_size[0]) if mask is None else np.flatnonzero(mask.reshape(-1).cpu().numpy()).tolist()
        self.simulator.reset(chosen, {b: self._seeds.pop(b) for b in chosen if b in self._seeds})
        terminated, truncated = torch.zeros(2, *self.batch_size, 1, dtype=torch.bool)
        return self._with_flags(self._observed(), terminated, truncated)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        self.simulator.step(self._checked(tensordict.get(("agents", "action"))))
        simulator = self.simulator
        reward = torch.from_numpy(simulator.agents["reward"].astype(np.float32)).unsqueeze(-1)
        terminated, truncated = (
            torch.from_numpy(flag.copy()).unsqueeze(-1) for flag in (simulator.terminated, simulator.truncated)
        )
        return self._with_flags(self._observed() | {"reward": reward}, terminated, truncated)

    def _checked(self, actions: Tensor) -> Ints:
        """Return the actions as an array; raises `ValueError` unless they are (B, N) int64 in 0 to A - 1."""
        numbers, expected = actions.cpu().numpy(), self.simulator.agents.shape
        if numbers.dtype != np.int64 or numbers.shape != expected:
            got = f"{numbers.dtype} of shape {numbers.shape}"
            raise ValueError(f"('agents', 'action'): expected int64 of shape {expected}, got {got}")
        highest = self.simulator.num_actions - 1
        if numbers.view(np.uint64).max() > highest:  # as unsigned numbers, negative ones are large
            b, i = np.argwhere((numbers < 0) | (numbers > highest))[0]
            raise ValueError(
                f"action {numbers[b, i]} of 'agent_{i}' in environment {b}: expected a whole number from 0 to {highest}"
            )
        return numbers

    def _observed(self) -> dict[str, Tensor | TensorDict]:
        """Return the agents' entries of the observation spec, in new tensors."""
        observation, agents = self.simulator.observe(), self.simulator.agents
        position = self.simulator.coordinates(agents["cell"])
        if self.config.on_target == "finish":
            position[~agents["active"]] = -1
        image = torch.from_numpy(observation.image).to(self._dtype)
        entry: Tensor | TensorDict = image
        if self.simulator.layout.num_features:
            parts = {"image": image, "features": torch.from_numpy(observation.features).to(self._dtype)}
            entry = TensorDict(parts, batch_size=image.shape[:2], device=image.device)
        delayed = {} if self.simulator.delays is None else {"delayed": agents["delayed"].copy()}
        return {
            "observation": entry,
            "action_mask": torch.from_numpy(observation.action_mask.view(np.bool_)),
            "at_goal": torch.from_numpy(agents["at_goal"].copy()).unsqueeze(-1),
            "arrivals": torch.from_numpy(agents["arrivals"].astype(np.int64)).unsqueeze(-1),
            "active": torch.from_numpy(agents["active"].copy()).unsqueeze(-1),
            "position": torch.from_numpy(position),
            "goal": torch.from_numpy(self.simulator.coordinates(agents["goal"])),
            **{name: torch.from_numpy(flags).unsqueeze(-1) for name, flags in delayed.items()},
        }

    def _metrics(self, ended: Tensor) -> TensorDict:
        """Return the metrics of the episodes that have `ended` (B, 1), and NaN for the others."""
        values = {name: torch.full(ended.shape, torch.nan) for name in self.simulator.metric_names}
        for b in ended.squeeze(-1).nonzero().squeeze(-1).tolist():
            for name, value in self.simulator.metrics(b).items():
                values[name][b] = value
        return TensorDict(values, batch_size=self.batch_size)

    def _with_flags(
        self, agents: dict[str, Tensor | TensorDict], terminated: Tensor, truncated: Tensor
    ) -> TensorDictBase:
        # The explicit device saves TensorDict a search through its entries.
        batch, cpu = self.batch_size, torch.device("cpu")
        each = (*batch, self.simulator.num_agents)
        entries: dict[str, Tensor | TensorDict] = {
            "agents": TensorDict(agents, batch_size=each, device=cpu),
            "done": terminated | truncated,
            "terminated": terminated,
            "truncated": truncated,
        }
        if self._has_state:
            entries["state"] = torch.from_numpy(global_state(self.simulator))
        if self._has_metrics:
            entries["metrics"] = self._metrics(entries["done"])
        return to_device(TensorDict(entries, batch_size=batch, device=cpu), self.device)

    def _set_seed(self, seed: int | None) -> None:
        """Seed the next reset of each environment: environment `b` with `seed + b`."""
        self._seeds = {} if seed is None else {b: seed + b for b in range(self.batch_size[0])}


_DONE = ("done", "terminated", "truncated")
OBSERVATION_DTYPES: dict[ObservationPrecision, torch.dtype] = {"float32": torch.float32, "float16": torch.float16}
"""Data types of observations."""


def _observation_spec(space: spaces.Space[Any], each: torch.Size, dtype: torch.dtype) -> Bounded | Composite:
    """Return the spec of a Gymnasium space with the leading dimensions `each`, B x N."""
    if isinstance(space, spaces.Dict):
        return Composite({name: _observation_spec(part, each, dtype) for name, part in space.items()}, shape=each)
    if not isinstance(space, spaces.Box):
        raise TypeError(f"observation space {space}: expected a Box, or a Dict of Boxes")
    largest, most = max(np.abs(space.low).max(), np.abs(space.high).max()), torch.finfo(torch.float16).max
    if dtype == torch.float16 and largest > most:
        raise ValueError(f"observation_precision='float16': expected channels of at most {most:.0f}, got {largest}")
    low, high = (torch.from_numpy(bound).expand(*each, *bound.shape).to(dtype) for bound in (space.low, space.high))
    return Bounded(low, high, shape=low.shape, dtype=dtype)
