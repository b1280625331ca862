"""Kernels on several threads leave the process as it was."""

import os
import subprocess
import sys
from pathlib import Path

CODE = """
import os
import numba
import numpy as np
from mapf_pz.simulator.config import EnvConfig
from mapf_pz.simulator import Simulator

def seen(num_threads):
    simulator = Simulator(EnvConfig(num_agents=4), 8, num_threads)
    simulator.reset(seeds={b: b for b in range(8)})
    simulator.step(np.zeros((8, 4), np.int64))
    return simulator.observe().image

first = seen(2)
assert numba.get_num_threads() == 3
child = os.fork()
if child == 0:
    os._exit(0 if np.array_equal(seen(2), first) else 1)
assert os.waitpid(child, 0)[1] == 0
"""


def test_the_number_of_threads_stays_and_a_fork_goes_on():
    done = subprocess.run(
        [sys.executable, "-W", "ignore::DeprecationWarning", "-c", CODE],
        capture_output=True,
        text=True,
        check=False,
        cwd=Path(__file__).parents[2],
        env={**os.environ, "NUMBA_NUM_THREADS": "3"},
    )
    assert done.returncode == 0, done.stderr
