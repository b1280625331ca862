"""The command `mapf-pz render`: save an episode or a plan as a web page, video or image."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

from rich.console import Console
from rich.progress import Progress
from tyro.conf import Positional

from mapf_pz.commands.planfile import load_plan
from mapf_pz.config import EnvConfig
from mapf_pz.evaluation.episodes import AnyEnv, Policy, changed_keywords, rollout
from mapf_pz.evaluation.policies import policy_factory
from mapf_pz.planners import record_plan, validate
from mapf_pz.render import Recording, save_recording
from mapf_pz.render.save import check_output
from mapf_pz.wrappers import RecordEpisode


@dataclass(frozen=True)
class EpisodeOptions:
    """Options of `mapf-pz render`: an episode or a plan, and the output file."""

    output: Positional[Path]
    """Output file. `.html`: an interactive page; `.svg`, `.gif`, `.mp4`: an animation; `.png`: an image of the last
    state."""
    policy: str = "random"
    """Policy: `random`, a planner, the name of a bundled trained policy, or the folder of a training run."""
    env: EnvConfig = field(default_factory=EnvConfig)
    """The environment. Fields at their defaults follow the policy; a plan uses `map`, `scenario` and `num_agents`."""
    seed: int = 0
    """Random seed."""
    plan: Path | None = None
    """Plan file, instead of a policy: League of Robot Runners JSON, MAPF tracker CSV, or text of PIBT or LaCAM."""
    problem: Path | None = None
    """File of the League of Robot Runners problem of the plan, instead of a map."""
    fps: float = 4
    """Steps per second."""


def render(episode: EpisodeOptions) -> None:
    """Run an episode or read a plan file, and save it as a web page, video or image."""
    check_output(episode.output, episode.fps)
    if episode.plan is not None:
        _save_plan(episode, episode.plan)
        return
    if episode.problem is not None:
        raise ValueError("--problem: expected --plan, too")
    env, policy = policy_factory(episode.policy, episode.seed)(changed_keywords(episode.env))
    save_episode(env, policy, episode.seed, episode.output, episode.fps, episode.policy)


def save_episode(env: AnyEnv, policy: Policy, seed: int, output: Path, fps: float, policy_name: str) -> None:
    """Run an episode of `env`, save it to `output`, and print its metrics; `policy_name` is the policy's name."""
    recording = _record(env, policy, seed)
    metrics = {metric: f"{value:.4g}" for metric, value in env.metrics().items()}
    facts = {"policy": policy_name, "seed": str(seed)} | metrics
    _save(replace(recording, title=f"{policy_name}: {recording.title}", facts=facts), output, fps)
    print(f"{output}: {env.step_count} steps, {', '.join(f'{metric} {value}' for metric, value in metrics.items())}")


def _save_plan(episode: EpisodeOptions, plan: Path) -> None:
    env = episode.env
    map, scenario = (None if name is None else str(name) for name in (env.map, env.scenario))
    file, instance, _, has_goals = load_plan(plan, map, scenario, env.num_agents, episode.problem)
    violation = validate(instance, file.plan)
    facts = {"plan": plan.name, "legal": "yes" if violation is None else f"no: {violation}"}
    recording = record_plan(instance, file.plan, has_goals)
    _save(replace(recording, title=f"{plan.name}: {recording.title}", facts=facts), episode.output, episode.fps)
    print(f"{episode.output}: {file.plan.num_steps} steps, {'legal' if violation is None else violation}")


def _save(recording: Recording, output: Path, fps: float) -> None:
    output.parent.mkdir(parents=True, exist_ok=True)
    save_recording(recording, output, fps)


def _record(env: AnyEnv, policy: Policy, seed: int) -> Recording:
    """Run an episode with a progress bar, and return its recording."""
    console, recorded = Console(stderr=True), RecordEpisode(env)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("Running", total=env.config.max_steps + 1)
        rollout(recorded, policy, seed, on_step=lambda: bar.advance(task))
    return recorded.recording
