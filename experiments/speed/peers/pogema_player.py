"""Run an episode in POGEMA 1.4.0 in a separate Python, for `experiments.speed`: `pogema_player.py OPTIONS`.

OPTIONS is a JSON object: `map` (rows of `.` and `#`), `num_agents`, `view_size` (odd, square), `max_steps`, `seed`, and
`integration` (null: its own interface, or `PettingZoo`). Actions are random, and the reset is included. It prints the
number of agent steps, the seconds, the CPU seconds and the bytes of an agent's observation. It requires only POGEMA.
"""

# pyright: reportMissingImports=false

import json
import random
import sys
import time

from pogema import GridConfig, pogema_v0


def main() -> None:
    """Run the episode, and print the measurement."""
    options = json.loads(sys.argv[1])
    config = GridConfig(
        map="\n".join(options["map"]),
        num_agents=options["num_agents"],
        obs_radius=options["view_size"] // 2,
        max_episode_steps=options["max_steps"],
        seed=options["seed"],
        on_target="nothing",
        collision_system="soft",
        integration=options["integration"],
    )
    env = pogema_v0(grid_config=config)
    rng = random.Random(options["seed"])
    actions = [[rng.randrange(5) for _ in range(config.num_agents)] for _ in range(options["max_steps"])]
    if options["integration"] == "PettingZoo":
        actions = [{f"player_{i}": action for i, action in enumerate(row)} for row in actions]
    wall, cpu = time.perf_counter(), time.process_time()
    observations, _ = env.reset()
    for row in actions:
        observations = env.step(row)[0]
    spent = time.perf_counter() - wall, time.process_time() - cpu
    first = observations["player_0"] if isinstance(observations, dict) else observations[0]
    print(json.dumps([options["max_steps"] * config.num_agents, *spent, first.nbytes]))


main()
