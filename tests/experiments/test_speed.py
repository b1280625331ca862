"""Measurements of speed: what the tables contain, on workloads of a few steps."""

import re
import sys
from dataclasses import replace

import pytest

from experiments.speed import scaling, startup
from experiments.speed.__main__ import COMMANDS, main
from experiments.speed.candidates import COPY, as_table
from experiments.speed.runs import Measurement, measure, timed
from experiments.speed.workload import Workload


def run(capsys, *words):
    """Run a command; return its status and the lines of both outputs. An error's message is on the second one."""
    status, message = 0, ""
    try:
        main([str(word) for word in words])
    except SystemExit as end:
        status, message = (end.code, "") if isinstance(end.code, int) else (1, str(end.code))
    out, err = capsys.readouterr()
    return status, out.splitlines(), (err + message).splitlines()


def test_commands(capsys):
    status, out, err = run(capsys, "--help")
    assert (status, err) == (0, [])
    assert [line.split()[0] for line in out if line.startswith("  ")] == list(COMMANDS)
    assert run(capsys, "bench")[0] == 2
    assert run(capsys, "environments", "--colour", "1")[0] == 2


SMALL = ["--seconds", 0, "--num-envs", 2, "--num-agents", 2, "--max-steps", 4]


@pytest.mark.filterwarnings("ignore:PettingZoo in TorchRL:UserWarning")
def test_environments(capsys):
    status, out, err = run(capsys, "environments", *SMALL, "--map", "random-12-12-15")
    assert (status, err) == (0, [])
    text = "\n".join(out)
    for name in ("simulator", "stepping", "observing", "PettingZoo", "TorchRL", "PettingZooWrapper", "100.0%"):
        assert name in text


@pytest.mark.slow
def test_environments_on_random_maps_without_torchrl(capsys, monkeypatch):
    monkeypatch.setattr("experiments.speed.candidates.find_spec", lambda name: None)
    status, out, err = run(capsys, "environments", *SMALL, "--num-threads", 2)
    assert (status, err) == (0, [])
    text = "\n".join(out)
    assert "not measured, as not installed: " in text
    assert "│   PettingZooWrapper" not in text


@pytest.mark.slow
def test_environments_of_startup(capsys, monkeypatch):
    exec(startup.FIRST_STEP, {})
    one_kernel = "import numpy; from mapf_pz.instances import components; components(numpy.ones((3, 3), bool))"
    monkeypatch.setattr(startup, "FIRST_STEP", one_kernel)  # compiled in a second; those of a step in half a minute
    monkeypatch.setattr(startup, "MIN_RUNS", 2)
    status, out, err = run(capsys, "environments", *SMALL, "--tables", "resets", "startup")
    assert (status, err) == (0, [])
    text = "\n".join(out)
    assert "64 agents, new map and cost to go" in text
    assert "import and first step afterwards" in text


def test_environments_along_axes(capsys, monkeypatch):
    def two(axis):
        return lambda load: dict(list(axis(load).items())[:2])

    monkeypatch.setattr(scaling, "AXES", tuple(two(axis) for axis in scaling.AXES))
    status, out, err = run(capsys, "environments", *SMALL, "--tables", "scaling")
    assert (status, err) == (0, [])
    text = "\n".join(out)
    for row in ("64 agents on 32 x 32", "8 environments", "views of 7 x 7", "maps of 64 x 64", "1 threads"):
        assert row in text


def test_axes_change_one_thing():
    workload = Workload(num_envs=16).with_env(num_agents=64)
    fields = {"num_agents": "more_agents", "num_envs": "more_environments", "view_size": "larger_views"}
    fields |= {"height": "larger_maps", "num_threads": "more_threads"}
    for field, axis in fields.items():
        workloads = list(getattr(scaling, axis)(workload).values())
        values = [getattr(one.env if hasattr(one.env, field) else one, field) for one in workloads]
        assert values == sorted(set(values))
        if field == "view_size":
            assert {one.with_env(view_size=(5, 5)) for one in workloads} == {workload}
        elif field != "num_agents":
            assert {replace(one, **{field: 0, "width": 0}) for one in workloads} == {
                replace(workload, **{field: 0, "width": 0})
            }
    density = {one.height * one.width / one.num_agents for one in scaling.more_agents(workload).values()}
    assert density == {16}


@pytest.mark.slow
def test_environments_of_any_environment(capsys, monkeypatch):
    monkeypatch.setattr("experiments.speed.candidates.find_spec", lambda name: None)
    words = ["--on-target", "restart", "--channels", "view", "heuristic", "--map", "random-12-12-15", "--complete"]
    assert run(capsys, "environments", *SMALL, *words)[::2] == (0, [])


def test_environments_errors(capsys):
    status, out, err = run(capsys, "environments", "--map", "empty-8-8", "--num-agents", 1000)
    assert (status, out) == (1, [])
    assert err == [
        "experiments.speed environments: 1000 agents do not fit on the 64 cells of the map's largest component"
    ]


def test_medians_and_ratios():
    calls = []
    measured = measure({"slow": timed(lambda: calls.append(0) or 10), COPY: timed(lambda: 1000)}, seconds=0)
    assert len(calls) == 6  # the first does not count
    assert [(one.name, one.num_runs) for one in measured.values()] == [("slow", 5), (COPY, 5)]
    rates = {"half": (5, 30), COPY: (10, 60), "POGEMA": (1, 3)}
    table = as_table({name: Measurement(name, *rate, 1, 1300) for name, rate in rates.items()})
    assert next(iter(table.columns[1].cells)) == "1,300"
    assert [list(column.cells) for column in table.columns][-2:] == [
        ["50.0%", "100.0%", "10.0%"],
        ["10.0", "20.0", "1.0"],
    ]


def test_a_process_clock_that_stands_still(monkeypatch):
    monkeypatch.setattr("experiments.speed.runs.time.process_time", lambda: 1.0)
    assert measure({"quick": timed(lambda: 1)}, seconds=0)["quick"].cpu_rate > 0


POGEMA = """
class Observed:
    nbytes = 108

class GridConfig:
    def __init__(self, map, num_agents, obs_radius, max_episode_steps, **rest):
        assert (map.count("\\n"), obs_radius, max_episode_steps) == (6, 1, 4), map
        self.num_agents = num_agents

class pogema_v0:
    def __init__(self, grid_config):
        pass
    def reset(self):
        return [Observed()] * 2, [{}] * 2
    def step(self, actions):
        assert len(actions) == 2
        return (self.reset()[0],)
"""
RWARE = """
class Any:
    def __getattr__(self, name):
        return name
ObservationType = RewardType = Any()

class Warehouse:
    def __init__(self, n_agents, max_steps, **rest):
        assert (n_agents, max_steps) == (4, 4)
    def reset(self, seed):
        return [Observed()] * 4, {}
    def step(self, actions):
        assert len(actions) == 4
        return (self.reset(0)[0],)

class Observed:
    nbytes = 284
"""


@pytest.mark.slow
def test_beside_pogema(capsys, monkeypatch, tmp_path):
    monkeypatch.setattr("experiments.speed.candidates.find_spec", lambda name: None)
    words = [*SMALL, "--height", 7, "--width", 7, "--view-size", 3, 3, "--pogema", sys.executable]
    status, out, err = run(capsys, "environments", *words)
    assert (status, len(err)) == (1, 1)
    assert err[0].endswith("is POGEMA 1.4.0 installed? ModuleNotFoundError: No module named 'pogema'")
    (tmp_path / "pogema.py").write_text(POGEMA)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    status, out, err = run(capsys, "environments", *words)
    assert (status, err) == (0, [])
    assert "x POGEMA" in "\n".join(out)
    assert re.search(r"│ POGEMA +│ +108 │", "\n".join(out))
    assert run(capsys, "environments", *words, "--new-maps")[2][0].startswith(
        "experiments.speed environments: pogema: expected one map"
    )


@pytest.mark.slow
def test_beside_other_environments(capsys, monkeypatch, tmp_path):
    monkeypatch.setattr("experiments.speed.candidates.find_spec", lambda name: None)
    (tmp_path / "rware").mkdir()
    (tmp_path / "rware" / "warehouse.py").write_text(RWARE)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    status, out, err = run(capsys, "environments", *SMALL, "--new-maps", "--rware", sys.executable)
    assert (status, err) == (0, [])
    assert re.search(r"│ rware, 4 agents +│ +284 │", "\n".join(out))
    status, out, err = run(capsys, "environments", *SMALL, "--jumanji", sys.executable)
    assert (status, len(err)) == (1, 1)
    assert err[0].endswith("is Jumanji 1.1 installed? ModuleNotFoundError: No module named 'jax'")
