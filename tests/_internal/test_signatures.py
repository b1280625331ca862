"""Signatures: what editors, `help()` and type checkers know about functions that take the fields of `EnvConfig`."""

import dataclasses
import inspect
import json
import pydoc
import subprocess
import sys
from pathlib import Path

import pytest

import mapf_pz
from mapf_pz.instances import MapMixture
from mapf_pz.simulator.config import EnvConfig
from mapf_pz.wrappers import CentralizedVectorEnv
from mapf_pz.wrappers.centralized import centralized_env

ROOT = Path(__file__).parents[2]
FIRST = {
    mapf_pz.parallel_env: [],
    mapf_pz.env: [],
    centralized_env: ["action_mode", "team_reward"],
    CentralizedVectorEnv: ["num_envs", "num_threads", "autoreset_mode", "action_mode", "team_reward"],
}


def callables():
    """Return the functions and classes, and their parameters before those of `EnvConfig`."""
    pytest.importorskip("torchrl")
    from mapf_pz.rl import BatchedMapfEnv

    return FIRST | {BatchedMapfEnv: ["num_envs", "num_threads", "device", "observation_precision", "state", "metrics"]}


def test_signatures_have_types_and_defaults():
    fields = {field.name: field for field in dataclasses.fields(EnvConfig)}
    for function, first in callables().items():
        parameters = inspect.signature(function).parameters
        assert list(parameters) == [*first, *fields]
        for name, field in fields.items():
            assert (parameters[name].default, parameters[name].annotation) == (field.default, field.type)
            assert parameters[name].kind == inspect.Parameter.KEYWORD_ONLY
        for name in first:
            assert parameters[name].kind == inspect.Parameter.POSITIONAL_OR_KEYWORD
            assert parameters[name].default is not inspect.Parameter.empty


def test_help_describes_every_parameter():
    for function in callables():
        shown = pydoc.render_doc(function, renderer=pydoc.plaintext)
        for name in inspect.signature(function).parameters:
            assert f"    {name}: " in shown, f"{function.__name__}: {name}"
        assert "Maximum number of steps per episode, after which it is truncated." in shown


@pytest.mark.parametrize("config", [EnvConfig, mapf_pz.RewardConfig, mapf_pz.Channel, mapf_pz.Feature, MapMixture])
def test_help_describes_every_field(config):
    shown = pydoc.render_doc(config, renderer=pydoc.plaintext)
    for field in dataclasses.fields(config):
        assert f"     {field.name}: " in shown, field.name


PROGRAM = """
import mapf_pz
from mapf_pz import env, parallel_env
from mapf_pz.rl import BatchedMapfEnv, load_policy
from mapf_pz.wrappers import CentralizedVectorEnv
from mapf_pz.wrappers.centralized import centralized_env

reveal_type(parallel_env(map="empty-8-8", num_agents=2))
reveal_type(centralized_env("softmax", num_agents=2))
reveal_type(BatchedMapfEnv(64, num_agents=2, device="cpu"))
reveal_type(CentralizedVectorEnv(num_envs=2, team_reward="mean", max_steps=9))
reveal_type(load_policy("mappo", deterministic=True))
reveal_type(mapf_pz.planners.PIBT())
parallel_env(channels=["view"], features=["time"], view_size=[7, 7], scenario=["a.scen"], initial_heading=[0])
parallel_env(num_agent=2)
env(num_agents="two")
centralized_env(team_reward="most")
centralized_env(maps="empty-8-8")
BatchedMapfEnv(num_env=2)
BatchedMapfEnv(2, view_size=5)
CentralizedVectorEnv(num_envs="two")
load_policy(3)
"""
TYPES = ["MapfEnv", "CentralizedEnv", "BatchedMapfEnv", "CentralizedVectorEnv", "LearnedPolicy", "PIBT"]


@pytest.mark.slow
def test_a_type_checker_knows_the_keywords(tmp_path):
    pytest.importorskip("basedpyright")
    pytest.importorskip("torchrl")
    (tmp_path / "program.py").write_text(PROGRAM)
    settings = {"extraPaths": [str(ROOT)], "reportUnusedCallResult": False, "reportUnusedExpression": False}
    (tmp_path / "pyrightconfig.json").write_text(json.dumps(settings))
    command = [sys.executable, "-m", "basedpyright", "--outputjson", "--pythonpath", sys.executable, "program.py"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    found = json.loads(done.stdout)["generalDiagnostics"]
    revealed = [one["message"] for one in found if one["severity"] == "information"]
    assert [message.split('"')[-2] for message in revealed] == TYPES
    lines = [line for line, code in enumerate(PROGRAM.splitlines()) if code.startswith("parallel_env(num_agent=")]
    errors = {one["range"]["start"]["line"] for one in found if one["severity"] == "error"}
    assert errors == set(range(lines[0], len(PROGRAM.splitlines())))
