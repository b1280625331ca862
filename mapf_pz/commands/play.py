"""The command `mapf-pz play`: control an agent with the keyboard; a policy controls the others."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

from mapf_pz.actions import Action, CardinalAction
from mapf_pz.config import ActionModel, CollisionSystem, EnvConfig, OnTarget
from mapf_pz.environment import MapfEnv
from mapf_pz.evaluation.policies import policy_factory
from mapf_pz.render.rgb import Canvas
from mapf_pz.render.window import Window

KEYS: dict[str, dict[str, int]] = {
    "rotate": {
        "up": Action.FORWARD,
        "left": Action.ROTATE_LEFT,
        "right": Action.ROTATE_RIGHT,
        "space": Action.WAIT,
    },
    "cardinal": {
        "up": CardinalAction.UP,
        "down": CardinalAction.DOWN,
        "left": CardinalAction.LEFT,
        "right": CardinalAction.RIGHT,
        "space": CardinalAction.WAIT,
    },
}
"""The action of each key, by action model."""
KEYWORDS = (
    *("map", "num_agents", "max_steps", "action_model"),
    *("collision_system", "on_target", "reward", "distance_bytes"),
)
"""The options that are keyword arguments of `parallel_env`."""
HELP = "arrows: move, space: wait, r: restart, escape: quit"


@dataclass(frozen=True)
class PlayOptions:
    """Options of `mapf-pz play`."""

    map: str = "random-16-16-20"
    """Name of a map, or path of a `.map` file."""
    num_agents: int = 8
    """Number of agents. You control agent 0, which is marked with a frame."""
    policy: str = "pibt"
    """Policy of the other agents: `random`, a planner, or a trained policy."""
    max_steps: int = EnvConfig.max_steps
    """Maximum number of steps; the episode is then truncated."""
    action_model: ActionModel | None = None
    """`rotate`: agents turn and move forward; `cardinal`: agents move in four directions. None: the policy's model."""
    collision_system: CollisionSystem = EnvConfig.collision_system
    """How conflicting moves are resolved."""
    on_target: OnTarget = EnvConfig.on_target
    """What an agent does at its goal."""
    reward: str = "progress"
    """Rewards to show: `report` or `progress`."""
    distance_bytes: int | None = None
    """Maximum memory for cost-to-go tables in bytes. None: as needed, up to half of the machine's memory."""
    seed: int = 0
    """Random seed of the first episode, which increases by one per episode."""


def play(options: PlayOptions) -> None:
    """Control agent 0 with the arrow keys. Each key press is one step."""
    keywords: dict[str, Any] = {name: value for name in KEYWORDS if (value := getattr(options, name)) is not None}
    env, policy = policy_factory(options.policy, options.seed)(keywords)
    inner = cast("MapfEnv", env.unwrapped)
    keys, window = KEYS[inner.config.action_model], Window("mapf-pz play", fps=60)
    seed, message, total = options.seed, HELP, 0.0
    observations, _ = env.reset(seed=seed)
    policy.reset_states()
    me = env.possible_agents[0]
    canvas = Canvas(inner.grid, len(env.possible_agents))
    while not window.is_closed:
        window.show(canvas.draw(*inner.scene(), chosen=0), message)
        for key in window.wait():
            if key == "escape":
                window.close()
                break
            if key == "r" or not env.agents:
                seed, message, total = seed + 1, HELP, 0.0
                observations, _ = env.reset(seed=seed)
                policy.reset_states()
            elif key in keys and me in env.agents:
                actions = policy.act(observations) | {me: keys[key]}
                observations, rewards, _, _, infos = env.step(actions)
                total += rewards[me]
                message = _summary(inner, rewards[me], total, infos[me])
    metrics = ", ".join(f"{name} {value:.4g}" for name, value in env.metrics().items())
    print(f"{env.step_count} steps, your rewards {total:.2f}; {metrics}")


def _summary(env: MapfEnv, reward: float, total: float, info: dict[str, Any]) -> str:
    """Return a one-line summary of a step."""
    event = next((name for name in ("blocked", "arrived", "at_goal") if info[name]), "")
    end = "" if env.agents else " - episode over, press any key to restart"
    return f"step {env.step_count}, reward {reward:+.2f}, total {total:+.2f} {event}{end}"
