"""Kernels are compiled in several processes, each only once."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
COUNT = """
import sys
from functools import partial

import numpy as np
from numba.core import event

from mapf_pz._internal.compilation import jobs as compile_jobs
from mapf_pz._internal.compilation.dry_run import compile_all
from mapf_pz.instances import components
from mapf_pz.simulator.kernels.path_length import shortest_lengths
from mapf_pz.simulator.kernels.world import allocate

if len(sys.argv) > 1:
    compile_jobs.usable_cores = lambda: int(sys.argv[1])
compiled = []


class Listener(event.Listener):
    def on_start(self, event):
        compiled.append(event.data["dispatcher"].py_func.__name__)

    def on_end(self, event):
        pass


def find_paths():
    world, agents = allocate(1, (2, 2)), np.zeros(2, np.int32)
    world.leads_to[0] = np.arange(5)
    assert shortest_lengths(world, 0, agents, agents, agents, 4).tolist() == [0, 0]


def find_components():
    assert components(np.ones((3, 3), np.bool_)).tolist() == [[0] * 3] * 3


event.register("numba:compile", Listener())
jobs = compile_all(find_paths, find_components)
find_paths()
find_components()
print(jobs, sorted(name for name in compiled if name in ("_label", "_shortest_length", "_shortest_lengths")))
"""


def count(*arguments, prefix="", **environment):
    """Return how many kernels had to be compiled, and which of them a new process compiled itself."""
    command = [sys.executable, "-c", prefix + COUNT, *arguments]
    result = subprocess.run(
        command, capture_output=True, text=True, check=False, cwd=ROOT, env=os.environ | environment
    )
    assert result.returncode == 0, result.stderr
    jobs, _, compiled = result.stdout.strip().partition(" ")
    return int(jobs), compiled


ALL = "['_label', '_shortest_length', '_shortest_lengths']"


@pytest.mark.slow
def test_what_another_process_compiles_is_loaded(tmp_path):
    folder = tmp_path / "cache"
    jobs, compiled = count("2", NUMBA_CACHE_DIR=str(folder))
    assert jobs == 2
    assert compiled in ("['_label']", "['_shortest_length', '_shortest_lengths']")
    assert count("2", NUMBA_CACHE_DIR=str(folder)) == (0, "[]")
    assert {file.suffix for file in folder.rglob("*") if file.is_file()} == {".nbc"}


@pytest.mark.slow
def test_on_one_core_the_process_compiles_all_itself(tmp_path):
    assert count("1", NUMBA_CACHE_DIR=str(tmp_path)) == (2, ALL)


@pytest.mark.slow
def test_without_a_cache_the_process_compiles_all_itself():
    nowhere = "import tempfile; tempfile.tempdir = '/dev/null/nowhere'\n"
    assert count("2", prefix=nowhere, NUMBA_CACHE_DIR="/dev/null/nowhere") == (2, ALL)


@pytest.mark.parametrize("config", [{}, {"on_target": "restart", "channels": ("cost_to_go",), "features": ("time",)}])
def test_an_episode_calls_no_kernel_that_a_small_episode_does_not(config):
    code = f"""
import mapf_pz
from mapf_pz._internal.compilation.dry_run import DryRun
from mapf_pz.simulator.simulator import Simulator, run_small_episode
env = mapf_pz.parallel_env(num_agents=3, max_steps=3, **{config!r})
simulator = env.unwrapped.simulator
def episode():
    simulator.reset(seeds={{0: 0}})
    while not simulator.over.all():
        simulator.observe()
        simulator.step(simulator.agents["cell"] * 0)
    simulator.metrics(0)
def names(example):
    return {{(job.kernel.path, str(job.types)) for job in DryRun((example,)).jobs}}
small = names(lambda: run_small_episode(simulator.config, 1, 3, 1))
assert len(small) > 5, small
large = names(episode)
assert large <= small, large - small
"""
    environment = os.environ | {"NUMBA_CACHE_DIR": "/dev/null/nowhere"}
    code = "import tempfile; tempfile.tempdir = '/dev/null/nowhere'\n" + code
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=ROOT, env=environment
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(("given", "expected"), [("NOTSET", "WARNING"), ("INFO", "INFO")])
def test_numba_does_not_report_what_it_compiles(given, expected):
    """Where the root logger is at DEBUG; a level that Numba's logger has is kept."""
    code = f"""
import logging

logging.basicConfig(level=logging.DEBUG)
logging.getLogger("numba").setLevel("{given}")
import mapf_pz
mapf_pz.parallel_env(num_agents=2).reset(seed=0)
print(logging.getLevelName(logging.getLogger("numba").level))
"""
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert result.stdout.strip() == expected
    assert "numba.core" not in result.stderr
