import numpy as np
import pytest

from mapf_pz.instance import Grid, Scenario
from mapf_pz.instances import load_instance, write_map, write_scenario

MAP = "....\n.@..\n...."
SCENARIO = Scenario([[0, 0], [2, 3], [2, 0]], [[0, 3], [0, 0], [1, 3]])


def test_all_agents_of_a_scenario_face_east():
    instance = load_instance(MAP, SCENARIO)
    assert instance.scenario.starts.tolist() == SCENARIO.starts.tolist()
    assert instance.scenario.goals.tolist() == SCENARIO.goals.tolist()
    assert instance.headings.tolist() == [0, 0, 0]


def test_the_first_agents_of_files(tmp_path):
    grid = Grid(np.ones((3, 4), bool), "small")
    write_map(grid, tmp_path / "small.map")
    write_scenario(SCENARIO, grid, tmp_path / "small.scen")
    instance = load_instance(tmp_path / "small.map", str(tmp_path / "small.scen"), 2, headings=[3, 1])
    assert instance.scenario.starts.tolist() == SCENARIO.starts[:2].tolist()
    assert instance.headings.tolist() == [3, 1]
    assert instance.grid.name == "small"
    with pytest.raises(ValueError, match=r"small\.scen: expected 4 agents, got 3$"):
        load_instance(tmp_path / "small.map", tmp_path / "small.scen", 4)


def test_cardinal_agents_have_no_headings():
    assert load_instance(MAP, SCENARIO, 1, "cardinal").headings is None


def test_starts_goals_and_headings_are_drawn_from_the_seed():
    instances = [load_instance(MAP, None, 5, headings="random", seed=seed) for seed in (1, 1, 2)]
    starts = [(i.scenario.starts.tolist(), i.scenario.goals.tolist(), i.headings.tolist()) for i in instances]
    assert starts[0] == starts[1] != starts[2]


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"scenario": SCENARIO, "num_agents": 4}, "scenario: expected 4 agents, got 3"),
        ({"scenario": SCENARIO, "num_agents": 0}, "num_agents=0: expected a whole number, 1 or more"),
        ({"scenario": None}, "num_agents: expected a number, as there is no scenario"),
        ({"scenario": SCENARIO, "headings": "north"}, "headings='north': expected 'east', 'random' or 3 numbers"),
        ({"scenario": SCENARIO, "headings": [0, 4, 0]}, "headings: expected 3 numbers 0 to 3"),
        ({"scenario": SCENARIO, "map": ".@..\n@@..\n...."}, "agent 0: no path on map 'custom' leads from its start"),
        ({"scenario": SCENARIO, "map": "....\n....\n...@"}, r"agent 1: start \[row 2, col 3\] is an obstacle"),
    ],
)
def test_what_is_refused(keywords, message):
    with pytest.raises(ValueError, match=message):
        load_instance(**{"map": MAP} | keywords)
