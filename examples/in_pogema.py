"""Run a policy of this package in POGEMA's environment, which needs a separate Python environment.

Run it with the Python that has POGEMA, and name this package's `mapf-pz`:

    python -m venv .venv-pogema && .venv-pogema/bin/pip install 'pogema==1.4.0' 'pydantic<2'
    .venv-pogema/bin/python examples/in_pogema.py .venv/bin/mapf-pz mappo-cardinal

It requires nothing but POGEMA. `ServedPolicy` has the interface of POGEMA's toolbox: copy it into your own program.
"""
# pyright: reportMissingImports=false

import json
import subprocess
import sys
from typing import Any

from pogema import GridConfig, pogema_v0


class ServedPolicy:
    """A policy that acts in another process: `mapf-pz serve`."""

    def __init__(self, program: str, policy: str, config: GridConfig) -> None:
        """Start the process, with the rules of POGEMA's `config`."""
        rules = ["--collision-system", config.collision_system, "--on-target", config.on_target]
        command = [program, "serve", policy, *rules, "--max-steps", str(config.max_episode_steps)]
        self._radius, self._starts = config.obs_radius, True
        self._process: Any = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def reset_states(self) -> None:
        """Begin an episode."""
        self._starts = True

    def act(self, observations: list[Any]) -> list[int]:
        """Return an action for each agent, given the observations of `observation_type="MAPF"`."""
        radius = self._radius
        request: dict[str, Any] = {
            key: [[int(number) - radius for number in seen[name]] for seen in observations]
            for key, name in (("positions", "global_xy"), ("goals", "global_target_xy"))
        }
        if self._starts:
            inner = observations[0]["global_obstacles"][radius:-radius, radius:-radius]
            request["map"] = ["".join(".#"[int(cell)] for cell in row) for row in inner]
            self._starts = False
        print(json.dumps(request), file=self._process.stdin, flush=True)
        reply = json.loads(self._process.stdout.readline() or '{"error": "mapf-pz serve has ended"}')
        if "error" in reply:
            raise RuntimeError(reply["error"])
        return reply["actions"]

    def close(self) -> None:
        """End the process."""
        self._process.stdin.close()
        self._process.wait()


def main(program: str, policy: str) -> None:
    """Run three episodes in POGEMA, and print its metrics."""
    config = GridConfig(
        num_agents=16,
        size=16,
        density=0.2,
        max_episode_steps=128,
        on_target="nothing",
        collision_system="soft",
        observation_type="MAPF",
    )
    served = ServedPolicy(program, policy, config)
    for seed in range(3):
        config.seed = seed
        env = pogema_v0(config)
        observations, _ = env.reset()
        served.reset_states()
        over, infos = [False], []
        while not all(over):
            observations, _, terminated, truncated, infos = env.step(served.act(observations))
            over = [ended or cut for ended, cut in zip(terminated, truncated, strict=True)]
        print(infos[0]["metrics"])
    served.close()


if __name__ == "__main__":
    main(*sys.argv[1:])
