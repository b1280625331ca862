"""An evaluation: policies meet on the same episodes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, cast

from mapf_pz.evaluate.jobs import run_jobs
from mapf_pz.evaluate.policies import named_policy, own_policy
from mapf_pz.evaluate.results import Episode, Results
from mapf_pz.evaluate.run import Casting, Policy, run_episodes
from mapf_pz.evaluate.suite import load_suite
from mapf_pz.evaluate.trial import Trial

EPISODES_PER_TASK = 8
"""So many episodes are done by one process before it takes others."""


class Task(NamedTuple):
    """Some episodes of a trial, for a policy."""

    name: str
    casting: Casting
    trial: Trial
    episodes: Sequence[int]


def evaluate(
    policies: Mapping[str, Casting | Policy | str] | Iterable[str],
    suite: str | Path | Sequence[Trial] = "standard",
    output: Path | None = None,
    jobs: int | str = 1,
    show: Callable[[Episode | None, int], None] = lambda episode, left: None,
) -> list[Episode]:
    """Let policies act in all episodes of a suite, and return the episodes: those of each policy have the same seeds.

    Args:
        policies: a name or names that `named_policy` knows, or by name a policy that is at hand or what makes one.
        suite: the name of a suite, the path of a suite's file, or trials.
        output: a folder in which every episode is kept as it is done; what is there already is not done again.
        jobs: processes, or `ray`: see `run_jobs`. Results do not depend on it, apart from the times.
        show: is called with each episode that is done, and at first with None, and the number of those left.

    Raises:
        ValueError: a policy or suite is unknown, they do not fit, two trials have the same name, or the folder has an
            evaluation of other trials.
        TypeError: an object is no policy.
        FileNotFoundError, FormatError: a file of the suite is absent or malformed.
    """
    if isinstance(policies, str):
        policies = [policies]
    named = policies if isinstance(policies, Mapping) else {name: name for name in policies}
    castings = {name: _casting(policy) for name, policy in named.items()}
    trials = load_suite(suite) if isinstance(suite, (str, Path)) else tuple(suite)
    _check_names(trials)
    results = Results(trials, output)
    done = results.done()
    tasks = [
        Task(name, casting, trial, episodes)
        for trial in trials
        for name, casting in castings.items()
        for episodes in _in_parts([e for e in range(trial.episodes) if _key(name, trial, e) not in done])
    ]
    left = sum(len(task.episodes) for task in tasks)
    show(None, left)
    for episodes in run_jobs(_run, tasks, jobs):
        for episode in episodes:
            results.add(episode)
            left -= 1
            show(episode, left)
    found = {episode.key: episode for episode in results.episodes}
    return [found[_key(name, trial, e)] for trial in trials for name in castings for e in range(trial.episodes)]


def _casting(policy: Casting | Policy | str) -> Casting:
    if isinstance(policy, str):
        return named_policy(policy)
    if callable(policy) and not isinstance(policy, type) and not hasattr(policy, "act"):
        return policy
    return own_policy(cast("Policy", policy))


def _check_names(trials: Sequence[Trial]) -> None:
    names: set[str] = set()
    for trial in trials:
        if trial.name in names:
            raise ValueError(f"two trials are called {trial.name!r}: expected different names")
        names.add(trial.name)


def _key(name: str, trial: Trial, episode: int) -> tuple[str, str, int, int]:
    return name, trial.family, trial.num_agents, episode


def _in_parts(episodes: Sequence[int]) -> Iterator[Sequence[int]]:
    for first in range(0, len(episodes), EPISODES_PER_TASK):
        yield episodes[first : first + EPISODES_PER_TASK]


def _run(task: Task) -> list[Episode]:
    """Do a task."""
    measured = run_episodes(task.casting, task.trial, task.episodes)
    return [
        Episode(*_key(task.name, task.trial, number), metrics)
        for number, metrics in zip(task.episodes, measured, strict=True)
    ]
