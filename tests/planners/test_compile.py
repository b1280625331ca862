"""Kernels are compiled before any time limit starts: planning compiles none."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PLAN = """
import os
import pkgutil
import traceback
from itertools import product
from importlib import import_module

import numpy as np

import mapf_pz
import mapf_pz.simulator.kernels
import mapf_pz.planners
from mapf_pz.planners.lacam import search as lacam
from mapf_pz._internal.jit import BatchKernel
from mapf_pz.instances import RandomObstacles
from mapf_pz.planners import PLANNERS, Planner
from mapf_pz.instances.instance import Instance
from tests.helpers.hand_clock import HandClock

Planner.clock = HandClock(pace=0.01)
modules = [
    import_module(module.name)
    for package in (mapf_pz.simulator.kernels, mapf_pz.planners)
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + ".")
]


def signatures():
    found = set()
    for module in modules:
        for kernel in vars(module).values():
            for dispatcher in (kernel._serial, kernel._parallel) if isinstance(kernel, BatchKernel) else (kernel,):
                if hasattr(dispatcher, "signatures"):
                    found |= {(dispatcher.py_func.__qualname__, signature) for signature in dispatcher.signatures}
    return found


def plan(name, model):
    options = {"time_limit": 0.2} if name != "pibt" else {}
    allocate = lacam.allocate_nodes
    lacam.allocate_nodes = lambda capacity, num_agents: allocate(min(capacity, 4), num_agents)  # must grow
    rng = np.random.default_rng(0)
    PLANNERS[name](**options).compile(model)
    compiled = signatures()
    assert any(name.startswith(("plan", "start", "continue_paths", "search")) for name, _ in compiled)
    for weights in ("uniform", "random"):
        drawn = RandomObstacles(6, 6, 0.2, 8).sample(rng)
        headings = None if model == "cardinal" else rng.integers(4, size=8)
        PLANNERS[name](**options).solve(Instance(drawn.grid, drawn.scenario, headings), 0.2, edge_weights=weights)
    assert signatures() == compiled, signatures() - compiled
    for weights, on_target in product(("uniform", "random"), ("nothing", "finish", "restart")):
        keywords = dict(action_model=model, on_target=on_target, edge_weights=weights, view_size=(1, 1), max_steps=3)
        env = mapf_pz.parallel_env(source=RandomObstacles(6, 6, 0.2, 8), **keywords)
        env.reset(seed=0)
        env.step(dict.fromkeys(env.agents, 0))
        compiled = signatures()
        observations, _ = env.reset(seed=0)
        planner = PLANNERS[name](env, **options)
        while env.agents:
            observations = env.step(planner.act(observations))[0]
        assert signatures() == compiled, (on_target, signatures() - compiled)


def plans(name, model):
    # In a process of its own, which has compiled nothing yet.
    process_id = os.fork()
    if process_id == 0:
        try:
            plan(name, model)
        except BaseException:
            traceback.print_exc()
            os._exit(1)
        os._exit(0)
    return os.waitpid(process_id, 0)[1] == 0


assert not signatures()
wrong = [(name, model) for name in PLANNERS for model in ("rotate", "cardinal") if not plans(name, model)]
assert not wrong, wrong
"""


@pytest.mark.slow
def test_planning_compiles_nothing():
    done = subprocess.run([sys.executable, "-c", PLAN], capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stderr
