"""From preferences to actions: each agent's best action, or the safety layer's choice for all agents."""

from __future__ import annotations

from typing import cast

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torch.nn.functional import one_hot
from torchrl.data import Categorical, Composite, TensorSpec, Unbounded
from torchrl.envs import Transform, TransformedEnv

from mapf_pz.planners.shield.shield import BatchShield
from mapf_pz.rl.environments.batched_env import BatchedMapfEnv
from mapf_pz.simulator.simulator import Simulator


class ExecutePreferences(Transform):
    """Replace the agents' action by preferences: `("agents", "preferences")` (B, N, A) float32, higher is better."""

    def __init__(self, shield: bool = True) -> None:
        """Create the transform.

        Args:
            shield: whether the safety layer (`mapf_pz.planners.Shield`) turns the preferences into actions that are not
                blocked; otherwise each agent takes the action that it prefers.
        """
        super().__init__(in_keys_inv=[("agents", "action")], out_keys_inv=[("agents", "preferences")])
        self._shielded = shield
        self._shield: BatchShield | None = None

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        if self._shielded:
            if self._shield is None:
                self._shield = BatchShield(simulator_of(self))
            self._shield.reset(reset_environments(tensordict, len(tensordict_reset)))
        return tensordict_reset

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        preferences = tensordict.get(("agents", "preferences"), None)
        if preferences is not None:
            if self._shield is None:
                actions = preferences.argmax(-1)
            else:
                actions = torch.from_numpy(self._shield.actions(preferences.detach().cpu().numpy()))
            tensordict.set(("agents", "action"), actions)
        return tensordict

    def transform_input_spec(self, input_spec: TensorSpec) -> TensorSpec:
        """Replace the agents' actions by their preferences."""
        whole = cast("Composite", input_spec)
        action = cast("Categorical", whole["full_action_spec", "agents", "action"])
        preferences = Unbounded(shape=torch.Size([*action.shape, action.n]), dtype=torch.float32)
        agents = Composite(preferences=preferences, shape=action.shape)
        whole["full_action_spec"] = Composite(agents=agents, shape=whole.shape).to(whole.device)
        return whole


def sampled_preferences(logits: Tensor, temperature: float, noise: Tensor) -> Tensor:
    """Return preferences (..., A) whose order is a sample of actions without replacement, from p^(1 / temperature).

    Adding Gumbel noise to logits and sorting them is such a sample (Kool et al., *Stochastic Beams and Where to Find
    Them*, ICML 2019); the best action is a sample from the distribution.

    Args:
        logits: the logarithms (..., A) of the distribution p, up to a constant.
        temperature: 0 or more.
        noise: (..., A), from the exponential distribution with the rate 1.
    """
    return logits - temperature * noise.log()


def action_probabilities(logits: Tensor, temperature: float) -> Tensor:
    """Return the probabilities (..., A) of actions that are sampled as in `sampled_preferences`.

    Args:
        logits: as in `sampled_preferences`.
        temperature: 0 or more; with 0, the action with the highest logit has probability 1.
    """
    if temperature == 0:
        return one_hot(logits.argmax(-1), logits.shape[-1]).float()
    return (logits / temperature).softmax(-1)


class SamplePreferences(nn.Module):
    """Preferences from logits: see `sampled_preferences`."""

    def __init__(self, temperature: float = 1.0) -> None:
        """Create the module for a temperature; with 0, the logits are the preferences."""
        super().__init__()
        self._temperature = temperature

    def forward(self, logits: Tensor) -> Tensor:
        """Return the preferences (..., A)."""
        if self._temperature == 0:
            return logits
        return sampled_preferences(logits, self._temperature, torch.empty_like(logits).exponential_())


class OrderActions(nn.Module):
    """Preferences whose best action has been sampled already; the others are sampled as in `SamplePreferences`."""

    def __init__(self) -> None:
        """Create the module."""
        super().__init__()
        self._others = SamplePreferences()

    def forward(self, logits: Tensor, action: Tensor) -> Tensor:
        """Return the preferences (..., A) for the logits and the action (...) int64, whose preference is infinite."""
        return self._others(logits).scatter(-1, action.unsqueeze(-1), torch.inf)


def simulator_of(transform: Transform) -> Simulator:
    """Return the simulator of the environment that a transform belongs to."""
    env = cast("TransformedEnv", transform.parent)
    return cast("BatchedMapfEnv", env.base_env).simulator


def reset_environments(tensordict: TensorDictBase | None, num_envs: int) -> list[int]:
    """Return the environments that a reset selects by `_reset`; all of them without it."""
    mask = None if tensordict is None else tensordict.get("_reset", None)
    return list(range(num_envs)) if mask is None else mask.reshape(num_envs, -1).any(-1).nonzero().flatten().tolist()
