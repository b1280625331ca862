"""The command `mapf-pz render`: save episodes or plans as a web page, video or image."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, UseAppendAction

from mapf_pz._internal.parallel import use_one_thread
from mapf_pz.commands.plans.planfile import LoadedPlan, load_plan
from mapf_pz.commands.progress import progress_bar
from mapf_pz.environment.policy import AnyEnv, Policy
from mapf_pz.evaluation.episodes import rollout
from mapf_pz.evaluation.inspection import InspectedPolicy
from mapf_pz.evaluation.policies import check_observed, policy_factory
from mapf_pz.planners import record_plan, violations
from mapf_pz.planners.named import import_code
from mapf_pz.render import Recording, save_html, save_recording
from mapf_pz.render.recording import RecordedViolation
from mapf_pz.render.save import check_output
from mapf_pz.simulator.keywords import EnvKeywords
from mapf_pz.wrappers import RecordEpisode


@dataclass(frozen=True)
class EpisodeOptions:
    """Options of `mapf-pz render`: episodes or plans, and the output file."""

    output: Positional[Path]
    """Output file. `.html`: an interactive page; `.svg`, `.gif`, `.mp4`: an animation; `.png`: an image of the last
    state."""
    policy: Annotated[tuple[str, ...], UseAppendAction] = ()
    """Policy: `random`, a planner, the name of a bundled trained policy, or the folder of a training run. Given several
    times, the page shows the episodes side by side. Default: `random`."""
    env: EnvKeywords = field(default_factory=EnvKeywords)
    """The environment. None: the policy's value or, if it has none, that of `parallel_env`. A plan uses `map`,
    `scenario` and `num_agents`."""
    seed: int | None = None
    """Random seed. Default: 0."""
    plan: Annotated[tuple[Path, ...], UseAppendAction] = ()
    """Plan file, instead of a policy: League of Robot Runners JSON, MAPF tracker CSV, or text of PIBT or LaCAM. Given
    several times, the page shows the plans side by side."""
    problem: str | None = None
    """League of Robot Runners problem of the plan, by name or `.json` file, instead of a map."""
    fps: float = 4
    """Steps per second."""
    trust_remote_code: bool = False
    """Load policies whose configurations name code outside this package (`package.module:name`), and run that code."""
    inspect: bool = False
    """Record each decision of the policy: the page shows the selected agent's features, action mask, probabilities of
    actions, attention to others, and why the safety layer took another action. Only for `.html`."""


def render(episode: EpisodeOptions) -> None:
    """Run episodes or read plan files, and save them as a web page, video or image."""
    check_output(episode.output, episode.fps)
    if episode.plan and episode.policy:
        raise ValueError("expected either --policy or --plan")
    if episode.problem is not None and not episode.plan:
        raise ValueError("--problem: expected --plan, too")
    if max(len(episode.plan), len(episode.policy)) > 1 and episode.output.suffix.lower() != ".html":
        raise ValueError(f"{episode.output}: expected an .html file for several episodes")
    if episode.inspect and (episode.plan or episode.output.suffix.lower() != ".html"):
        raise ValueError("--inspect: expected an .html file, and no --plan")
    if episode.plan:
        _check_unused(episode, "--plan", ("map", "scenario", "num_agents"))
        recordings = [_plan_recording(episode, plan) for plan in episode.plan]
    else:
        recordings = [_episode_recording(episode, policy) for policy in episode.policy or ("random",)]
    _save(recordings, episode.output, episode.fps)


def save_episode(env: AnyEnv, policy: Policy, seed: int, output: Path, fps: float, policy_name: str) -> None:
    """Run an episode of `env`, save it to `output`, and print its metrics; `policy_name` is the policy's name."""
    _save([record_episode(env, policy, seed, policy_name)], output, fps)


def record_episode(env: AnyEnv, policy: Policy, seed: int, policy_name: str, inspect: bool = False) -> Recording:
    """Run an episode of `env` with a progress bar, and return its recording, which is named after the policy.

    With `inspect`, the recording has the policy's decisions.
    """
    recorded = RecordEpisode(env)
    inspected = InspectedPolicy(policy, recorded) if inspect else None
    with progress_bar("running", total=env.config.max_steps + 1) as update:
        rollout(recorded, inspected or policy, seed, on_step=lambda: update(advance=1))
    return replace(
        recorded.recording,
        name=policy_name,
        facts={"policy": policy_name, "seed": str(seed)},
        inspection=None if inspected is None else inspected.inspection,
    )


def _episode_recording(episode: EpisodeOptions, policy_name: str) -> Recording:
    use_one_thread()
    seed = episode.seed or 0
    import_code(policy_name)
    check_observed(policy_name, episode.env.keywords)
    make = policy_factory(policy_name, seed, trust_remote_code=episode.trust_remote_code)
    env, policy = make(episode.env.keywords)
    return record_episode(env, policy, seed, policy_name, episode.inspect)


def _check_unused(episode: EpisodeOptions, option: str, used: tuple[str, ...] = ()) -> None:
    """Raise `ValueError` if an environment other than the `used` fields, or a seed, is given with this option."""
    for name in (*episode.env.keywords, *(() if episode.seed is None else ("seed",))):
        if name not in used:
            raise ValueError(f"{name}: not expected with {option}")


def _plan_recording(episode: EpisodeOptions, path: Path) -> Recording:
    env = episode.env.config()
    map, scenario = (None if name is None else str(name) for name in (env.map, env.scenario))
    loaded = load_plan(path, map, scenario, env.num_agents, episode.problem)
    recording = record_plan(loaded.instance, loaded.file.plan, loaded.has_goals)
    return replace(
        recording,
        name=path.name,
        facts={"plan": path.name},
        metrics=_plan_metrics(loaded),
        violations=tuple(
            RecordedViolation(violation.step, violation.agents, str(violation))
            for violation in violations(loaded.instance, loaded.file.plan)
        ),
    )


def _plan_metrics(loaded: LoadedPlan) -> dict[str, float]:
    """Return the costs of a plan, or the number of finished tasks if agents have several goals and it is known."""
    if loaded.instance.scenario.goals.ndim == 2:
        return {"SoC": loaded.file.plan.sum_of_costs, "makespan": loaded.file.plan.makespan}
    return {} if loaded.finished is None else {"tasks finished": loaded.finished}


def _save(recordings: list[Recording], output: Path, fps: float) -> None:
    """Save recordings, and print a line for each."""
    output.parent.mkdir(parents=True, exist_ok=True)
    if len(recordings) == 1:
        save_recording(recordings[0], output, fps)
    else:
        save_html(recordings, output, fps)
    for recording in recordings:
        print(f"{output}: {_summary(recording, with_name=len(recordings) > 1)}")


def _summary(recording: Recording, with_name: bool) -> str:
    parts = [f"{recording.num_steps} steps"]
    parts += [f"{name} {value:.4g}" for name, value in recording.metrics.items()]
    if recording.violations is not None:
        parts.append(_verdict(recording.violations))
    return (f"{recording.name}: " if with_name else "") + ", ".join(parts)


def _verdict(found: tuple[RecordedViolation, ...]) -> str:
    count = len(found)
    if not count:
        return "legal"
    return f"{count} violation{'s' if count > 1 else ''}, the first in {found[0].text}"
