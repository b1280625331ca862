"""The command `mapf-pz compile`: compile kernels before they are needed."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, get_args

from tyro.conf import UseAppendAction

from mapf_pz._internal.compilation.dry_run import Example, compile_all
from mapf_pz._internal.json import parse_object
from mapf_pz._internal.text import read_text
from mapf_pz.instances.instance import ActionModel
from mapf_pz.planners import PLANNERS, planner_of
from mapf_pz.planners.named import import_code
from mapf_pz.rl.config_file import CONFIG
from mapf_pz.rl.policies.folder import bundled, policy_names
from mapf_pz.simulator.config import DEFAULT_NUM_AGENTS, OBSERVATION_FIELDS, EnvConfig
from mapf_pz.simulator.recommended import RECOMMENDED
from mapf_pz.simulator.simulator import run_small_episode


@dataclass(frozen=True)
class CompileOptions:
    """Options of `mapf-pz compile`."""

    planner: Annotated[tuple[str, ...], UseAppendAction] = ()
    """Planner whose kernels are compiled, or your own, `package.module:Class`; may be given several times. Default: all
    planners of the package."""


def compile_kernels(options: CompileOptions) -> None:
    """Compile the kernels of the environment, for the observations of the package's policies, and of planners.

    They are cached for later programs. What is compiled already is not compiled again.
    """
    for name in options.planner:
        import_code(name)
    planners = options.planner or tuple(PLANNERS)
    start = time.perf_counter()
    count = compile_all(*_episodes(), *(partial(_plan, name, model) for name in planners for model in _MODELS))
    seconds = time.perf_counter() - start
    print(f"{count} kernels compiled in {seconds:.3g} seconds" if count else "nothing left to compile")


_MODELS: tuple[ActionModel, ...] = get_args(ActionModel)


def _episodes() -> Iterator[Example]:
    """Yield short episodes of all environments whose observations are those of a policy or a default."""
    for model in _MODELS:
        yield partial(_act, {"action_model": model})
        yield partial(_act, {**RECOMMENDED, "view": "centered", "action_model": model})
    for name in policy_names():
        file = bundled() / name / CONFIG
        trained = parse_object(read_text(file), file)["task"]["env"]
        yield partial(_act, {field: trained[field] for field in ("action_model", *OBSERVATION_FIELDS)})


def _act(keywords: Mapping[str, Any]) -> None:
    run_small_episode(EnvConfig(**keywords), num_envs=1, num_agents=DEFAULT_NUM_AGENTS, num_threads=1)


def _plan(planner: str, action_model: ActionModel) -> None:
    planner_of(planner).compile(action_model)
