"""Run episodes of Jumanji 1.1 in a separate Python, for `experiments.speed`: `jumanji_player.py OPTIONS`.

OPTIONS is a JSON object: `env` (`RobotWarehouse-v0` or `Connector-v2`), `num_envs`, `max_steps` and `seed`. All
environments are stepped together by compiled code of one thread, with random actions and automatic resets; compilation
is not measured. It prints the number of agent steps, the seconds, the CPU seconds and the bytes of an
environment's observation per agent; the agents of Connector share it. It requires only Jumanji, and
`requests`, which Jumanji imports.
"""

# pyright: reportMissingImports=false

import json
import os
import sys
import time
from typing import Any

os.environ["JAX_PLATFORMS"] = "cpu"
os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"

import jax
import jumanji
from jumanji.wrappers import VmapAutoResetWrapper


def main() -> None:
    """Run the episodes, and print the measurement."""
    options = json.loads(sys.argv[1])
    num_envs, max_steps = options["num_envs"], options["max_steps"]
    env = VmapAutoResetWrapper(jumanji.make(options["env"]))
    num_agents = env.action_spec.shape[0]
    number_of_actions = int(env.action_spec.num_values.max())

    def step(carry: Any, key: Any) -> Any:
        state, total = carry
        actions = jax.random.randint(key, (num_envs, num_agents), 0, number_of_actions)
        state, timestep = env.step(state, actions)
        total += sum(part.sum() for part in jax.tree.leaves(timestep.observation))  # so that they are computed
        return (state, total), None

    @jax.jit
    def play(state: Any, key: Any) -> Any:
        return jax.lax.scan(step, (state, 0.0), jax.random.split(key, max_steps))[0]

    keys = jax.random.split(jax.random.PRNGKey(options["seed"]), num_envs)
    state, timestep = jax.jit(env.reset)(keys)
    jax.block_until_ready(play(state, keys[0]))
    size = sum(part.nbytes for part in jax.tree.leaves(timestep.observation)) // (num_envs * num_agents)
    wall, cpu = time.perf_counter(), time.process_time()
    jax.block_until_ready(play(state, keys[1]))
    spent = time.perf_counter() - wall, time.process_time() - cpu
    print(json.dumps([max_steps * num_envs * num_agents, *spent, size]))


main()
