"""Keywords of an environment, some of which are given; a policy or defaults determine the others."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any, ClassVar, Self

from mapf_pz.simulator.config import EnvConfig


@dataclass(frozen=True)
class EnvKeywords:
    """Keywords of `parallel_env`. A field is given if it is present, also if its value equals the default."""

    FIELDS: ClassVar[tuple[str, ...]] = tuple(field.name for field in fields(EnvConfig))
    """Fields that may be given."""
    keywords: dict[str, Any] = field(default_factory=dict[str, Any])
    """Values of the fields that are given."""

    @classmethod
    def of(cls, config: EnvConfig) -> Self:
        """Return the values of `config`, which are all given."""
        return cls({name: getattr(config, name) for name in cls.FIELDS})

    def config(self, **defaults: Any) -> EnvConfig:
        """Return the configuration with these fields, `defaults` for absent ones, and otherwise that of `EnvConfig`.

        Raises `TypeError` for an unknown field, and `ValueError` for an invalid value.
        """
        return EnvConfig(**(defaults | self.keywords))
