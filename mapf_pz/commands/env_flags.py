"""The command line's form of environments and their maps: flags for the fields that can be typed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import partial
from typing import Annotated, Any, ClassVar, get_args, get_origin, get_type_hints

from tyro.conf import DisallowNone, UseAppendAction, arg
from tyro.constructors import ConstructorRegistry, StructConstructorSpec, StructFieldSpec, StructTypeInfo

from mapf_pz._internal.signatures import field_docs
from mapf_pz.instances.instance import HeadingName
from mapf_pz.instances.mixture import MapMixture
from mapf_pz.simulator.config import EnvConfig
from mapf_pz.simulator.kernels.reward import REWARDS, RewardConfig
from mapf_pz.simulator.keywords import EnvKeywords

_TYPED: dict[str, Any] = {
    "map": str | None,
    "scenario": Annotated[tuple[tuple[str, ...], ...], UseAppendAction],  # `--scenario a b --scenario c`
    "edge_weights": str,
    "initial_heading": HeadingName | tuple[int, ...],
    "delays": str | None,
    "reward": RewardConfig,
    "source": str | None,
    "view_size": tuple[int, int],
    "channels": tuple[str, ...],
    "features": tuple[str, ...],
}
"""Fields that are typed as something else than they may be in Python."""
_NO_FLAG = "render_mode"

ENV_FLAGS = ConstructorRegistry()
"""Lets tyro read an `EnvConfig`."""


@dataclass(frozen=True)
class _NoReward(RewardConfig):
    """Stands for a reward that is not given."""


def flags_of(config: Any) -> tuple[StructFieldSpec, ...]:
    """Return the flags of the fields of a dataclass, whose values in `config` are the defaults."""
    kind = type(config)
    types, docs = get_type_hints(kind, include_extras=True), field_docs(kind)
    return tuple(
        StructFieldSpec(
            field.name, types[field.name], getattr(config, field.name), helptext=_one_line(docs[field.name])
        )
        for field in fields(kind)
    )


def default_of(info: StructTypeInfo) -> Any:
    """Return the default of a dataclass: the one that is given, or that of its class."""
    kind: Any = info.type
    return info.default if isinstance(info.default, kind) else kind()


def _one_line(text: str) -> str:
    return " ".join(text.split())


@dataclass(frozen=True)
class EpisodeKeywords(EnvKeywords):
    """The fields that determine episodes; policies determine the others."""

    FIELDS: ClassVar[tuple[str, ...]] = (
        *("map", "scenario", "max_steps", "action_model", "collision_system", "on_target", "goals"),
        *("initial_heading", "edge_weights", "delays", "distance_bytes"),
    )


_REWARD_HELP = "Reward by name (`report`, `progress`) or as `package.module:name`, instead of the terms below."


@ENV_FLAGS.struct_rule
def _reward_flags(info: StructTypeInfo) -> StructConstructorSpec | None:
    """Return the flags of a reward: its name, or terms that change the default."""
    if info.type not in (RewardConfig, _NoReward):
        return None
    default = None if isinstance(info.default, _NoReward) else info.default
    terms = default if isinstance(default, RewardConfig) else None
    name = StructFieldSpec(name="reward", type=DisallowNone[str | None], default=None, helptext=_REWARD_HELP)
    flags = (optional(flag, None if terms is None else flag.default) for flag in flags_of(terms or RewardConfig()))
    return StructConstructorSpec(partial(_reward, default), (name, *flags))


def _reward(default: Any, reward: str | None, **terms: Any) -> Any:
    """Return the reward that is given, or the default, with the terms that are given."""
    given = present(terms)
    if reward is None:
        return replace(default if isinstance(default, RewardConfig) else RewardConfig(), **given) if given else default
    if given:
        raise ValueError(f"{next(iter(given))}: not allowed together with reward={reward!r}, which sets all terms")
    return reward


@ENV_FLAGS.struct_rule
def _env_flags(info: StructTypeInfo) -> StructConstructorSpec | None:
    """Return the flags of an `EnvConfig`."""
    if info.type is not EnvConfig:
        return None
    return StructConstructorSpec(lambda **given: EnvConfig(**_joined(given)), _flags(default_of(info)))


@ENV_FLAGS.struct_rule
def _keyword_flags(info: StructTypeInfo) -> StructConstructorSpec | None:
    """Return the flags of `EnvKeywords`, which may be omitted."""
    kind: Any = info.type
    if not (isinstance(kind, type) and issubclass(kind, EnvKeywords)):
        return None
    defaults = info.default.keywords if isinstance(info.default, EnvKeywords) else {}
    flags = [flag for flag in _flags(EnvConfig(**defaults)) if flag.name in kind.FIELDS]
    return StructConstructorSpec(
        lambda **given: kind(present(_joined(given))), tuple(_keyword_flag(flag, defaults) for flag in flags)
    )


def _keyword_flag(flag: StructFieldSpec, defaults: Mapping[str, Any]) -> StructFieldSpec:
    """Return the flag of a field that may be absent; a reward and scenarios have rules for that."""
    if flag.name == "scenario":
        return flag
    if flag.name == "reward":
        return replace(flag, default=flag.default if "reward" in defaults else _NoReward())
    return replace(flag, type=_absent(flag.type), default=defaults.get(flag.name))


def optional(flag: StructFieldSpec, shown: Any) -> StructFieldSpec:
    """Return the flag of a field that is None if it is not given; `shown` is the default in the help."""
    text = " ".join(map(str, shown)) if isinstance(shown, tuple) else str(shown)
    kind: Any = Annotated[_absent(flag.type), arg(help_behavior_hint=f"(default: {text})")]
    return replace(flag, type=kind, default=None)


def _absent(kind: Any) -> Any:
    """Return the type of a flag that is None if it is not given, which cannot be typed as the word `None`."""
    bare = get_args(kind)[0] if get_origin(kind) is Annotated else kind  # so that it stays one union in the help
    return DisallowNone[bare | None]


def present(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values that are given."""
    return {name: value for name, value in values.items() if value is not None}


def _flags(config: EnvConfig) -> tuple[StructFieldSpec, ...]:
    """Return the flags of all fields of an environment."""
    return tuple(_flag(flag) for flag in flags_of(config) if flag.name != _NO_FLAG)


def _flag(flag: StructFieldSpec) -> StructFieldSpec:
    default = flag.default
    if flag.name == "reward":
        default = REWARDS.get(default, default)
    elif flag.name == "scenario":
        default = () if default is None else ((default,) if isinstance(default, str) else default,)
    return replace(flag, type=_TYPED.get(flag.name, flag.type), default=default)


def _joined(given: dict[str, Any]) -> dict[str, Any]:
    """Return the values with the scenarios of all `--scenario` together: None, a name, or several names."""
    if "scenario" not in given:
        return given
    names = tuple(name for names in given["scenario"] for name in names)
    return given | {"scenario": None if not given["scenario"] else names[0] if len(names) == 1 else names}


@dataclass(frozen=True)
class MixtureKeywords:
    """A mixture of maps, of which some fields are given."""

    default: MapMixture = field(default_factory=MapMixture)
    """Values of the other fields."""
    given: dict[str, Any] = field(default_factory=dict[str, Any])
    """Values of the fields that are given."""

    def mixture(self, env: EnvConfig) -> MapMixture:
        """Return the mixture; raises `ValueError` if fields are given that the maps of `env` leave without effect."""
        for name in ("map", "scenario", "source"):
            if self.given and getattr(env, name) is not None:
                raise ValueError(f"{next(iter(self.given))}: not allowed together with {name}, which determines maps")
        return replace(self.default, **self.given)


@ENV_FLAGS.struct_rule
def _mixture_flags(info: StructTypeInfo) -> StructConstructorSpec | None:
    """Return the flags of a mixture, which may be omitted."""
    if info.type is not MixtureKeywords:
        return None
    default = default_of(info).default
    flags = tuple(optional(flag, flag.default) for flag in flags_of(default))
    return StructConstructorSpec(lambda **given: MixtureKeywords(default, present(given)), flags)


def mixture_flag(flag: StructFieldSpec) -> StructFieldSpec:
    """Return the flag of a field, where that of a mixture may be omitted."""
    if flag.name == "mixture":
        return replace(flag, type=MixtureKeywords, default=MixtureKeywords(flag.default))
    return flag
