"""Learned policies in folders: their weights as safetensors, and the configuration of their training as JSON."""

from __future__ import annotations

from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import load, save
from torch import Tensor, nn

from mapf_pz._internal.atomic import write_whole
from mapf_pz._internal.text import read_bytes
from mapf_pz.errors import FormatError
from mapf_pz.rl.algorithms.named import algorithm_of
from mapf_pz.rl.config import TrainConfig
from mapf_pz.rl.config_file import CONFIG, load_config
from mapf_pz.rl.policies.folder import WEIGHTS, policy_folder, policy_names
from mapf_pz.rl.policies.policy import LearnedPolicy, SharedPolicy, TeamPolicy

MAX_WEIGHTS_BYTES = 2**30
"""Maximum size of a file of weights."""
_DAMAGE = (SafetensorError, RuntimeError, ValueError, TypeError, LookupError, OverflowError)


def save_weights(folder: Path, network: nn.Module) -> None:
    """Write the network's weights to `folder`, which holds the configuration of the run."""
    write_whole(folder / WEIGHTS, save({name: weight.contiguous() for name, weight in network.state_dict().items()}))


def load_policy(
    policy: str | Path,
    seed: int = 0,
    deterministic: bool = False,
    temperature: float | None = None,
    trust_remote_code: bool = False,
    decision_rounds: int | None = None,
) -> LearnedPolicy:
    """Load a trained policy. It does not change with its files: they are read once.

    Args:
        policy: one of `policy_names()`, the folder of a training run, the weights file in it, or an address
            `hf://USER/NAME` on the Hugging Face Hub: see `mapf_pz.rl.policies.folder.policy_folder`.
        seed: random seed of the policy.
        deterministic: always take the most likely action, as with temperature 0.
        temperature: temperature of the sampling, 0 or more; below 1, likely actions are sampled more often. None: the
            temperature at which the policy acted in its training, `Algorithm.acting_temperature`.
        trust_remote_code: load a policy whose configuration names code outside this package
            (`package.module:name`), which importing runs.
        decision_rounds: number of rounds in which agents decide, 1 or more, of a policy that has learned with more than
            1; None: as in its training. More rounds leave fewer conflicts, and take longer.

    Raises:
        FileNotFoundError: There is no such policy.
        ImportError, OSError: The policy cannot be downloaded.
        FormatError: The files do not fit together, are too large, or name code without `trust_remote_code`.
        ValueError: The temperature is negative or not finite, or the policy cannot have so many rounds.
    """
    folder = policy_folder(policy)
    config = _config_in(folder, policy, trust_remote_code)
    file = folder / WEIGHTS
    content = read_bytes(file, MAX_WEIGHTS_BYTES)
    try:
        network = _network(config, load(content))
    except _DAMAGE as error:
        reason = " ".join(str(error).split())
        raise FormatError(file, f"not the weights that {CONFIG} describes: {reason[:200]}") from None
    algorithm = algorithm_of(config.algorithm)
    kind = TeamPolicy if algorithm.centralized else SharedPolicy
    if temperature is None:
        temperature = algorithm.acting_temperature(config)
    return kind(network, config, seed, deterministic, temperature, decision_rounds)


def policy_config(policy: str | Path, trust_remote_code: bool = False) -> TrainConfig:
    """Return the configuration of a trained policy's run; arguments and errors are those of `load_policy`."""
    return _config_in(policy_folder(policy), policy, trust_remote_code)


def _config_in(folder: Path, policy: str | Path, trust_remote_code: bool) -> TrainConfig:
    """Return the configuration in the folder of a policy, which messages call by its name."""
    for file in (folder / CONFIG, folder / WEIGHTS):
        if not file.is_file():
            expected = f"expected the folder of a training run, or one of {', '.join(policy_names())}"
            raise FileNotFoundError(f"policy {str(policy)!r}: no file {str(file)!r}; {expected}")
    return load_config(folder / CONFIG, trust_remote_code)


def _network(config: TrainConfig, weights: dict[str, Tensor]) -> nn.Module:
    """Return the network with these weights of 16 or 32 bits; whatever the configuration, each takes 32 bits."""
    model = config.model
    encoder_layers = len(model.conv_channels) * (model.num_blocks if model.encoder == "residual" else 1)
    encoder_layers = 0 if ":" in model.encoder else encoder_layers  # unknown for a user's encoder
    num_layers = encoder_layers + model.communication + len(model.head)
    if num_layers > len(weights):
        raise ValueError(f"expected those of {num_layers} layers, got {len(weights)} tensors")
    if any(weight.dtype not in (torch.float16, torch.float32) for weight in weights.values()):
        raise ValueError("expected numbers of 16 or 32 bits")
    with torch.device("meta"):
        network = algorithm_of(config.algorithm).make_network(config)
    network.load_state_dict({name: weight.float() for name, weight in weights.items()}, assign=True)
    return network
