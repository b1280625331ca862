"""The command line's form of `EnvConfig`: flags for the fields that can be typed, of all or some fields."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from tyro.conf import Suppress, UseAppendAction
from tyro.constructors import ConstructorRegistry, StructConstructorSpec, StructFieldSpec, StructTypeInfo

from mapf_pz.instances.instance import HeadingName
from mapf_pz.simulator.config import EnvConfig
from mapf_pz.simulator.kernels.reward import REWARDS, RewardConfig

if TYPE_CHECKING:
    from typing_extensions import Self

_TYPED: dict[str, Any] = {
    "map": str | None,
    "scenario": Annotated[tuple[tuple[str, ...], ...], UseAppendAction],  # `--scenario a b --scenario c`
    "edge_weights": str,
    "initial_heading": HeadingName,
    "reward": RewardConfig,
    "source": str | None,
    "view_size": tuple[int, int],
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


@dataclass(frozen=True)
class EnvKeywords:
    """Some fields of `EnvConfig`; those that are neither given nor have a default are absent."""

    FIELDS: ClassVar[tuple[str, ...]] = ()
    """Fields that have a flag."""
    keywords: dict[str, Any] = field(default_factory=dict[str, Any])
    """Values by field, as keywords of `parallel_env`."""

    @classmethod
    def of(cls, config: EnvConfig) -> Self:
        """Return the values of `config`."""
        return cls({name: getattr(config, name) for name in cls.FIELDS})

    def config(self, **defaults: Any) -> EnvConfig:
        """Return the configuration with these fields, `defaults` for absent ones, and otherwise that of `EnvConfig`."""
        return EnvConfig(**(defaults | self.keywords))


@dataclass(frozen=True)
class EpisodeKeywords(EnvKeywords):
    """The fields that determine episodes; policies determine the others."""

    FIELDS: ClassVar[tuple[str, ...]] = (
        *("map", "scenario", "max_steps", "action_model", "collision_system", "on_target", "goals"),
        *("initial_heading", "edge_weights", "distance_bytes"),
    )


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
    return StructConstructorSpec(lambda **given: EnvConfig(**_joined(given)), _flags(info))


@ENV_FLAGS.struct_rule
def _keyword_flags(info: StructTypeInfo) -> StructConstructorSpec | None:
    """Return the flags of `EnvKeywords`, which may be omitted."""
    kind: Any = info.type
    if not (isinstance(kind, type) and issubclass(kind, EnvKeywords)):
        return None
    defaults = info.default.keywords if isinstance(info.default, EnvKeywords) else {}
    flags = [flag for flag in _flags(replace(info, default=EnvConfig(**defaults))) if flag.name in kind.FIELDS]
    optional = tuple(flag if flag.name == "scenario" else _optional(flag, defaults) for flag in flags)
    return StructConstructorSpec(
        lambda **given: kind({name: value for name, value in _joined(given).items() if value is not None}), optional
    )


def _optional(flag: StructFieldSpec, defaults: dict[str, Any]) -> StructFieldSpec:
    """Return the flag of a field that may be None."""
    kind: Any = flag.type
    return replace(flag, type=kind | None, default=defaults.get(flag.name))


def _flags(info: StructTypeInfo) -> tuple[StructFieldSpec, ...]:
    """Return the flags of all fields."""
    spec = ConstructorRegistry.get_struct_spec(replace(info, type=_Fields))
    if not isinstance(spec, StructConstructorSpec):
        raise TypeError(f"tyro cannot read {EnvConfig.__name__}: {spec}")
    return tuple(map(_flag, spec.fields))


def _flag(field: StructFieldSpec) -> StructFieldSpec:
    default = field.default
    if field.name == "reward":
        default = REWARDS.get(default, default)
    elif field.name == "scenario":
        default = () if default is None else ((default,) if isinstance(default, str) else default,)
    return replace(field, type=_TYPED.get(field.name, field.type), default=default)


def _joined(given: dict[str, Any]) -> dict[str, Any]:
    """Return the values with the scenarios of all `--scenario` together: None, a name, or several names."""
    if "scenario" not in given:
        return given
    names = tuple(name for names in given["scenario"] for name in names)
    return given | {"scenario": None if not given["scenario"] else names[0] if len(names) == 1 else names}
