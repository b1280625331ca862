"""Behavior cloning: supervised learning of the actions in stored demonstrations."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase, cat
from torch import Tensor

from mapf_pz.rl.algorithms.imitation import Imitation
from mapf_pz.rl.config import TrainConfig
from mapf_pz.rl.demonstrations import Batch, load_dataset
from mapf_pz.rl.environments.batched_env import OBSERVATION_DTYPES
from mapf_pz.rl.environments.transfer import to_device


class BehaviorCloning(Imitation):
    """Behavior cloning: learn a planner's actions in the states that it visits (Pomerleau, Neural Computation 1991).

    The demonstrations may have any map sizes and numbers of agents.
    """

    def __init__(self, config: TrainConfig) -> None:
        """Build the network.

        Raises `ValueError` without a dataset, with `recurrent` or `communication`, and with `augment` for the feature
        `location`, which cannot be transformed: it is relative to the size of the map, and sizes differ.
        """
        if config.model.communication:
            expected = f"0 with {config.algorithm}, which uses separate agent steps"
            raise ValueError(f"communication={config.model.communication}: expected {expected}")
        if config.imitation.dataset is None:
            expected = f"the folder of a dataset with {config.algorithm} (`mapf-pz dataset make` makes one)"
            raise ValueError(f"dataset=None: expected {expected}")
        if config.imitation.augment and "location" in config.task.env.features:
            raise ValueError(
                f"augment: expected no feature 'location' with {config.algorithm}, whose maps have any size"
            )
        self._folder = config.imitation.dataset
        super().__init__(config)

    @contextmanager
    def batches(self, seed: int, updates: int) -> Generator[Iterator[TensorDictBase]]:
        """Yield an iterator over batches of demonstrations without end; the order of demonstrations is random.

        A batch has S agent steps, as many as an update counts; its entries have the batch size (S,).

        Raises:
            FileNotFoundError: there is no such dataset.
            FormatError: a file of it is malformed.
            ValueError: the task has another `action_model`, `collision_system` or `on_target`.
        """
        config, dataset = self.config, load_dataset(self._folder)
        steps = dataset.batches(config.task.env.keywords(), config.optimization.num_envs, seed, config.num_threads)
        yield of_size(config.steps_per_update, map(self._agent_steps, steps))

    def _agent_steps(self, step: Batch) -> TensorDictBase:
        """Return a step of several demonstrations as separate agent steps, with the entries that the learner needs."""
        dtype = OBSERVATION_DTYPES[self.config.observation_precision]
        image, features = _of_each_agent(step.image).to(dtype), _of_each_agent(step.features).to(dtype)
        size = torch.Size([len(image)])
        agents = {
            "expert_action": _of_each_agent(step.actions),
            "at_goal": _of_each_agent(step.at_goal).unsqueeze(-1),
            "active": _of_each_agent(step.active).unsqueeze(-1),
            "observation": image,
        }
        if self.observation_shape.features:
            agents["observation"] = TensorDict({"image": image, "features": features}, batch_size=size)
        steps = TensorDict({"agents": TensorDict(agents, batch_size=size)}, batch_size=size, device="cpu")
        steps = to_device(steps, next(self.network.parameters()).device)
        with torch.no_grad():
            (logits,) = self.network(*(steps.get(key) for key in self.observation_keys()))
        return steps.set(("agents", "logits"), logits)


def of_size(size: int, parts: Iterable[TensorDictBase]) -> Iterator[TensorDictBase]:
    """Yield the entries of all parts in batches of `size`; a part may have more or fewer."""
    waiting: list[TensorDictBase] = []
    for part in parts:
        waiting.append(part)
        while sum(map(len, waiting)) >= size:
            joined: Any = cat(waiting)  # its slices are annotated as tensors
            yield joined[:size]
            waiting = [joined[size:]]


def _of_each_agent(array: np.ndarray) -> Tensor:
    """Return an array (B, N, ...) as a tensor (B * N, ...)."""
    return torch.from_numpy(array).flatten(0, 1)
