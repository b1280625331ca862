"""Run an episode of `rware` 2.0 in a separate Python, for `experiments.speed`: `rware_player.py OPTIONS`.

OPTIONS is a JSON object: `num_agents`, `max_steps` and `seed`. The warehouse is the tiny one of its benchmarks, 11 x 10
cells. Actions are random, and the reset is included. It prints the number of agent steps, the seconds, the CPU seconds
and the bytes of an agent's observation. It requires only rware.
"""

# pyright: reportMissingImports=false

import json
import random
import sys
import time

from rware.warehouse import ObservationType, RewardType, Warehouse


def main() -> None:
    """Run the episode, and print the measurement."""
    options = json.loads(sys.argv[1])
    num_agents, max_steps = options["num_agents"], options["max_steps"]
    env = Warehouse(
        shelf_columns=3,
        column_height=8,
        shelf_rows=1,
        n_agents=num_agents,
        msg_bits=0,
        sensor_range=1,
        request_queue_size=num_agents,
        max_inactivity_steps=None,
        max_steps=max_steps,
        reward_type=RewardType.INDIVIDUAL,
        observation_type=ObservationType.FLATTENED,
    )
    rng = random.Random(options["seed"])
    actions = [[rng.randrange(5) for _ in range(num_agents)] for _ in range(max_steps)]
    wall, cpu = time.perf_counter(), time.process_time()
    observations, _ = env.reset(seed=options["seed"])
    for row in actions:
        observations = env.step(row)[0]
    spent = time.perf_counter() - wall, time.process_time() - cpu
    print(json.dumps([max_steps * num_agents, *spent, observations[0].nbytes]))


main()
