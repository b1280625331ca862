"""The command line's form of `EnvConfig`: flags for the fields that can be typed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any

from tyro.conf import Suppress
from tyro.constructors import ConstructorRegistry, StructConstructorSpec, StructFieldSpec, StructTypeInfo

from mapf_pz.config import EnvConfig, HeadingName, WeightsName
from mapf_pz.core.reward import REWARDS, RewardConfig

_TYPED: dict[str, Any] = {
    "map": str | None,
    "scenario": str | tuple[str, ...] | None,
    "edge_weights": WeightsName,
    "initial_heading": HeadingName,
    "reward": RewardConfig,
    "source": str | None,
    "channels": tuple[str, ...],
    "features": tuple[str, ...],
    "render_mode": Annotated[None, Suppress],
}
"""Fields that are typed as something else than they may be in Python."""

ENV_FLAGS = ConstructorRegistry()
"""Lets tyro read an `EnvConfig`."""


@dataclass(frozen=True, kw_only=True)
class _Fields(EnvConfig):
    """The same fields under another type, which has tyro's own rule for dataclasses."""


@dataclass(frozen=True)
class _Terms(RewardConfig):
    """The terms of a reward under another type, for the same purpose."""


_REWARD_HELP = "Reward by name (`report`, `progress`) or as `package.module:name`, instead of the terms below."


@ENV_FLAGS.struct_rule
def _reward_flags(info: StructTypeInfo) -> StructConstructorSpec | None:
    """Return the flags of a reward: its name, or its terms."""
    if info.type is not RewardConfig:
        return None
    spec = ConstructorRegistry.get_struct_spec(replace(info, type=_Terms))
    if not isinstance(spec, StructConstructorSpec):
        raise TypeError(f"tyro cannot read {RewardConfig.__name__}: {spec}")
    name_type: Any = str | None
    name = StructFieldSpec(name="reward", type=name_type, default=None, helptext=_REWARD_HELP)
    return StructConstructorSpec(_reward, (name, *spec.fields))


def _reward(reward: str | None, **terms: Any) -> str | RewardConfig:
    return RewardConfig(**terms) if reward is None else reward


@ENV_FLAGS.struct_rule
def _env_flags(info: StructTypeInfo) -> StructConstructorSpec | None:
    """Return the flags of an `EnvConfig`."""
    if info.type is not EnvConfig:
        return None
    spec = ConstructorRegistry.get_struct_spec(replace(info, type=_Fields))
    if not isinstance(spec, StructConstructorSpec):
        raise TypeError(f"tyro cannot read {EnvConfig.__name__}: {spec}")
    return StructConstructorSpec(EnvConfig, tuple(map(_flag, spec.fields)))


def _flag(field: StructFieldSpec) -> StructFieldSpec:
    default = REWARDS.get(field.default, field.default) if field.name == "reward" else field.default
    return replace(field, type=_TYPED.get(field.name, field.type), default=default)


def changed_keywords(config: EnvConfig) -> dict[str, Any]:
    """Return the fields that are not at their defaults, as keywords of `parallel_env`; a policy sets the others."""
    defaults = replace(EnvConfig(), reward=RewardConfig())
    return {name: value for name, value in config.keywords().items() if value != getattr(defaults, name)}
