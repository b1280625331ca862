"""Warehouses: where stations are, and goals that alternate between them."""

import json
from pathlib import Path

import numpy as np
import pytest

import mapf_pz
from mapf_pz import FormatError
from mapf_pz.evaluation import load_suite
from mapf_pz.instances import WarehouseTasks, load_map, load_warehouse
from mapf_pz.instances.instance import Grid
from mapf_pz.planners import PIBT

LAYOUT = ["w.eee", "..@@e", "w.eee"]
STATIONS = [[0, 0], [2, 0]]
ENDPOINTS = [[0, 2], [0, 3], [0, 4], [1, 4], [2, 2], [2, 3], [2, 4]]
GRID = Grid(np.array([[cell != "@" for cell in row] for row in LAYOUT]), "depot")
RELEASED = Path(__file__).parents[3] / "shared" / "guidance-graphs" / "pibt_warehouse_33x36_w_mode.json"


def kinds(goals):
    """Return which goals, (..., 2), are workstations, after checking that the others are endpoints."""
    cells = goals[..., 0] * 5 + goals[..., 1]
    stations = np.isin(cells, [row * 5 + col for row, col in STATIONS])
    assert (stations | np.isin(cells, [row * 5 + col for row, col in ENDPOINTS])).all()
    return stations


def test_goals_alternate_between_random_stations():
    source = WarehouseTasks(GRID, STATIONS, ENDPOINTS, num_agents=4, goals_per_agent=7)
    rng = np.random.default_rng(0)
    instances = [source.sample(rng) for _ in range(1500)]
    starts = np.stack([instance.scenario.starts for instance in instances])
    goals = np.stack([instance.scenario.goals for instance in instances])
    at_workstation = kinds(goals)
    assert (at_workstation[..., 1:] != at_workstation[..., :-1]).all()
    # Starts are uniform on the free cells; so are the stations of each kind among the goals.
    for cells, count in ((starts, 13), (goals[at_workstation], 2), (goals[~at_workstation], 7)):
        _, counts = np.unique(cells.reshape(-1, 2), axis=0, return_counts=True)
        assert len(counts) == count
        expected = counts.sum() / count
        assert ((counts - expected) ** 2 / expected).sum() < count - 1 + 5 * np.sqrt(2 * count)  # five standard errors
    # The first goal is of the other kind than the start; elsewhere, both kinds are equally likely.
    on_workstation = np.isin(starts @ [5, 1], [0, 10])
    on_endpoint = np.isin(starts @ [5, 1], [row * 5 + col for row, col in ENDPOINTS])
    assert not at_workstation[..., 0][on_workstation].any()
    assert at_workstation[..., 0][on_endpoint].all()
    elsewhere = at_workstation[..., 0][~on_workstation & ~on_endpoint]
    assert abs(elsewhere.mean() - 0.5) < 5 * 0.5 / np.sqrt(elsewhere.size)


@pytest.fixture
def files(tmp_path):
    (tmp_path / "depot.json").write_text(json.dumps({"layout": LAYOUT}))
    text = "\n".join(LAYOUT).replace("w", "E").replace("e", "S")
    (tmp_path / "depot.map").write_text(f"type octile\nheight 3\nwidth 5\nmap\n{text}\n")
    return tmp_path


@pytest.mark.parametrize("name", ["depot.json", "depot.map"])
def test_files_of_warehouses(files, name):
    grid, workstations, endpoints = load_warehouse(files / name)
    assert grid == load_map(files / name) == GRID
    assert workstations.tolist() == STATIONS
    assert endpoints.tolist() == ENDPOINTS


def test_the_released_warehouse():
    if not RELEASED.is_file():
        pytest.skip(f"{RELEASED} is absent: GGO's files are not part of the repository")
    grid, workstations, endpoints = load_warehouse(RELEASED)
    assert (grid.shape, grid.free.sum(), len(workstations), len(endpoints)) == ((33, 36), 948, 22, 480)


def test_the_stations_of_the_league():
    _, workstations, endpoints = load_warehouse("warehouse_small")
    assert (len(workstations), len(endpoints)) == (40, 342)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"workstations": []}, r"workstations: expected cells \[row, col\], one or more, got the shape \(0,\)"),
        ({"endpoints": [[0, 5]]}, r"endpoints: \[row 0, col 5\] is not in the largest component of map 'depot'"),
        ({"endpoints": [[1, 2]]}, r"endpoints: \[row 1, col 2\] is not in the largest component"),
        ({"endpoints": [[-1, 2]]}, r"endpoints: \[row -1, col 2\] is not in the largest component"),
        ({"endpoints": STATIONS}, "workstations, endpoints: expected different cells"),
        ({"num_agents": 14}, "num_agents=14: expected 1 to 13"),
        ({"goals_per_agent": 1}, "goals_per_agent=1: expected 2 or more"),
    ],
)
def test_refusals(changes, message):
    arguments = {"workstations": STATIONS, "endpoints": ENDPOINTS, "num_agents": 2, "goals_per_agent": 3} | changes
    with pytest.raises(ValueError, match=message):
        WarehouseTasks(GRID, **arguments)


# As a field of an environment's configuration.

KEYWORDS = {"num_agents": 3, "goals": "alternating", "on_target": "restart", "view_size": (3, 3)}


@pytest.mark.parametrize("name", ["depot.json", "depot.map"])
def test_an_environment_with_alternating_goals(files, name):
    env = mapf_pz.parallel_env(map=files / name, max_steps=60, **KEYWORDS)
    observations, _ = env.reset(seed=1)
    planner = PIBT(env)
    goals = [env.simulator.goals(0)]
    while env.agents:
        observations = env.step(planner.act(observations))[0]
        goals.append(env.simulator.goals(0))
    stations = kinds(np.array(goals))
    new = (np.diff(goals, axis=0) != 0).any(axis=2)
    assert new.sum() > 5
    np.testing.assert_array_equal(stations[1:] != stations[:-1], new)


@pytest.mark.parametrize(
    ("keywords", "error", "message"),
    [
        ({"goals": "some"}, ValueError, "goals='some': expected one of 'uniform', 'alternating'"),
        ({"on_target": "nothing"}, ValueError, "goals='alternating': allowed only with on_target='restart'"),
        ({"scenario": "a.scen"}, ValueError, "goals='alternating': not allowed together with scenario or source"),
        ({"map": GRID}, ValueError, "goals='alternating': expected a map's name or file, which says where"),
        ({"map": "empty-8-8"}, ValueError, "workstations: expected cells"),
        ({"map": "nowhere.json"}, FileNotFoundError, "nowhere.json: no such file"),
        ({"map": "no-layout.json"}, FormatError, "no-layout.json: expected 'layout' to be a list, got None"),
    ],
)
def test_what_an_environment_refuses(files, monkeypatch, keywords, error, message):
    monkeypatch.chdir(files)
    (files / "no-layout.json").write_text("{}")
    with pytest.raises(error, match=f"^{message}"):
        mapf_pz.parallel_env(**{"map": "depot.json"} | KEYWORDS | keywords)


def test_a_suite_with_alternating_goals(files):
    env = KEYWORDS | {"edge_weights": "depot.w", "view_size": [3, 3]}
    (files / "depot.w").write_text(json.dumps([1] * 75))
    del env["num_agents"]
    entry = {"map": "depot.json", "num_agents": 3, "max_steps": 20, "env": env}
    (files / "mine.json").write_text(json.dumps({"tasks": [entry]}))
    [task] = load_suite(files / "mine.json")
    env = mapf_pz.parallel_env(**task.env_keywords(0))
    assert isinstance(env.simulator.source, WarehouseTasks)
    assert env.config.edge_weights == files / "depot.w"
