"""The command `mapf-pz dataset`: make demonstrations with a planner, and export them for TorchRL."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from tyro.conf import Positional, arg, subcommand
from tyro.constructors import StructConstructorSpec, StructFieldSpec, StructTypeInfo

from mapf_pz._internal.interrupts import interruptible
from mapf_pz._internal.parallel import job_runner
from mapf_pz.commands.env_flags import ENV_FLAGS, EpisodeKeywords, MixtureKeywords, default_of, flags_of, mixture_flag
from mapf_pz.commands.progress import progress_bar
from mapf_pz.rl.demonstrations import DatasetConfig, load_dataset, make_dataset
from mapf_pz.simulator.config import OBSERVATION_FIELDS
from mapf_pz.simulator.keywords import EnvKeywords


class DatasetKeywords(EpisodeKeywords):
    """The fields of an environment that determine the episodes of a dataset."""

    FIELDS: ClassVar[tuple[str, ...]] = (*EpisodeKeywords.FIELDS, "source")


@ENV_FLAGS.struct_rule
def _dataset_flags(info: StructTypeInfo) -> StructConstructorSpec | None:
    """Return the flags of a dataset, of which those of the environment and the mixture may be omitted."""
    if info.type is not DatasetConfig:
        return None
    return StructConstructorSpec(_dataset, tuple(map(_dataset_flag, flags_of(default_of(info)))))


def _dataset_flag(flag: StructFieldSpec) -> StructFieldSpec:
    if flag.name == "env":
        return replace(flag, type=DatasetKeywords, default=DatasetKeywords.of(flag.default))
    return mixture_flag(flag)


def _dataset(env: DatasetKeywords, mixture: MixtureKeywords, **others: Any) -> DatasetConfig:
    config = env.config()
    return DatasetConfig(env=config, mixture=mixture.mixture(config), **others)


@dataclass(frozen=True)
class ObservationKeywords(EnvKeywords):
    """The fields of an environment that determine observations."""

    FIELDS: ClassVar[tuple[str, ...]] = OBSERVATION_FIELDS


@dataclass(frozen=True)
class MakeOptions:
    """Make demonstrations. Finished files in the folder are kept, so an interrupted command can be repeated."""

    output: Positional[Path]
    """Folder of the dataset."""
    config: DatasetConfig = field(default_factory=DatasetConfig)
    """The planner and the episodes."""
    jobs: int | Literal["ray"] = 1
    """Number of processes; `ray`: run on a Ray cluster."""


@dataclass(frozen=True)
class ExportOptions:
    """Export demonstrations with observations as a memory-mapped TensorDict, for TorchRL."""

    dataset: Positional[Path]
    """Folder of the dataset."""
    output: Positional[Path]
    """Folder of the TensorDict; it must not exist."""
    env: ObservationKeywords = ObservationKeywords()
    """Observations. Default: those of the environment."""
    reward_name: Annotated[str, arg(name="reward")] = "report"
    """Reward by name (`report`, `progress`) or as `package.module:name`."""


def dataset(task: Annotated[MakeOptions, subcommand("make")] | Annotated[ExportOptions, subcommand("export")]) -> None:
    """Make demonstrations with a planner, or export them for TorchRL."""
    with interruptible() as check:
        match task:
            case MakeOptions():
                _make(task, check)
            case ExportOptions():
                _export(task)


def _make(options: MakeOptions, check: Callable[[], None]) -> None:
    with job_runner(options.jobs) as run, progress_bar("making files") as update:
        counts: list[int] = []

        def show(left: int) -> None:
            check()
            counts.append(left)
            update(total=counts[0], completed=counts[0] - left)

        make_dataset(options.config, options.output, run, show, command_of(options))
    made = load_dataset(options.output)
    print(f"{options.output}: {len(made)} demonstrations, {made.num_agent_steps} agent steps")


def command_of(options: MakeOptions) -> str:
    """Return the command with these options, without the number of processes and without default values."""
    config, default = options.config, DatasetConfig()
    parts = ((config, default), (config.env, default.env), (config.mixture, default.mixture))
    values = {
        field.name: getattr(part, field.name)
        for part, usual in parts
        for field in fields(part)
        if field.name not in ("env", "mixture") and getattr(part, field.name) != getattr(usual, field.name)
    }
    words = ["mapf-pz", "dataset", "make", str(options.output)]
    for name, value in values.items():
        flag = name.replace("_", "-")
        if isinstance(value, bool):
            words.append(f"--{flag}" if value else f"--no-{flag}")
        else:
            words += [f"--{flag}", *map(str, value if isinstance(value, tuple) else (value,))]
    return shlex.join(words)


def _export(options: ExportOptions) -> None:
    from mapf_pz.rl.demonstrations.export import export_demonstrations  # import torch only when it is needed

    env = options.env.keywords | {"reward": options.reward_name}
    exported = export_demonstrations(load_dataset(options.dataset), options.output, env)
    for num_agents, steps in exported.items():
        print(f"{options.output / f'agents-{num_agents}'}: {len(steps)} steps")
