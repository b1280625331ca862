"""An expert in the loop: a planner that labels the states of the environments, and sometimes acts."""

from __future__ import annotations

from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import cast

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Bounded, Composite, TensorSpec
from torchrl.envs import Transform

from mapf_pz._internal.arrays import Ints
from mapf_pz.planners import Planner, planner_of
from mapf_pz.planners.base import PlanFollower
from mapf_pz.rl.config import ImitationConfig
from mapf_pz.rl.environments.execution import reset_environments, simulator_of

NO_LABEL = -1
"""In place of an expert's action where there is none."""


def is_labeled(agents: TensorDictBase) -> Tensor:
    """Return which agent steps (..., N) have a label to learn from; disappeared agents have none."""
    return (agents.get("expert_action") != NO_LABEL) & agents.get("active").squeeze(-1)


class ExpertActions(Transform):
    """Observe the expert's action in each state: `("agents", "expert_action")` (B, N) int64, or -1.

    Time is divided into segments of `segment_steps` steps, in each of which an environment is controlled either by the
    policy or, with the probability `expert_share`, by the expert (DAgger: Ross et al., 2011).

    Planners that plan one step at a time label every state. A planner of whole paths labels only the segments that it
    controls: it plans at the start of the segment, from a state that the policy has reached. While it has no plan,
    there are no labels, and the policy acts.
    """

    def __init__(self, config: ImitationConfig, seed: int, num_threads: int = 1) -> None:
        """Create the transform; raises `ValueError` for an unknown planner.

        Args:
            config: the expert, and how often it acts.
            seed: random seed of the expert and of the segments.
            num_threads: number of threads, among which the environments are divided. The labels do not depend on it.
        """
        super().__init__(in_keys=[], out_keys=[("agents", "expert_action")])
        planner_of(config.expert)
        self._config = config
        self._seed = seed
        self._num_threads = num_threads
        self._rng = np.random.default_rng(seed)
        self._experts: list[Planner] = []

    def _start(self) -> None:
        """Create an expert for each environment."""
        self._simulator = simulator_of(self)
        num_envs, num_agents = self._simulator.agents.shape
        self._experts = [planner_of(self._config.expert, self._seed + b) for b in range(num_envs)]
        self._experts[0].compile(self._simulator.config.action_model)
        self._threads = ThreadPoolExecutor(self._num_threads)
        self._labels = np.full((num_envs, num_agents), NO_LABEL)
        self._acts = np.zeros(num_envs, np.bool_)  # which environments the expert controls
        self._left = np.zeros(num_envs, np.int64)  # steps that are left of the segment

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        if not self._experts:
            self._start()
        environments = reset_environments(tensordict, len(self._experts))
        for b in environments:
            self._experts[b].reset_states()
            self._left[b] = 0
        self._label(environments)
        return self._with_labels(tensordict_reset)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        self._label(np.flatnonzero(~self._simulator.over).tolist())
        return self._with_labels(next_tensordict)

    def _label(self, environments: Iterable[int]) -> None:
        """Label the current states of environments, and begin the next segments of those in which one is over."""
        labeled: list[int] = []
        for b in environments:
            if self._left[b] == 0:
                self._left[b] = self._config.segment_steps
                self._acts[b] = self._rng.random() < self._config.expert_share
            self._left[b] -= 1
            self._labels[b] = NO_LABEL
            if self._acts[b] or not isinstance(self._experts[b], PlanFollower):
                labeled.append(b)
        self._simulator.require_cost_to_go()  # before the threads, which only read
        # The planners' kernels release the GIL.
        labels = self._threads.map(self._decide, labeled) if self._num_threads > 1 else map(self._decide, labeled)
        for b, label in zip(labeled, labels, strict=True):
            self._labels[b] = label

    def _decide(self, b: int) -> Ints:
        expert = self._experts[b]
        actions = expert.decide(self._simulator, b)
        return actions if not isinstance(expert, PlanFollower) or expert.has_plan else np.full_like(actions, NO_LABEL)

    def _with_labels(self, tensordict: TensorDictBase) -> TensorDictBase:
        return tensordict.set(("agents", "expert_action"), torch.from_numpy(self._labels.copy()))

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Replace the policy's actions by the expert's in the environments that the expert controls."""
        actions = tensordict.get(("agents", "action"), None)
        if actions is not None and self._acts.any():
            acts, labels = (torch.from_numpy(part).to(actions.device) for part in (self._acts, self._labels))
            tensordict.set(("agents", "action"), torch.where(acts[:, None] & (labels != NO_LABEL), labels, actions))
        return tensordict

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Add the expert's actions."""
        whole = cast("Composite", observation_spec)
        shape, num_actions = whole["agents"].shape, whole["agents", "action_mask"].shape[-1]
        label = Bounded(NO_LABEL, num_actions - 1, shape=shape, dtype=torch.int64)
        whole["agents", "expert_action"] = label.to(whole.device)
        return whole
