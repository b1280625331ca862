"""Instances of the page that cannot be solved get one line; those that can are the package's."""

import base64

import numpy as np
import pytest

from mapf_pz.editor.instances import graph_of, instance_of
from mapf_pz.editor.requests import EditedInstance, Refusal
from mapf_pz.guidance import GuidanceGraph
from mapf_pz.instances import Grid, Scenario, format_map

GRID = Grid(np.array([[True, True, True], [False, False, False], [True, True, True]]))
GIVEN = {"name": "two", "map": format_map(GRID), "starts": [[0, 0], [0, 2]], "goals": [[[0, 2]], [[0, 0]]]}


def encoded(values):
    return base64.b64encode(np.asarray(values, "<f4").tobytes()).decode()


def test_an_instance():
    instance = instance_of(EditedInstance(**GIVEN), lifelong=False)
    assert instance.grid == Grid(GRID.free, "two")
    assert instance.scenario == Scenario([[0, 0], [0, 2]], [[0, 2], [0, 0]])
    assert instance.headings is None
    assert instance_of(EditedInstance(**GIVEN, headings=[3, 1]), lifelong=False).headings.tolist() == [3, 1]


def test_sequences_of_goals_may_differ_in_length():
    given = GIVEN | {"goals": [[[0, 2]], [[0, 0], [0, 1], [0, 2]]]}
    scenario = instance_of(EditedInstance(**given), lifelong=True).scenario
    assert scenario.goal_counts.tolist() == [1, 3]
    assert scenario.goals[1].tolist() == [[0, 0], [0, 1], [0, 2]]


def test_weights():
    graph = GuidanceGraph.crisscross(GRID.free)
    weights = np.concatenate([graph.move, graph.wait[None]])
    assert graph_of(encoded(weights), GRID) == graph
    assert graph_of(encoded(np.where(np.isinf(weights), 7, weights)), GRID) == graph


@pytest.mark.parametrize(
    ("changes", "error"),
    [
        ({"map": "type octile\nheight 1"}, "two.map:3:1: expected 'width' and a number, got ''"),
        ({"map": format_map(Grid(np.ones((1, 1025), np.bool_)))}, "map: expected at most 1024 x 1024 cells, got 1 x "),
        ({"starts": [], "goals": []}, "expected 1 to 10000 agents, got 0"),
        ({"starts": [[0, 0]] * 10_001, "goals": [[[0, 0]]] * 10_001}, "expected 1 to 10000 agents, got 10001"),
        ({"goals": [[[0, 2]]]}, "goals: expected a list for each of 2 agents, got 1"),
        ({"goals": [[[0, 2]], []]}, "agent 1: expected one goal unless the run is lifelong, got 0"),
        ({"goals": [[[0, 2], [0, 1]], [[0, 0]]]}, "agent 0: expected one goal unless the run is lifelong, got 2"),
        ({"starts": [[1, 0], [0, 2]]}, "agent 0: start [row 1, col 0] is an obstacle of map 'two' (3 x 3)"),
        ({"starts": [[0, 0], [0, 3]]}, "agent 1: start [row 0, col 3] is outside of map 'two' (3 x 3)"),
        ({"starts": [[0, 0], [-1, 2]]}, "agent 1: start [row -1, col 2] is outside of map 'two' (3 x 3)"),
        ({"starts": [[0, 0], [0, 0]]}, "agent 1: start [row 0, col 0] is also another agent's start"),
        ({"starts": [[0, 0], [0, 10**30]]}, "instance.starts.1.1: Input should be less than or equal to 10737"),
        ({"goals": [[[0, 2]], [[1, 1]]]}, "agent 1: goal [row 1, col 1] is an obstacle of map 'two' (3 x 3)"),
        ({"goals": [[[0, 2]], [[2, 2]]]}, "agent 1: no path on map 'two' leads from its start [row 0, col 2] to"),
        ({"headings": [0]}, "headings: expected 2 numbers 0 to 3"),
        ({"headings": [0, 4]}, "headings: expected 2 numbers 0 to 3"),
        ({"headings": [0, 10**30]}, "instance.headings.1: Input should be less than or equal to 1073741824"),
    ],
)  # fmt: skip
def test_instances_that_are_refused(server, changes, error):
    status, message = server.refused("solve", instance=GIVEN | changes, solvers=["pibt"])
    assert status == 400
    assert message.startswith(error)


def test_lifelong_instances_that_are_refused(server):
    given = GIVEN | {"goals": [[[0, 2]], []]}
    assert server.refused("solve", instance=given, solvers=["pibt"], lifelong=True)[1] == (
        "agent 1: expected at least one goal"
    )
    given = GIVEN | {"goals": [[[0, 2]], [[0, 0]] * 500_001]}
    assert server.refused("solve", instance=given, solvers=["pibt"], lifelong=True)[1] == (
        "goals: expected at most 500000 for each of 2 agents"
    )


@pytest.mark.parametrize("weights", ["?", "AAAA", encoded(np.ones((4, 3, 3))), encoded(np.ones((5, 3, 3))) + "AAAA"])
def test_weights_of_another_shape(weights):
    with pytest.raises(Refusal, match=r"weights: expected base64 of float32 numbers of the shape \(5, 3, 3\)"):
        graph_of(weights, GRID)


@pytest.mark.parametrize("weight", [0, -1, np.nan])
def test_weights_out_of_range(server, weight):
    weights = np.ones((5, 3, 3))
    weights[2, 0, 1] = weight
    answer = server.refused("solve", instance=GIVEN | {"weights": encoded(weights)}, solvers=["pibt"])
    assert answer == (400, "guidance graph: expected weights greater than 0, and finite ones for waiting")


@pytest.mark.parametrize(
    ("members", "error"),
    [
        ({"solvers": []}, "solvers: List should have at least 1 item"),
        ({"solvers": ["pibt"] * 3}, "solvers: List should have at most 2 items"),
        ({"solvers": ["nobody"]}, "policy 'nobody': expected random, a planner (pibt, "),
        ({"solvers": ["pibt:depth=2"]}, "option 'depth=2': PIBT has the options priority, swap, preference"),
        ({"solvers": ["pibt:priority=x"]}, "priority="),
        ({"solvers": ["lacam"], "time_limit": 0}, "time_limit: Input should be greater than 0"),
        ({"solvers": ["pibt"], "max_steps": 0}, "max_steps: Input should be greater than or equal to 1"),
        ({"solvers": ["pibt"], "max_steps": 10**9}, "max_steps: Input should be less than or equal to 100000"),
        ({"solvers": ["pibt"], "seed": 1.5}, "seed: Input should be a valid integer"),
        ({"solvers": ["pibt"], "lifelong": "yes"}, "lifelong: Input should be a valid boolean"),
        ({"solvers": ["pibt:edge_weights=nothing"], "lifelong": True}, "edge_weights='nothing': expected one of"),
    ],
)
def test_runs_that_are_refused(server, members, error):
    status, message = server.refused("solve", instance=GIVEN, **members)
    assert status == 400
    assert message.startswith(error)


@pytest.mark.parametrize("solver", ["stranger:Thing", "stranger:Thing+pibt:patience=2", "mapf_pz.planners:PIBT"])
def test_other_code_than_that_of_the_user_is_refused(server, solver):
    status, message = server.refused("solve", instance=GIVEN, solvers=[solver])
    code = solver.partition("+")[0]
    assert (status, message) == (403, f"{code}: expected code that the editor was started with, as in --solver {code}")


def test_solvers_read_only_files_inside_the_folders(server, tmp_path):
    (tmp_path / "run").mkdir()
    for solver in (str(tmp_path / "run"), f"{tmp_path / 'run'}+pibt:patience=2"):
        assert server.refused("solve", instance=GIVEN, solvers=[solver])[0] == 403
    (tmp_path / "files" / "policy.safetensors").symlink_to(tmp_path / "run" / "policy.safetensors")
    assert server.refused("solve", instance=GIVEN, solvers=[str(tmp_path / "files")])[0] == 403
    weights = f"pibt:edge_weights={tmp_path / 'graph.json'}"
    assert server.refused("solve", instance=GIVEN, solvers=[weights], lifelong=True)[0] == 403


@pytest.mark.parametrize("address", ["hf://me/policy", "hf://me/policy@v1"])
@pytest.mark.parametrize("options", ["", "+pibt", ":temperature=0", "+pibt:patience=2"])
def test_no_solver_is_downloaded(server, monkeypatch, tmp_path, address, options):
    monkeypatch.chdir(tmp_path / "files")  # relative paths are inside the folder
    status, message = server.refused("solve", instance=GIVEN, solvers=["pibt", address + options])
    assert status == 403
    assert message == f"{address}: expected a planner, a policy of the package, or a run inside the folders"
