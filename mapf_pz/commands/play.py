"""The command `mapf-pz play`: steer an agent with the keyboard, among others that a policy steers."""

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
"""What keys do, by action model."""
KEYWORDS = (
    *("map", "num_agents", "max_steps", "action_model"),
    *("collision_system", "on_target", "reward", "distance_bytes"),
)
"""Those of `parallel_env` among the options."""
HELP = "arrows: drive, space: wait, r: anew, escape: end"


@dataclass(frozen=True)
class PlayOptions:
    """Where, and with whom."""

    map: str = "random-16-16-20"
    """A map's name or the path of a `.map` file."""
    num_agents: int = 8
    """The number of agents; agent 0, with a ring around it, is yours."""
    policy: str = "pibt"
    """Who steers the others: `random`, a planner, or a trained policy."""
    max_steps: int = EnvConfig.max_steps
    """The episode is truncated after this many steps."""
    action_model: ActionModel | None = None
    """Whether agents turn and drive or step in four directions; None: as the policy does."""
    collision_system: CollisionSystem = EnvConfig.collision_system
    """How conflicting moves are settled."""
    on_target: OnTarget = EnvConfig.on_target
    """What an agent does at its goal."""
    reward: str = "progress"
    """Which rewards are told: `report` or `progress`."""
    distance_bytes: int | None = None
    """The most memory for cost-to-go tables, in bytes; None: as much as is needed, up to half of the machine's."""
    seed: int = 0
    """Decides the first episode; each new one takes the next."""


def play(options: PlayOptions) -> None:
    """Steer agent 0 by the arrow keys; nothing happens until a key is pressed."""
    keywords: dict[str, Any] = {name: value for name in KEYWORDS if (value := getattr(options, name)) is not None}
    env, policy = policy_factory(options.policy, options.seed)(keywords)
    inner = cast("MapfEnv", env.unwrapped)
    keys, window = KEYS[inner.config.action_model], Window("mapf-pz play", fps=60)
    seed, told, total = options.seed, HELP, 0.0
    observations, _ = env.reset(seed=seed)
    policy.reset_states()
    me = env.possible_agents[0]
    canvas = Canvas(inner.grid, len(env.possible_agents))
    while not window.is_closed:
        window.show(canvas.draw(*inner.scene(), chosen=0), told)
        for key in window.wait():
            if key == "escape":
                window.close()
                break
            if key == "r" or not env.agents:
                seed, told, total = seed + 1, HELP, 0.0
                observations, _ = env.reset(seed=seed)
                policy.reset_states()
            elif key in keys and me in env.agents:
                actions = policy.act(observations) | {me: keys[key]}
                observations, rewards, _, _, infos = env.step(actions)
                total += rewards[me]
                told = _tell(inner, rewards[me], total, infos[me])
    metrics = ", ".join(f"{name} {value:.4g}" for name, value in env.metrics().items())
    print(f"{env.step_count} steps, your rewards {total:.2f}; {metrics}")


def _tell(env: MapfEnv, reward: float, total: float, info: dict[str, Any]) -> str:
    """Return what came of a step, in one line."""
    happened = next((name for name in ("blocked", "arrived", "at_goal") if info[name]), "")
    end = "" if env.agents else " - the end; any key: anew"
    return f"step {env.step_count}, reward {reward:+.2f}, in all {total:+.2f} {happened}{end}"
