"""Policies by name: planners, trained policies, and trained policies under PIBT."""

from __future__ import annotations

import ast
import inspect
from functools import partial
from importlib import resources
from pathlib import Path
from typing import Any, cast

from mapf_pz.environment import MapfEnv, parallel_env
from mapf_pz.evaluation.random_policy import RandomPolicy
from mapf_pz.evaluation.rollout import AnyEnv, Policy, PolicyFactory, check_policy, make_env
from mapf_pz.planners import PLANNERS, Planner, Shield

UNDER_PIBT = "+pibt"
"""After the name of a trained policy: its preferences are carried out by PIBT, without collisions."""


def policy_factory(name: str, seed: int = 0, deterministic: bool = False) -> PolicyFactory:
    """Return what makes the environment and the policy of this name.

    Args:
        name: `random`; a planner, with options if there shall be any: `epibt`, `epibt:depth=5,time_limit=0.1`; a
            trained policy: its name, if it comes with the package, or a run's folder; such a one with `+pibt` after it.
        seed: of the policy's draws, in every episode.
        deterministic: a trained policy takes the likeliest action instead of drawing it.

    Raises `ValueError` for an unknown name, and for an option that a planner does not have or allow.
    """
    planner, _, options = name.partition(":")
    if planner in PLANNERS:
        arguments = _options(PLANNERS[planner], options)
        PLANNERS[planner](seed=seed, **arguments)  # refuses values that are not allowed
        return partial(_planner_factory, PLANNERS[planner], arguments, seed)
    if name == "random":
        return partial(_random_factory, seed)
    trained = name.removesuffix(UNDER_PIBT)
    if trained not in _bundled_names() and not Path(trained).exists():
        raise ValueError(
            f"policy {name!r}: expected random, a planner ({', '.join(PLANNERS)}), a trained policy "
            f"({', '.join(_bundled_names())}), or the folder of a training run"
        )
    return partial(_trained_factory, trained, trained != name, seed, deterministic)


def is_trained(name: str) -> bool:
    """Tell whether `policy_factory` takes this name for that of a trained policy."""
    return name != "random" and name.partition(":")[0] not in PLANNERS


def _bundled_names() -> list[str]:
    """Return the names of the trained policies that come with the package, without loading torch."""
    folder = Path(str(resources.files("mapf_pz"))) / "rl" / "policies"
    return sorted(file.name for file in folder.iterdir() if file.is_dir())


def factory_for(policy: Policy) -> PolicyFactory:
    """Return what makes the environment for a policy that is at hand; raises `TypeError` where it is none."""
    check_policy(policy)
    return partial(_own_factory, policy)


def _check_actions(who: str, policy: Policy, keywords: dict[str, Any]) -> None:
    """Raise `ValueError` where a policy would have to take actions that are not its own."""
    its_own = getattr(policy, "env_kwargs", {}).get("action_model")
    if its_own is not None and keywords.get("action_model", its_own) != its_own:
        raise ValueError(f"{who} acts with action_model={its_own!r}, not {keywords['action_model']!r}")


def _own_factory(policy: Policy, keywords: dict[str, Any]) -> tuple[AnyEnv, Policy]:
    _check_actions(type(policy).__name__, policy, keywords)
    return make_env(policy, **keywords), policy


def _planner_factory(
    planner: type[Planner], options: dict[str, Any], seed: int, keywords: dict[str, Any]
) -> tuple[AnyEnv, Policy]:
    env = parallel_env(**(planner.env_kwargs | keywords))
    return env, planner(env, seed=seed, **options)


def _random_factory(seed: int, keywords: dict[str, Any]) -> tuple[AnyEnv, Policy]:
    env = parallel_env(**(Planner.env_kwargs | keywords))
    return env, RandomPolicy(env.simulator.num_actions, seed)


def _trained_factory(
    name: str, under_pibt: bool, seed: int, deterministic: bool, keywords: dict[str, Any]
) -> tuple[AnyEnv, Policy]:
    from mapf_pz.rl.policy import load_policy  # torch is loaded only where it is needed

    policy = load_policy(name, seed, deterministic)
    _check_actions(f"policy {name!r}", policy, keywords)
    env = make_env(policy, **keywords)
    return env, Shield(policy, cast("MapfEnv", env)) if under_pibt else policy


def _options(planner: type[Planner], text: str) -> dict[str, Any]:
    """Parse `depth=5,time_limit=0.1`; raises `ValueError` for what the planner does not know."""
    allowed = [name for name in inspect.signature(planner).parameters if name not in ("env", "seed")]
    options: dict[str, Any] = {}
    for option in filter(None, text.split(",")):
        name, _, value = map(str.strip, option.partition("="))
        if name not in allowed:
            raise ValueError(f"option {option!r}: {planner.__name__} has {', '.join(allowed) or 'none'}")
        try:
            options[name] = ast.literal_eval(value)
        except (SyntaxError, ValueError, RecursionError, MemoryError):
            options[name] = None
        if not isinstance(options[name], (int, float)):
            raise ValueError(f"option {option!r}: expected a number, True or False")
    return options
