"""The command `mapf-pz dataset`: make demonstrations with a planner, and export them for TorchRL."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from tyro.conf import Positional, arg, subcommand

from mapf_pz._internal.interrupts import interruptible
from mapf_pz._internal.parallel import job_runner
from mapf_pz.commands.env_flags import EpisodeKeywords, MixtureKeywords
from mapf_pz.commands.progress import progress_bar
from mapf_pz.rl.demonstrations import DatasetConfig, load_dataset, make_dataset
from mapf_pz.simulator.config import OBSERVATION_FIELDS, EnvConfig
from mapf_pz.simulator.keywords import EnvKeywords


class DatasetKeywords(EpisodeKeywords):
    """The fields of an environment that determine the episodes of a dataset."""

    FIELDS: ClassVar[tuple[str, ...]] = (*EpisodeKeywords.FIELDS, "source")


EPISODES = DatasetKeywords.of(EnvConfig())
"""The default episodes."""


@dataclass(frozen=True)
class ObservationKeywords(EnvKeywords):
    """The fields of an environment that determine observations."""

    FIELDS: ClassVar[tuple[str, ...]] = OBSERVATION_FIELDS


@dataclass(frozen=True)
class MakeOptions:
    """Make demonstrations. Finished files in the folder are kept, so an interrupted command can be repeated."""

    output: Positional[Path]
    """Folder of the dataset."""
    planner: str = DatasetConfig.planner
    """Name of the planner, with options as in `lacam:time_limit=5,clock=work`. Without `clock=work`, time limits are in
    seconds of CPU time."""
    env: DatasetKeywords = EPISODES
    """The environment. Without a map, scenario or source, episodes use the maps of the mixture."""
    mixture: MixtureKeywords = field(default_factory=MixtureKeywords)
    """The maps, if there is no map, scenario or source."""
    agent_counts: Annotated[tuple[int, ...] | None, arg(name="num-agents")] = None
    """Number of agents, or several numbers. Default: all agents of the scenario or source, otherwise 4."""
    episodes: int = DatasetConfig.episodes
    """Number of episodes for each number of agents."""
    shard_size: int = DatasetConfig.shard_size
    """Number of episodes in a file, which one process makes."""
    solved_only: bool = DatasetConfig.solved_only
    """Whether episodes that end while an agent is not at its goal are omitted; does not apply to lifelong episodes."""
    seed: int = DatasetConfig.seed
    """Random seed. Episode k of the dataset has the seed `seed + k`, which must be below 1,000,000, where the seeds of
    evaluations start."""
    license: str = DatasetConfig.license
    """License of the dataset, for its card."""
    jobs: int | Literal["ray"] = 1
    """Number of processes; `ray`: run on a Ray cluster."""

    def config(self) -> DatasetConfig:
        """Return the settings of the dataset."""
        env = self.env.config()
        return DatasetConfig(
            planner=self.planner,
            env=env,
            mixture=self.mixture.mixture(env),
            num_agents=self.agent_counts,
            episodes=self.episodes,
            shard_size=self.shard_size,
            solved_only=self.solved_only,
            seed=self.seed,
            license=self.license,
        )


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

        make_dataset(options.config(), options.output, run, show, command_of(options))
    made = load_dataset(options.output)
    print(f"{options.output}: {len(made)} demonstrations, {made.num_agent_steps} agent steps")


def command_of(options: MakeOptions) -> str:
    """Return the command with these options, without the number of processes and without default values."""
    default = MakeOptions(options.output)
    names = ("planner", "episodes", "shard_size", "solved_only", "seed", "license")
    values = {name: getattr(options, name) for name in names if getattr(options, name) != getattr(default, name)}
    values |= {name: value for name, value in options.env.keywords.items() if value != default.env.keywords[name]}
    values |= options.mixture.given
    values |= {} if options.agent_counts is None else {"num_agents": options.agent_counts}
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
