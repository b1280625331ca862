"""Policies by name: planners, trained policies and users' classes, also with the safety layer."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mapf_pz._internal.digest import digest
from mapf_pz._internal.json import parse_object
from mapf_pz._internal.plugins import imported_object
from mapf_pz._internal.suggest import closest
from mapf_pz._internal.text import read_text
from mapf_pz.environment.mapf_env import parallel_env
from mapf_pz.environment.policy import AnyEnv, BatchPolicy, Policy, PolicyFactory, Preferring, check_policy, make_env
from mapf_pz.errors import FormatError
from mapf_pz.guidance.library import check_edge_weights, weights_digest
from mapf_pz.instances.instance import ActionModel
from mapf_pz.planners import PLANNERS, Planner, Shield
from mapf_pz.planners.named import (
    default_options,
    own_code,
    parse_options,
    planner_class,
    planner_options,
    split_options,
)
from mapf_pz.planners.shield.shield import DEPTH, PATIENCE
from mapf_pz.rl.config_file import CONFIG
from mapf_pz.rl.policies.folder import WEIGHTS, bundled, is_policy, policy_folder, policy_names
from mapf_pz.simulator.config import OBSERVATION_FIELDS

SHIELD_SUFFIX = "+pibt"
"""Suffix of a policy's name: PIBT executes its preferences such that no move is blocked."""
WEIGHTS_OPTION = "edge_weights="
"""Option of planners: the guidance graph that determines their costs."""
_TRAINED_OPTIONS = {"temperature": None, "decision_rounds": None}
_SHIELD_OPTIONS = {"patience": PATIENCE, "depth": DEPTH}


def policy_factory(
    name: str, seed: int = 0, deterministic: bool = False, trust_remote_code: bool = False
) -> PolicyFactory:
    """Return a factory for the environment and the policy of this name.

    Args:
        name: one of these:

            - `random`;
            - a planner, optionally with options, such as `epibt` or `epibt:depth=5,time_limit=0.1`, one of which can be
              a guidance graph for its costs, such as `edge_weights=crisscross`;
            - the name of a trained policy of the package, the folder of a training run, or an address `hf://USER/NAME`
              on the Hugging Face Hub, optionally followed by `+pibt` and options, such as `mappo:temperature=0.5` or
              `mappo+pibt:patience=2,temperature=0.5`; `decision_rounds` is one for a policy that decides in rounds;
            - `package.module:Class`, a planner or policy of your own in a module that has been imported, also followed
              by `+pibt` and options. Options are arguments of the class other than `env` and `seed`, which it gets if
              it has them. A policy that is an object, `package.module:name`, has no options.
        seed: random seed of the policy in every episode.
        deterministic: whether a trained policy takes the most likely action instead of sampling one.
        trust_remote_code: whether the configuration of a trained policy may name code outside this package.

    Raises `ValueError` for an unknown name, and for an unknown or invalid option.
    """
    if planner_class(name) is not None:
        named, weights = _without_weights(name)
        factory = PlannerFactory(*planner_options(named), weights, seed)
        factory.kind(seed=seed, **factory.options)  # rejects invalid options
        if weights is not None:
            check_edge_weights(weights)
        return factory
    if name == "random":
        return RandomFactory(seed)
    if (code := own_code(name)) is not None:
        return _factory_of_code(code, name, seed)
    return _factory_of_trained(name, seed, deterministic, trust_remote_code)


def _without_weights(name: str) -> tuple[str, str | None]:
    """Return a planner's name without the option `edge_weights`, and that option; None if there is none."""
    planner, text = split_options(name)
    options = text.split(",")
    weights = [option for option in options if option.startswith(WEIGHTS_OPTION)]
    others = ",".join(option for option in options if option not in weights)
    return f"{planner}:{others}" if others else planner, weights[-1].removeprefix(WEIGHTS_OPTION) if weights else None


def _factory_of_code(code: str, name: str, seed: int) -> PolicyFactory:
    """Return a factory for a policy that is named `package.module:Class` or, an object, `package.module:name`."""
    policy, rest = imported_object(code), name.removeprefix(code)
    if policy is None:
        raise ValueError(f"policy {name!r}: expected an object of a module that is imported; import it first")
    if not isinstance(policy, type):
        if rest:
            raise ValueError(f"policy {name!r}: expected a class before {rest!r}, got an object")
        return factory_for(policy)
    shielded = rest.startswith(SHIELD_SUFFIX)
    _, _, text = rest.partition(":")
    own, layer = default_options(policy), _SHIELD_OPTIONS if shielded else {}
    chosen = parse_options(policy.__name__, layer | own, text)
    options = {option: value for option, value in chosen.items() if option in own}
    return ClassFactory(name, policy, seed, options, layer | {o: v for o, v in chosen.items() if o not in own})


def _factory_of_trained(name: str, seed: int, deterministic: bool, trust_remote_code: bool) -> PolicyFactory:
    """Return a factory for a trained policy by its name; raises as `policy_factory`."""
    shielded, options = name, ""
    if not is_policy(name.removesuffix(SHIELD_SUFFIX)):  # the name of a folder may have a colon
        shielded, _, options = name.rpartition(":")
    trained = shielded.removesuffix(SHIELD_SUFFIX)
    if not is_policy(trained):
        planners, trained_names = ", ".join(PLANNERS), ", ".join(policy_names())
        base = name.partition(":")[0].removesuffix(SHIELD_SUFFIX)
        names = ["random", *PLANNERS, *policy_names()]
        near = "" if base in names else closest(base, names)
        raise ValueError(
            f"policy {name!r}: {near}expected random, a planner ({planners}), a trained policy ({trained_names}), "
            "the folder of a training run, or package.module:Class"
        )
    allowed = _TRAINED_OPTIONS | (_SHIELD_OPTIONS if shielded != trained else {})
    chosen = allowed | parse_options(shielded, allowed, options)
    sampling = {option: chosen.pop(option) for option in _TRAINED_OPTIONS}
    return TrainedFactory(
        trained, seed, deterministic, **sampling, shield_options=chosen, trust_remote_code=trust_remote_code
    )


def check_observed(name: str, keywords: Mapping[str, Any]) -> None:
    """Raise `ValueError` if `keywords` determine observations, and the policy of this name has none."""
    given = [field for field in OBSERVATION_FIELDS if field in keywords]
    if given and (name == "random" or planner_class(name) is not None):
        raise ValueError(f"{given[0]}: expected only with a trained policy, since {name!r} has no observations")


def bundled_policies() -> dict[str, ActionModel]:
    """Return the names of the trained policies of the package, with the action models that they require."""
    configs = {name: bundled() / name / CONFIG for name in policy_names()}
    return {name: parse_object(read_text(file), file)["task"]["env"]["action_model"] for name, file in configs.items()}


def _configuration(file: Path) -> object:
    """Return the configuration of a run, whose digest includes the modules that it names; None if it cannot be read."""
    try:
        return parse_object(read_text(file), file)
    except (FileNotFoundError, FormatError):  # loading the policy reports it
        return None


def factory_for(policy: Policy) -> PolicyFactory:
    """Return a factory that makes the environment for an existing policy; raises `TypeError` if it is not a policy."""
    check_policy(policy)
    return ExistingFactory(policy)


def _check_actions(description: str, policy: object, keywords: dict[str, Any]) -> None:
    """Raise `ValueError` if the policy needs another action model."""
    expected = getattr(policy, "env_kwargs", {}).get("action_model")
    if expected is not None and keywords.get("action_model", expected) != expected:
        raise ValueError(f"{description} requires action_model={expected!r}, got {keywords['action_model']!r}")


@dataclass(frozen=True)
class ExistingFactory:
    """Makes the environment for an existing policy."""

    policy: Policy
    """The policy."""

    @property
    def in_batches(self) -> bool:
        """Whether the policy acts in several episodes at the same time."""
        return isinstance(self.policy, BatchPolicy)

    @property
    def identity(self) -> object:
        """What the policy states as its identity; None if it states none."""
        return getattr(self.policy, "identity", None)

    def __call__(self, keywords: dict[str, Any]) -> tuple[AnyEnv, Policy]:
        """Return the environment and the policy; raises `ValueError` if the policy needs another action model."""
        _check_actions(type(self.policy).__name__, self.policy, keywords)
        return make_env(self.policy, **keywords), self.policy


@dataclass(frozen=True)
class ClassFactory:
    """Makes a policy of a user's class, and its environment."""

    name: str
    """The name: `package.module:Class`, with options."""
    kind: type[Any]
    """The class."""
    seed: int
    """Random seed of the policy in every episode, if the class has an argument `seed`."""
    options: dict[str, Any]
    """Other arguments of the class."""
    shield_options: dict[str, Any]
    """Options of the safety layer that executes its preferences; empty: there is none."""

    @property
    def in_batches(self) -> bool:
        """Whether the policy acts in several episodes at the same time."""
        return hasattr(self.kind, "in_batch")

    @property
    def identity(self) -> dict[str, Any] | None:
        """The class, the options and the seed; see `_stated`."""
        own = _stated(self.kind)
        fields = {"policy": self.name, "options": self.options | self.shield_options, "seed": self.seed}
        return None if own is None else fields | own

    def __call__(self, keywords: dict[str, Any]) -> tuple[AnyEnv, Policy]:
        """Return the environment and the policy; raises `ValueError` if the policy needs another action model."""
        arguments = inspect.signature(self.kind).parameters
        seed = {"seed": self.seed} if "seed" in arguments else {}
        if "env" in arguments:
            _check_actions(f"policy {self.name!r}", self.kind, keywords)
            env = parallel_env(**(getattr(self.kind, "env_kwargs", {}) | keywords))
            policy = self.kind(env=env, **seed, **self.options)
            check_policy(policy)
        else:
            policy = self.kind(**seed, **self.options)
            check_policy(policy)
            _check_actions(f"policy {self.name!r}", policy, keywords)
            env = make_env(policy, **keywords)
        if not self.shield_options:
            return env, policy
        if not isinstance(policy, Preferring):
            raise ValueError(f"policy {self.name!r}: expected a method preferences, which {SHIELD_SUFFIX} needs")
        return env, Shield(policy, env, **self.shield_options)


def _stated(kind: type) -> dict[str, Any] | None:
    """Return what a user's class states as its identity; None, so that results are not reused, if it states nothing."""
    identity = getattr(kind, "identity", None)
    return {"identity": identity} if isinstance(identity, str) else None


@dataclass(frozen=True)
class TrainedFactory:
    """Loads a trained policy, and makes its environment."""

    name: str
    """Name of the policy, or folder of a training run."""
    seed: int
    """Random seed of the policy in every episode."""
    deterministic: bool
    """Whether it takes the most likely action instead of sampling one."""
    temperature: float | None
    """Temperature of the sampling; None: that of its training."""
    decision_rounds: int | None
    """Number of rounds in which agents decide; None: that of its training."""
    shield_options: dict[str, Any]
    """Options of the safety layer that executes its preferences; empty: there is none."""
    trust_remote_code: bool = False
    """Whether its configuration may name code outside this package."""
    in_batches = True
    """Whether the policy acts in several episodes at the same time."""

    @property
    def identity(self) -> dict[str, Any]:
        """The digests of the policy's files, its options and its seed."""
        folder = policy_folder(self.name)
        arrays = {file.name: file for file in folder.glob("*.safetensors")}
        weights = arrays.pop(WEIGHTS, None)
        rounds = {} if self.decision_rounds is None else {"decision_rounds": self.decision_rounds}
        return {
            "policy": "trained",
            "weights": digest(weights),
            "configuration": digest([_configuration(folder / CONFIG), arrays]),
            "options": self.shield_options | {"temperature": self.temperature} | rounds,
            "deterministic": self.deterministic,
            "seed": self.seed,
        }

    def __call__(self, keywords: dict[str, Any]) -> tuple[AnyEnv, Policy]:
        """Return the environment and the policy; raises `ValueError` if the policy needs another action model."""
        from mapf_pz.rl.policies.load import load_policy  # import torch only when it is needed

        policy = load_policy(
            self.name, self.seed, self.deterministic, self.temperature, self.trust_remote_code, self.decision_rounds
        )
        _check_actions(f"policy {self.name!r}", policy, keywords)
        env = make_env(policy, **keywords)
        return env, Shield(policy, env, **self.shield_options) if self.shield_options else policy


@dataclass(frozen=True)
class PlannerFactory:
    """Makes a planner and its environment."""

    name: str
    """Name of the planner, without options."""
    kind: type[Planner]
    """Its class."""
    options: dict[str, Any]
    """Its options."""
    edge_weights: str | None
    """Guidance graph of its costs; None: that of the task."""
    seed: int
    """Random seed of the planner in every episode."""

    @property
    def identity(self) -> dict[str, Any] | None:
        """The planner, its options with the digest of its guidance graph, and its seed; see `_stated`."""
        weights = {} if self.edge_weights is None else {"edge_weights": weights_digest(self.edge_weights)}
        own = {} if self.name in PLANNERS else _stated(self.kind)
        fields = {"policy": self.name, "options": self.options | weights, "seed": self.seed}
        return None if own is None else fields | own

    def __call__(self, keywords: dict[str, Any]) -> tuple[AnyEnv, Policy]:
        """Return the environment and the planner."""
        weights: dict[str, Any] = {} if self.edge_weights is None else {"edge_weights": self.edge_weights}
        env = parallel_env(**(Planner.env_kwargs | keywords | weights))
        return env, self.kind(env, seed=self.seed, **self.options)


@dataclass(frozen=True)
class RandomFactory:
    """Makes the policy `random` and its environment."""

    seed: int
    """Random seed of the policy in every episode."""

    @property
    def identity(self) -> dict[str, Any]:
        """The policy and its seed."""
        return {"policy": "random", "options": {}, "seed": self.seed}

    def __call__(self, keywords: dict[str, Any]) -> tuple[AnyEnv, Policy]:
        """Return the environment and the policy."""
        env = parallel_env(**(Planner.env_kwargs | keywords))
        return env, RandomPolicy(env.simulator.num_actions, self.seed)


class RandomPolicy:
    """Samples actions uniformly."""

    def __init__(self, num_actions: int, seed: int) -> None:
        """Create a policy with `num_actions` actions and a random seed."""
        self._num_actions = num_actions
        self._seed = seed
        self.reset_states()

    def act(self, observations: dict[str, Any]) -> dict[str, int]:
        """Return an action for each agent in `observations`."""
        actions = self._rng.integers(self._num_actions, size=len(observations))
        return dict(zip(observations, actions.tolist(), strict=True))

    def reset_states(self) -> None:
        """Reset all per-episode state. Called before each episode."""
        self._rng = np.random.default_rng((self._seed, 1))  # not the environment's stream
