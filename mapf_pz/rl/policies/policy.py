"""Learned policies: a network and its configuration, in one environment or in a batch of them."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
import torch
from torch import Tensor, nn

from mapf_pz._internal.arrays import Bools, Floats, Ints
from mapf_pz._internal.digest import digest
from mapf_pz.rl.algorithms.named import algorithm_of
from mapf_pz.rl.config import TrainConfig
from mapf_pz.rl.environments.execution import action_probabilities, sampled_preferences
from mapf_pz.rl.networks.batched_network import BatchedNetwork, Memory, Seen
from mapf_pz.rl.networks.joint_actor import DecisionRounds, JointActor
from mapf_pz.rl.networks.observation_shape import ObservationShape, described, shapes_of
from mapf_pz.rl.policies.decision import AttentionRecorder, Decision
from mapf_pz.simulator.actions import ACTION_MODES
from mapf_pz.simulator.config import check_whole
from mapf_pz.simulator.simulator import Observation, Simulator

Infos: TypeAlias = "Mapping[str, Mapping[str, Any]]"
"""Infos by agent, as the environment gives them."""


class LearnedPolicy(ABC):
    """A trained policy: `act(observations) -> actions`, both of them dictionaries by agent, as in the environment.

    Actions are sampled from the network's distribution p, or from the one proportional to p^(1 / temperature), since
    agents that always take the most likely action can block each other forever. A recurrent policy keeps a separate
    hidden state for each agent until `reset_states`.

    A policy that was trained with `mask_actions` only takes actions that the action masks in the environment's infos
    allow, so it acts as `act(observations, infos)`; `needs_infos` is then True.

    `num_agents` is the number of agents that the policy acts for; None: any number.

    `env_kwargs` are the keywords that give an environment the policy's observations;
    `mapf_pz.evaluation.make_env` applies them.
    """

    def __init__(
        self,
        network: nn.Module,
        config: TrainConfig,
        seed: int = 0,
        deterministic: bool = False,
        temperature: float = 1.0,
        decision_rounds: int | None = None,
    ) -> None:
        """Wrap a network.

        Args:
            network: the actor's network.
            config: the configuration of the run that trained it.
            seed: random seed.
            deterministic: take the most likely action instead of sampling, as with temperature 0.
            temperature: temperature of the sampling, 0 or more.
            decision_rounds: number of rounds in which agents decide. None: as in training.

        Raises `ValueError` for a temperature that is negative or not finite, and for a number of rounds that is not a
        whole number, 1 or more, or that the network has not learned.
        """
        if not 0 <= temperature < math.inf:
            raise ValueError(f"temperature={temperature}: expected a finite number, 0 or more")
        self.network = network.eval()
        self.config = config
        self._shape = ObservationShape.of_task(config.task)
        self.env_kwargs = config.task.observation_keywords()
        self.needs_infos = config.model.mask_actions
        self.num_agents = algorithm_of(config.algorithm).fixed_num_agents(config)
        self.temperature = 0.0 if deterministic else float(temperature)
        self._seed = seed
        self._observer: Callable[[Decision], object] | None = None
        model = config.model
        self._decision_rounds = model.decision_rounds if decision_rounds is None else decision_rounds
        check_whole("decision_rounds", self._decision_rounds, least=1)
        self.sampler = self.network
        """What is called: the network, or, if agents decide in rounds, their sampling, which has noise as an input."""
        if isinstance(network, JointActor):
            self.sampler = DecisionRounds(network, self._decision_rounds, self.temperature)
        elif self._decision_rounds > 1:
            raise ValueError(f"decision_rounds={decision_rounds}: expected 1, as in the policy's training")
        self._batched = BatchedNetwork(self.sampler, model.communication > 0, self.num_agents, model.recurrent)
        self.reset_states()

    @property
    def identity(self) -> dict[str, Any]:
        """The digests of the weights and the configuration, and the settings: see `mapf_pz.evaluation.identity`."""
        weights = {name: weight.numpy(force=True) for name, weight in self.network.state_dict().items()}
        settings = {"seed": self._seed, "temperature": self.temperature}
        if self._decision_rounds != self.config.model.decision_rounds:
            settings["decision_rounds"] = self._decision_rounds
        return {"policy": "object", "weights": digest(weights), "configuration": digest(self.config)} | settings

    def act(self, observations: dict[str, Any], infos: Infos | None = None) -> dict[str, int]:
        """Return an action for each agent in `observations`.

        Args:
            observations: the agents' observations.
            infos: the agents' infos, from which a policy with `needs_infos` reads the action masks.

        Raises `ValueError` for observations of another shape, and if infos are needed but not given.
        """
        if self.needs_infos and infos is None:
            raise ValueError("this policy masks actions: expected act(observations, infos)")
        if not observations:
            return {}
        seen = self._seen(observations, infos)
        chosen = self.choose(self.rate(seen, [self._memory]), seen.counts, [self._memory])
        return dict(zip(observations, chosen.tolist(), strict=True))

    def preferences(self, observations: dict[str, Any], infos: Infos | None = None) -> dict[str, Floats]:
        """Return preferences (A,) over actions for each agent; `act` converts them to actions.

        With `needs_infos`, the preference for an action that is not allowed is -inf; without infos, none is masked.
        """
        rated = self.rate(self._seen(observations, infos), [self._memory]) if observations else []
        return dict(zip(observations, rated, strict=True))

    def reset_states(self) -> None:
        """Reset hidden states and random generators; called before each episode, so that they are independent."""
        self._memory = self.new_memory()

    def watch(self, observer: Callable[[Decision], object]) -> None:
        """Call `observer` with each decision from now on, of a policy that acts in one episode at a time."""
        self._observer = observer
        self._attention = AttentionRecorder(self.network)

    def in_batch(self, simulator: Simulator) -> LearnedBatch:
        """Return the policy in all environments of a simulator; raises `ValueError` for other observations."""
        return LearnedBatch(self, simulator)

    def check(self, agent: str, shapes: Any) -> None:
        """Raise `ValueError` unless an observation has the shapes that the network was trained with.

        Args:
            agent: name of the agent that observes.
            shapes: shape of the image; with features, a dictionary with the shapes of `image` and `features`.
        """
        expected: Any = self._shape.image
        if self._shape.features:
            expected = {"image": self._shape.image, "features": (self._shape.features,)}
        if shapes != expected:
            raise ValueError(
                f"observation of {agent!r}: this policy observes {described(expected)}, got {described(shapes)}; "
                "mapf_pz.evaluation.make_env(policy, ...) makes an environment for it"
            )

    def new_memory(self) -> Memory:
        """Return what the policy keeps during an episode, at the beginning of one."""
        return Memory(self._seed)

    def rate(self, seen: Seen, memories: Sequence[Memory]) -> Floats:
        """Return the preferences (R, A) float32 of the agents of several episodes.

        Args:
            seen: what the agents observe, in R rows.
            memories: what the policy keeps during each of these episodes, which is updated.
        """
        with torch.no_grad():
            outputs = self._batched(seen, memories)
            preferences = self._prefer(outputs, seen, memories).numpy()
            if self._observer is not None:
                attention = self._attention.weights
                self._observer(Decision(seen.agents, preferences, attention, **self._distribution(outputs, seen)))
        return preferences

    @abstractmethod
    def choose(self, preferences: Floats, counts: Sequence[int], memories: Sequence[Memory]) -> Ints:
        """Return the actions (R,) int64 for preferences (R, A); episodes have so many rows and these memories."""

    def _seen(self, observations: dict[str, Any], infos: Infos | None) -> Seen:
        """Return the observations of one episode as arrays."""
        for agent, observation in observations.items():
            self.check(agent, shapes_of(observation))
        values = list(observations.values())
        if self._shape.features:
            image, features = (_stack([value[name] for value in values]) for name in ("image", "features"))
        else:
            image, features = _stack(values), None
        mask = None
        if self.needs_infos and infos is not None:
            mask = _stack([infos[name]["action_mask"] for name in observations])
        return Seen([len(values)], list(observations), image, features, mask)

    @abstractmethod
    def _prefer(self, outputs: tuple[Tensor, ...], seen: Seen, memories: Sequence[Memory]) -> Tensor:
        """Return the preferences (R, A) of agents for which the network has these outputs."""

    @abstractmethod
    def _distribution(self, outputs: tuple[Tensor, ...], seen: Seen) -> dict[str, Floats]:
        """Return the fields of `Decision` for the distribution of actions, from the network's outputs."""


class SharedPolicy(LearnedPolicy):
    """Each agent acts by itself, and all share one network: works with any number of agents."""

    def rate(self, seen: Seen, memories: Sequence[Memory]) -> Floats:
        """Return the preferences as in `LearnedPolicy`."""
        if self.sampler is not self.network:
            seen = seen._replace(noise=self._noise(seen, memories))
        return super().rate(seen, memories)

    def _prefer(self, outputs: tuple[Tensor, ...], seen: Seen, memories: Sequence[Memory]) -> Tensor:
        if seen.noise is not None:
            return outputs[1]
        return sampled_preferences(_masked(outputs[0], seen.mask), self.temperature, self._noise(seen, memories))

    def _noise(self, seen: Seen, memories: Sequence[Memory]) -> Tensor:
        """Return noise (R, A) from the exponential distribution, sampled by the generators of the episodes."""
        noise = torch.empty(len(seen.image), self._shape.actions)
        for part, memory in zip(noise.split(list(seen.counts)), memories, strict=True):
            part.exponential_(generator=memory.generator)
        return noise

    def _distribution(self, outputs: tuple[Tensor, ...], seen: Seen) -> dict[str, Floats]:
        return {"probabilities": action_probabilities(_masked(outputs[0], seen.mask), self.temperature).numpy()}

    def choose(self, preferences: Floats, counts: Sequence[int], memories: Sequence[Memory]) -> Ints:
        """Return each agent's best action."""
        return preferences.argmax(-1)


class TeamPolicy(LearnedPolicy):
    """One network acts for all agents: for any number with communication, otherwise for the number of its training."""

    def rate(self, seen: Seen, memories: Sequence[Memory]) -> Floats:
        """Return the preferences as in `LearnedPolicy`; raises `ValueError` for another number of agents."""
        for count in seen.counts:
            if self.num_agents not in (None, count):
                raise ValueError(f"this policy acts for exactly {self.num_agents} agents, {count} observe")
        return super().rate(seen, memories)

    def _prefer(self, outputs: tuple[Tensor, ...], seen: Seen, memories: Sequence[Memory]) -> Tensor:
        mean, scale = outputs
        noise = torch.empty_like(mean)
        for part, memory in zip(noise.split(list(seen.counts)), memories, strict=True):
            part.normal_(generator=memory.generator)
        # A normal distribution to the power 1 / T is one with the scale multiplied by the square root of T.
        return (mean + scale * (math.sqrt(self.temperature) * noise)).clamp(-1, 1)

    def _distribution(self, outputs: tuple[Tensor, ...], seen: Seen) -> dict[str, Floats]:
        return {"means": outputs[0].numpy()}

    def choose(self, preferences: Floats, counts: Sequence[int], memories: Sequence[Memory]) -> Ints:
        """Return the actions that the action mode decodes from the preferences."""
        decode = ACTION_MODES[self.config.task.action_mode]
        parts = np.split(preferences.astype(np.float64), np.cumsum(counts)[:-1])
        return np.concatenate([decode(part, memory.rng) for part, memory in zip(parts, memories, strict=True)])


def _masked(logits: Tensor, mask: Tensor | None) -> Tensor:
    """Return the logits (R, A), -inf for actions that the mask forbids."""
    return logits if mask is None else logits.masked_fill(mask == 0, -torch.inf)


def _stack(arrays: list[np.ndarray]) -> Tensor:
    return torch.from_numpy(np.stack(arrays))


class LearnedBatch:
    """A learned policy in B environments of a simulator. It acts in each of them as in a single environment."""

    def __init__(self, policy: LearnedPolicy, simulator: Simulator) -> None:
        """Begin an episode in each environment.

        Raises `ValueError` if the simulator's observations have another shape than the policy's.
        """
        layout = simulator.layout
        self._has_features = layout.num_features > 0
        features = {"image": layout.image_shape, "features": (layout.num_features,)}
        policy.check("agent_0", features if self._has_features else layout.image_shape)
        self._policy = policy
        self._simulator = simulator
        self._memories = [policy.new_memory() for _ in range(simulator.num_envs)]

    def reset(self, b: int) -> None:
        """Begin an episode in environment `b`."""
        self._memories[b] = self._policy.new_memory()

    def actions(self, observation: Observation, envs: Sequence[int]) -> Ints:
        """Return actions (B, N) int64 for the current state of the simulator.

        Args:
            observation: what the agents observe in this state.
            envs: the environments to act in; in the others, actions are 0.
        """
        mask = observation.action_mask if self._policy.needs_infos else None
        seen, rows, memories = self._select(observation, mask, envs)
        actions = np.zeros(rows.shape, np.int64)
        actions[rows] = self._policy.choose(self._policy.rate(seen, memories), seen.counts, memories)
        return actions

    def preferences(self, observation: Observation, envs: Sequence[int]) -> Floats:
        """Return preferences (B, N, A) float32 over actions; none of them is masked.

        Arguments are those of `actions`. Preferences of agents that have disappeared, and in other environments, are 0.
        """
        seen, rows, memories = self._select(observation, None, envs)
        preferences = np.zeros(observation.action_mask.shape, np.float32)
        preferences[rows] = self._policy.rate(seen, memories)
        return preferences

    def _select(
        self, observation: Observation, mask: Ints | None, envs: Sequence[int]
    ) -> tuple[Seen, Bools, list[Memory]]:
        """Return what is observed in the environments `envs`, by which agents (B, N) bool, and the memories.

        Agents that have disappeared are left out.
        """
        present = self._simulator.agents["was_active"]
        chosen = sorted(envs)
        rows = np.zeros(present.shape, np.bool_)
        rows[chosen] = present[chosen]
        counts, agents = rows[chosen].sum(1).tolist(), rows.nonzero()[1].tolist()
        image = torch.from_numpy(observation.image[rows])
        features = torch.from_numpy(observation.features[rows]) if self._has_features else None
        allowed = None if mask is None else torch.from_numpy(mask[rows])
        return Seen(counts, agents, image, features, allowed), rows, [self._memories[b] for b in chosen]
