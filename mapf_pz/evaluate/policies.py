"""Policies by name: planners, trained policies, and trained policies under PIBT."""

from __future__ import annotations

import ast
import inspect
from functools import partial
from typing import Any

from mapf_pz.environment import parallel_env
from mapf_pz.evaluate.random_policy import RandomPolicy
from mapf_pz.evaluate.run import AnyEnv, Casting, Policy, make_env
from mapf_pz.planners import PLANNERS, Planner

UNDER_PIBT = "+pibt"
"""After the name of a trained policy: its preferences are carried out by PIBT, without collisions."""


def named_policy(name: str, seed: int = 0, deterministic: bool = False) -> Casting:
    """Return what makes the environment and the policy of this name.

    Args:
        name: `random`; a planner, with options if there shall be any: `epibt`, `epibt:depth=5,time_limit=0.1`; a
            trained policy: its name, if it comes with the package, or a run's folder; such a one with `+pibt` after it.
        seed: of the policy's draws, in every episode.
        deterministic: a trained policy takes the likeliest action instead of drawing it.

    Raises `ValueError` for a planner's option that there is not.
    """
    planner, _, options = name.partition(":")
    if planner in PLANNERS:
        return partial(_cast_planner, PLANNERS[planner], _options(PLANNERS[planner], options), seed)
    if name == "random":
        return partial(_cast_random, seed)
    trained = name.removesuffix(UNDER_PIBT)
    return partial(_cast_trained, trained, trained != name, seed, deterministic)


def own_policy(policy: Policy) -> Casting:
    """Return what makes the environment for a policy that is at hand."""
    return partial(_cast_own, policy)


def _cast_own(policy: Policy, keywords: dict[str, Any]) -> tuple[AnyEnv, Policy]:
    return make_env(policy, **keywords), policy


def _cast_planner(
    planner: type[Planner], options: dict[str, Any], seed: int, keywords: dict[str, Any]
) -> tuple[AnyEnv, Policy]:
    env = parallel_env(**(planner.env_kwargs | keywords))
    return env, planner(env, seed=seed, **options)


def _cast_random(seed: int, keywords: dict[str, Any]) -> tuple[AnyEnv, Policy]:
    env = parallel_env(**(Planner.env_kwargs | keywords))
    return env, RandomPolicy(env.simulator.num_actions, seed)


def _cast_trained(
    name: str, under_pibt: bool, seed: int, deterministic: bool, keywords: dict[str, Any]
) -> tuple[AnyEnv, Policy]:
    from mapf_pz.rl.policy import load_policy  # torch is loaded only where it is needed

    policy = load_policy(name, seed, deterministic)
    trained_for = policy.config.task.action_model
    if keywords.get("action_model", trained_for) != trained_for:
        raise ValueError(f"policy {name!r} acts with action_model={trained_for!r}, not {keywords['action_model']!r}")
    env = make_env(policy, **keywords)
    return env, policy


def _options(planner: type[Planner], text: str) -> dict[str, Any]:
    """Parse `depth=5,time_limit=0.1`; raises `ValueError` for what the planner does not know."""
    allowed = [name for name in inspect.signature(planner).parameters if name not in ("env", "seed")]
    options: dict[str, Any] = {}
    for option in filter(None, text.split(",")):
        name, _, value = option.partition("=")
        if name not in allowed:
            raise ValueError(f"option {option!r}: {planner.__name__} has {', '.join(allowed) or 'none'}")
        try:
            options[name] = ast.literal_eval(value)
        except (SyntaxError, ValueError):
            raise ValueError(f"option {option!r}: expected a number, True or False") from None
    return options
