"""Evaluate policies on the same episodes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, cast

from mapf_pz._internal.lock import locked
from mapf_pz._internal.parallel import run_jobs
from mapf_pz.environment.policy import AnyEnv, Policy, PolicyFactory
from mapf_pz.evaluation.batch import MAX_AGENTS
from mapf_pz.evaluation.episodes import run_episodes
from mapf_pz.evaluation.external.command import PREFIX, CommandFactory
from mapf_pz.evaluation.identity import Identities
from mapf_pz.evaluation.policies import factory_for, policy_factory
from mapf_pz.evaluation.results import Episode, Results
from mapf_pz.evaluation.suite import load_suite
from mapf_pz.evaluation.task import EvaluationTask

EPISODES_PER_JOB = 8
"""Minimum number of episodes that a process runs per job."""
BATCHES_PER_JOB = 4
"""Number of batches of episodes in a job of a policy that acts in batches."""


class Job(NamedTuple):
    """Some episodes of a task, run with one policy."""

    name: str
    factory: PolicyFactory
    task: EvaluationTask
    episodes: Sequence[int]
    identities: Identities
    """Those of the policy and the task at the start of the evaluation."""

    def make(self, keywords: dict[str, Any]) -> tuple[AnyEnv, Policy]:
        """Return the environment and the policy; raises as `check`."""
        made = self.factory(keywords)
        self.check()  # that what was loaded is what the identities were computed from
        return made

    def check(self) -> None:
        """Raise `ValueError` if files of the policy or the task have changed since the start of the evaluation."""
        self.identities.check_unchanged({self.name: self.factory}, [self.task])


def evaluate(
    policies: Mapping[str, PolicyFactory | Policy | str] | Iterable[str],
    suite: str | Path | Sequence[EvaluationTask] = "standard",
    output: str | Path | None = None,
    jobs: int | str = 1,
    show: Callable[[Episode | None, int], None] = lambda episode, left: None,
    overwrite: bool = False,
    trust_remote_code: bool = False,
) -> list[Episode]:
    """Run policies in all episodes of a suite, and return the episodes. All policies get the same seeds.

    Args:
        policies: one or more names that `policy_factory` accepts, or a mapping from names to policies, policy
            factories, or such names. A planner outside of this package is `command:` and a command, see
            `CommandFactory`, or its plan files, `PlanFolderFactory(folder)`.
        suite: the name of a suite, the path of a suite file, or tasks.
        output: a folder to which every finished episode is written. Existing results of the same policies and tasks are
            reused: those with the same identities, see `mapf_pz.evaluation.identity`. A policy that is given as an
            object states its identity in an attribute `identity: str`; without it, its results are not reused.
        jobs: number of processes, or `ray`: see `run_jobs`. Results do not depend on it, apart from the times.
        show: called with each finished episode (at first with None), and the number of remaining episodes.
        overwrite: replace results in `output` that have other identities than the policies and tasks of the same names.
        trust_remote_code: whether policies given by name, and the suite file, may name code outside this package.

    Raises:
        ValueError: a policy or suite is unknown, they are incompatible, two tasks have the same label, or the folder
            contains results of the same names with other identities; or a file of a policy or a task was replaced
            during the evaluation, of which the episodes before are kept.
        BlockingIOError: another process is writing to the folder.
        TypeError: an object is not a policy.
        FileNotFoundError, FormatError: a file of the suite is missing or malformed.
    """
    if isinstance(policies, str):
        policies = [policies]
    named = policies if isinstance(policies, Mapping) else {name: name for name in policies}
    factories = {name: _factory(policy, trust_remote_code) for name, policy in named.items()}
    tasks = load_suite(suite, trust_remote_code) if isinstance(suite, (str, Path)) else tuple(suite)
    _check_names(tasks)
    folder = None if output is None else Path(output)
    with locked(folder):
        identities = Identities.of(factories, tasks)
        results = Results(folder, identities, overwrite, tasks)
        done = results.done()
        pending = [
            Job(name, factory, task, episodes, identities.one(name, task.label))
            for task in tasks
            for name, factory in factories.items()
            for episodes in _in_chunks(
                [e for e in range(task.episodes) if _key(name, task, e) not in done], _episodes_per_job(factory, task)
            )
        ]
        left = sum(len(job.episodes) for job in pending)
        show(None, left)
        for episodes in run_jobs(_run, pending, jobs):
            for episode in episodes:
                results.add(episode)
                left -= 1
                show(episode, left)
    found = {episode.key: episode for episode in results.episodes}
    return [found[_key(name, task, e)] for task in tasks for name in factories for e in range(task.episodes)]


def _factory(policy: PolicyFactory | Policy | str, trust_remote_code: bool) -> PolicyFactory:
    if isinstance(policy, str) and policy.startswith(PREFIX):
        return CommandFactory(policy.removeprefix(PREFIX))
    if isinstance(policy, str):
        return policy_factory(policy, trust_remote_code=trust_remote_code)
    if callable(policy) and not isinstance(policy, type) and not hasattr(policy, "act"):
        return policy
    return factory_for(cast("Policy", policy))


def _check_names(tasks: Sequence[EvaluationTask]) -> None:
    names: set[str] = set()
    for task in tasks:
        if task.label in names:
            raise ValueError(f"two tasks are named {task.label!r}: expected unique names")
        names.add(task.label)


def _key(name: str, task: EvaluationTask, episode: int) -> tuple[str, str, int, int]:
    return name, task.name, task.num_agents, episode


def _episodes_per_job(factory: PolicyFactory, task: EvaluationTask) -> int:
    in_batches = getattr(factory, "in_batches", False)
    return max(EPISODES_PER_JOB, BATCHES_PER_JOB * MAX_AGENTS // task.num_agents if in_batches else 0)


def _in_chunks(episodes: Sequence[int], size: int) -> Iterator[Sequence[int]]:
    for first in range(0, len(episodes), size):
        yield episodes[first : first + size]


def _run(job: Job) -> list[Episode]:
    """Run the episodes of a job; raises as `Job.check`."""
    task = job.task
    notes: dict[int, str] = {}
    measured = list(run_episodes(job.make, task, job.episodes, notes.__setitem__))
    job.check()  # of files that were read, or programs that were run, in each episode
    return [
        Episode(*_key(job.name, task, e), metrics, task.instance_name(e), task.seed + e, task.suite, notes.get(e, ""))
        for e, metrics in zip(job.episodes, measured, strict=True)
    ]
