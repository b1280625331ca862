"""The command `mapf-pz render`: play an episode, or take a plan file, and save it as page, film or picture."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import track
from tyro.conf import Positional

from mapf_pz.commands.planfile import load_plan
from mapf_pz.config import ActionModel, CollisionSystem, EnvConfig, OnTarget, WeightsName
from mapf_pz.evaluation.policies import policy_factory
from mapf_pz.evaluation.rollout import AnyEnv, Policy, play
from mapf_pz.planners import record_plan, validate
from mapf_pz.render import Recording, save_recording
from mapf_pz.render.save import check_output
from mapf_pz.wrappers import RecordEpisode


@dataclass(frozen=True)
class EpisodeOptions:
    """Which episode or plan, and what becomes of it."""

    output: Positional[Path]
    """The file: `.html` is a page to play, step and look closely; `.svg`, `.gif` and `.mp4` move; `.png` shows the
    end."""
    policy: str = "random"
    """`random`, a planner, or a trained policy: its name, if it comes with the package, or the folder of a run."""
    map: str | None = None
    """A map's name or the path of a `.map` file; None: an empty map."""
    scenario: str | None = None
    """A `.scen` file of the map, or a League of Robot Runners or POGEMA problem file, which names its own map. None:
    starts and goals are sampled, or are those of the plan."""
    num_agents: int | None = None
    """The number of agents. None: all of the plan or the scenario, otherwise 4."""
    max_steps: int = EnvConfig.max_steps
    """The episode is truncated after this many steps."""
    action_model: ActionModel | None = None
    """Whether agents turn and drive or step in four directions; None: as the policy does."""
    collision_system: CollisionSystem = EnvConfig.collision_system
    """How conflicting moves are settled."""
    on_target: OnTarget = EnvConfig.on_target
    """What an agent does at its goal."""
    edge_weights: WeightsName = "uniform"
    """The guidance graph; pages show it."""
    distance_bytes: int | None = None
    """The most memory for cost-to-go tables, in bytes; None: as much as is needed, up to half of the machine's."""
    seed: int = 0
    """Decides the episode."""
    plan: Path | None = None
    """A plan file, in place of a policy: League of Robot Runners JSON, MAPF tracker CSV, text of PIBT and LaCAM."""
    problem: Path | None = None
    """The League of Robot Runners problem that the plan is for, in place of a map."""
    fps: float = 4
    """Steps per second."""

    def keywords(self) -> dict[str, Any]:
        """Return the keywords of `parallel_env` that are set."""
        names = (
            *("map", "scenario", "num_agents", "max_steps", "action_model"),
            *("collision_system", "on_target", "edge_weights", "distance_bytes"),
        )
        return {name: value for name in names if (value := getattr(self, name)) is not None}


def render(episode: EpisodeOptions) -> None:
    """Play an episode, or take a plan file, and save it as page, film or picture."""
    check_output(episode.output, episode.fps)
    if episode.plan is not None:
        _save_plan(episode, episode.plan)
        return
    if episode.problem is not None:
        raise ValueError("--problem: expected --plan, too")
    env, policy = policy_factory(episode.policy, episode.seed)(episode.keywords())
    save_episode(env, policy, episode.seed, episode.output, episode.fps, episode.policy)


def save_episode(env: AnyEnv, policy: Policy, seed: int, output: Path, fps: float, who: str) -> None:
    """Play an episode of `env`, save it to `output`, and print its metrics; `who` is the policy's name."""
    recording = _record(env, policy, seed)
    metrics = {name: f"{value:.4g}" for name, value in env.metrics().items()}
    facts = {"policy": who, "seed": str(seed)} | metrics
    _save(replace(recording, title=f"{who}: {recording.title}", facts=facts), output, fps)
    print(f"{output}: {env.step_count} steps, {', '.join(f'{name} {value}' for name, value in metrics.items())}")


def _save_plan(episode: EpisodeOptions, plan: Path) -> None:
    file, instance, _, has_goals = load_plan(plan, episode.map, episode.scenario, episode.num_agents, episode.problem)
    violation = validate(instance, file.plan)
    facts = {"plan": plan.name, "legal": "yes" if violation is None else f"no: {violation}"}
    recording = record_plan(instance, file.plan, has_goals)
    _save(replace(recording, title=f"{plan.name}: {recording.title}", facts=facts), episode.output, episode.fps)
    print(f"{episode.output}: {file.plan.num_steps} steps, {'legal' if violation is None else violation}")


def _save(recording: Recording, output: Path, fps: float) -> None:
    output.parent.mkdir(parents=True, exist_ok=True)
    save_recording(recording, output, fps)


def _record(env: AnyEnv, policy: Policy, seed: int) -> Recording:
    """Play an episode with a bar of progress, and return what happened."""
    console, recorded = Console(stderr=True), RecordEpisode(env)
    steps = play(recorded, policy, seed)
    hidden = not console.is_terminal
    for _ in track(steps, "Playing", env.config.max_steps + 1, console=console, transient=True, disable=hidden):
        pass
    return recorded.recording
