"""The command `mapf-pz play`: control an agent with the keyboard; a policy controls the others."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

from mapf_pz.environment.mapf_env import MapfEnv
from mapf_pz.environment.policy import actions_of
from mapf_pz.evaluation.policies import check_observed, policy_factory
from mapf_pz.planners.named import import_code
from mapf_pz.render.rgb import Canvas
from mapf_pz.render.window import Window
from mapf_pz.simulator.actions import Action, CardinalAction
from mapf_pz.simulator.kernels.reward import REWARDS
from mapf_pz.simulator.keywords import EnvKeywords

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
PLAYED: dict[str, Any] = {"map": "random-16-16-20", "num_agents": 8}
"""The environment without a map, scenario or source."""
PAID = EnvKeywords({"reward": REWARDS["progress"]})
"""The default reward."""
HELP = "arrows: move, space: wait, r: restart, escape: quit"


@dataclass(frozen=True)
class PlayOptions:
    """Options of `mapf-pz play`."""

    env: EnvKeywords = PAID
    """The environment; without a map, scenario or source, `random-16-16-20` with 8 agents. None: the policy's value or,
    if it has none, that of `parallel_env`. You control agent 0, which is marked with a frame."""
    policy: str = "pibt"
    """Policy of the other agents: `random`, a planner, or a trained policy."""
    seed: int = 0
    """Random seed of the first episode, which increases by one per episode."""
    trust_remote_code: bool = False
    """Load policies whose configurations name code outside this package (`package.module:name`), and run that code."""


def play(options: PlayOptions) -> None:
    """Control agent 0 with the arrow keys. Each key press is one step."""
    given = options.env.keywords
    import_code(options.policy)
    check_observed(options.policy, given)
    make = policy_factory(options.policy, options.seed, trust_remote_code=options.trust_remote_code)
    env, policy = make(given if {"map", "scenario", "source"} & given.keys() else PLAYED | given)
    inner = cast("MapfEnv", env.unwrapped)
    keys, window = KEYS[inner.config.action_model], Window("mapf-pz play", fps=60)
    seed, message, total = options.seed, HELP, 0.0
    observations, infos = env.reset(seed=seed)
    policy.reset_states()
    me = env.possible_agents[0]
    canvas = Canvas(inner.grid, len(env.possible_agents))
    while not window.is_closed:
        window.show(canvas.draw(*inner.render_state(), chosen=0), message)
        for key in window.wait():
            if key == "escape":
                window.close()
                break
            if key == "r" or not env.agents:
                seed, message, total = seed + 1, HELP, 0.0
                observations, infos = env.reset(seed=seed)
                policy.reset_states()
            elif key in keys and me in env.agents:
                actions = actions_of(policy, observations, infos) | {me: keys[key]}
                observations, rewards, _, _, infos = env.step(actions)
                total += rewards[me]
                message = _summary(inner, rewards[me], total, infos[me])
    metrics = ", ".join(f"{name} {value:.4g}" for name, value in env.metrics().items())
    print(f"{env.step_count} steps, your rewards {total:.2f}; {metrics}")


def _summary(env: MapfEnv, reward: float, total: float, info: dict[str, Any]) -> str:
    """Return a one-line summary of a step."""
    event = next((name for name in ("delayed", "blocked", "arrived", "at_goal") if info.get(name)), "")
    end = "" if env.agents else " - episode over, press any key to restart"
    return f"step {env.step_count}, reward {reward:+.2f}, total {total:+.2f} {event}{end}"
