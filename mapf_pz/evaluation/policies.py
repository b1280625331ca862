"""Policies by name: planners, trained policies, and trained policies shielded by PIBT."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mapf_pz._internal.digest import digest
from mapf_pz._internal.json import parse_object
from mapf_pz._internal.suggest import closest
from mapf_pz._internal.text import read_text
from mapf_pz.environment.mapf_env import parallel_env
from mapf_pz.errors import FormatError
from mapf_pz.evaluation.batch import BatchPolicy
from mapf_pz.evaluation.episodes import AnyEnv, Policy, PolicyFactory, check_policy, make_env
from mapf_pz.evaluation.random_policy import RandomPolicy
from mapf_pz.guidance.library import check_edge_weights, weights_digest
from mapf_pz.instances.instance import ActionModel
from mapf_pz.planners import PLANNERS, Planner, Shield, planner_of
from mapf_pz.planners.named import parse_options, planner_options
from mapf_pz.planners.shield.shield import DEPTH, PATIENCE
from mapf_pz.rl.config_file import CONFIG
from mapf_pz.rl.policies.folder import WEIGHTS, bundled, is_policy, policy_folder, policy_names
from mapf_pz.simulator.config import OBSERVATION_FIELDS

SHIELD_SUFFIX = "+pibt"
"""Suffix of a trained policy's name: PIBT executes its preferences without collisions."""
WEIGHTS_OPTION = "edge_weights="
"""Option of planners: the guidance graph that determines their costs."""
_TRAINED_OPTIONS = {"temperature": None}
_SHIELD_OPTIONS = {"patience": PATIENCE, "depth": DEPTH}


def policy_factory(
    name: str, seed: int = 0, deterministic: bool = False, trust_remote_code: bool = False
) -> PolicyFactory:
    """Return a factory for the environment and the policy of this name.

    Args:
        name: `random`; a planner, optionally with options, such as `epibt` or `epibt:depth=5,time_limit=0.1`, one of
            which can be a guidance graph for its costs, such as `edge_weights=crisscross`; the name of a trained policy
            of the package, the folder of a training run, or an address `hf://USER/NAME` on the Hugging Face Hub,
            optionally followed by `+pibt` and options, such as `mappo:temperature=0.5` or
            `mappo+pibt:patience=2,temperature=0.5`.
        seed: random seed of the policy in every episode.
        deterministic: whether a trained policy takes the most likely action instead of sampling one.
        trust_remote_code: whether the configuration of a trained policy may name code outside this package.

    Raises `ValueError` for an unknown name, and for an unknown or invalid option.
    """
    if name.partition(":")[0] in PLANNERS:
        factory = PlannerFactory(*_without_weights(name), seed)
        planner_of(factory.name, seed)  # rejects invalid options
        if factory.edge_weights is not None:
            check_edge_weights(factory.edge_weights)
        return factory
    if name == "random":
        return RandomFactory(seed)
    return _factory_of_trained(name, seed, deterministic, trust_remote_code)


def _without_weights(name: str) -> tuple[str, str | None]:
    """Return a planner's name without the option `edge_weights`, and that option; None if there is none."""
    planner, _, text = name.partition(":")
    options = text.split(",")
    weights = [option for option in options if option.startswith(WEIGHTS_OPTION)]
    others = ",".join(option for option in options if option not in weights)
    return f"{planner}:{others}" if others else planner, weights[-1].removeprefix(WEIGHTS_OPTION) if weights else None


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
            f"policy {name!r}: {near}expected random, a planner ({planners}), a trained policy ({trained_names}), or "
            "the folder of a training run"
        )
    allowed = _TRAINED_OPTIONS | (_SHIELD_OPTIONS if shielded != trained else {})
    chosen = allowed | parse_options(shielded, allowed, options)
    return TrainedFactory(trained, seed, deterministic, chosen.pop("temperature"), chosen, trust_remote_code)


def check_observed(name: str, keywords: Mapping[str, Any]) -> None:
    """Raise `ValueError` if `keywords` determine observations, and the policy of this name has none."""
    given = [field for field in OBSERVATION_FIELDS if field in keywords]
    if given and not is_trained(name):
        raise ValueError(f"{given[0]}: expected only with a trained policy, since {name!r} has no observations")


def is_trained(name: str) -> bool:
    """Return whether `policy_factory` interprets this name as that of a trained policy."""
    return name != "random" and name.partition(":")[0] not in PLANNERS


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


def _check_actions(description: str, policy: Policy, keywords: dict[str, Any]) -> None:
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
        return {
            "policy": "trained",
            "weights": digest(weights),
            "configuration": digest([_configuration(folder / CONFIG), arrays]),
            "options": self.shield_options | {"temperature": self.temperature},
            "deterministic": self.deterministic,
            "seed": self.seed,
        }

    def __call__(self, keywords: dict[str, Any]) -> tuple[AnyEnv, Policy]:
        """Return the environment and the policy; raises `ValueError` if the policy needs another action model."""
        from mapf_pz.rl.policies.load import load_policy  # import torch only when it is needed

        policy = load_policy(self.name, self.seed, self.deterministic, self.temperature, self.trust_remote_code)
        _check_actions(f"policy {self.name!r}", policy, keywords)
        env = make_env(policy, **keywords)
        return env, Shield(policy, env, **self.shield_options) if self.shield_options else policy


@dataclass(frozen=True)
class PlannerFactory:
    """Makes a planner and its environment."""

    name: str
    """Name of the planner, with options."""
    edge_weights: str | None
    """Guidance graph of its costs; None: that of the task."""
    seed: int
    """Random seed of the planner in every episode."""

    @property
    def identity(self) -> dict[str, Any]:
        """The planner, its options with the digest of its guidance graph, and its seed."""
        planner, options = planner_options(self.name)
        if self.edge_weights is not None:
            options |= {"edge_weights": weights_digest(self.edge_weights)}
        return {"policy": planner, "options": options, "seed": self.seed}

    def __call__(self, keywords: dict[str, Any]) -> tuple[AnyEnv, Policy]:
        """Return the environment and the planner."""
        weights: dict[str, Any] = {} if self.edge_weights is None else {"edge_weights": self.edge_weights}
        env = parallel_env(**(Planner.env_kwargs | keywords | weights))
        return env, planner_of(self.name, self.seed, env)


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
