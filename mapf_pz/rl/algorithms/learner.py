"""The base class of learners, which update an algorithm's networks from batches of steps."""

from __future__ import annotations

import os
import shutil
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn

from mapf_pz.rl.config import TrainConfig
from mapf_pz.rl.ranks import Ranks


class Data(Protocol):
    """What a learner has collected, and keeps in files beside its checkpoints."""

    def save(self, file: Path) -> None:
        """Write what is in no file yet."""
        ...

    def load(self, file: Path) -> None:
        """Add what a file contains; raises `FormatError` if it is malformed or of another run."""
        ...


class Learner(ABC):
    """Networks and their optimizer; the state includes that of torch's random number generator."""

    config: TrainConfig
    """The configuration of the run."""
    device: torch.device
    """The device of the networks."""
    modules: dict[str, nn.Module]
    """The trained modules by name."""
    optimizer: torch.optim.Optimizer
    """The optimizer of all modules; each of its parameter groups has an `initial_lr`."""
    ranks: Ranks = Ranks()
    """The processes that train together; the training loop sets it. Gradients are averaged over them."""

    data: Data | None = None
    """What is kept beside checkpoints; None: nothing."""

    @abstractmethod
    def learn(self, batch: TensorDictBase, done: float) -> dict[str, float]:
        """Update the networks with a batch of B x T steps, and return the means of the loss terms by name.

        Args:
            batch: the batch from the collector.
            done: the completed fraction of the run, in [0, 1].
        """

    def tensors(self) -> dict[str, Tensor]:
        """Return copies of the state that training changes, except learning rates, which `learn` sets."""
        tensors: dict[str, Tensor] = {}
        for part, module in self.modules.items():
            tensors |= {f"{part}/{name}": tensor for name, tensor in module.state_dict().items()}
        for index, entries in self.optimizer.state_dict()["state"].items():
            tensors |= {f"optimizer/{index}/{name}": tensor for name, tensor in entries.items()}
        tensors["random"] = torch.get_rng_state()
        return {name: tensor.detach().cpu().clone().contiguous() for name, tensor in tensors.items()}

    def restore(self, tensors: Mapping[str, Tensor]) -> None:
        """Restore the state that `tensors` returned.

        Raises `RuntimeError`, `LookupError` or `ValueError` if it belongs to other networks.
        """
        self._check_types(tensors)
        modules: dict[str, dict[str, Tensor]] = {part: {} for part in self.modules}
        optimizer: dict[int, dict[str, Tensor]] = {}
        for name, tensor in tensors.items():
            part, _, rest = name.partition("/")
            if part == "optimizer":
                index, _, entry = rest.partition("/")
                optimizer.setdefault(int(index), {})[entry] = tensor.clone()
            elif part != "random":
                modules[part][rest] = tensor.clone()
        for part, module in self.modules.items():
            module.load_state_dict(modules[part])
        groups = self.optimizer.state_dict()["param_groups"]
        self.optimizer.load_state_dict({"state": optimizer, "param_groups": groups})
        torch.set_rng_state(tensors["random"].clone())

    def _check_types(self, tensors: Mapping[str, Tensor]) -> None:
        """Raise `ValueError` for tensors of other types or sizes, which torch would convert."""
        parameters = [parameter for group in self.optimizer.param_groups for parameter in group["params"]]
        expected = {
            f"{part}/{name}": tensor
            for part, module in self.modules.items()
            for name, tensor in module.state_dict().items()
        }
        for name, tensor in tensors.items():
            if name.startswith("optimizer/"):
                parameter = parameters[int(name.split("/")[1])]
                fits = tensor.dtype == parameter.dtype and tensor.shape in ((), parameter.shape)
            else:
                fits = name not in expected or tensor.dtype == expected[name].dtype
            if not fits:
                raise ValueError(f"{name!r} has another type or size, {tensor.dtype} {tuple(tensor.shape)}")

    def compiled(self, module: nn.Module) -> Callable[..., Any]:
        """Return the module, compiled if the configuration has `compile`, with the same parameters.

        Raises `ValueError` if there is no compiler.
        """
        if not self.config.compile:
            return module
        # torch's compilers generate C++ for CPUs, and Triton, which needs a C compiler, for GPUs.
        name, default = ("CXX", "g++") if self.device.type == "cpu" else ("CC", "gcc")
        if shutil.which(os.environ.get(name, default)) is None:
            raise ValueError(f"compile=True: found no compiler; expected {default}, or the path of one in {name}")
        compiled = torch.compile(module)

        def call(*inputs: Tensor | TensorDictBase) -> Any:
            with torch.random.fork_rng([]):  # compilation draws random numbers
                return compiled(*inputs)

        return call

    def anneal(self, done: float) -> float:
        """Decay the learning rates linearly, and return the factor for the completed fraction `done`."""
        factor = 1 - (1 - self.config.optimization.final_learning_rate) * done
        for group in self.optimizer.param_groups:
            group["lr"] = group["initial_lr"] * factor
        return factor

    def autocast(self) -> torch.autocast:
        """Return the context in which losses are computed with the precision of the configuration."""
        mixed = self.config.precision == "bfloat16" or (self.config.precision == "auto" and has_bfloat16(self.device))
        return torch.autocast(self.device.type, torch.bfloat16, enabled=mixed)

    def step(self, loss: Tensor, max_grad_norm: float) -> None:
        """Take one gradient step; the gradients of each module are scaled down to `max_grad_norm`."""
        self.optimizer.zero_grad()
        loss.backward()
        parameters = (parameter for module in self.modules.values() for parameter in module.parameters())
        self.ranks.average([parameter.grad for parameter in parameters if parameter.grad is not None])
        for module in self.modules.values():
            nn.utils.clip_grad_norm_(module.parameters(), max_grad_norm)
        self.optimizer.step()


def has_bfloat16(device: torch.device) -> bool:
    """Return whether a device has instructions for products of bfloat16 numbers, which others emulate slowly."""
    if device.type == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    capabilities = torch.cpu.get_capabilities()
    return any(capabilities.get(name, False) for name in ("avx512_bf16", "amx_bf16"))
