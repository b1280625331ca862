import numpy as np
import pytest

import mapf_pz
from mapf_pz.errors import FormatError
from mapf_pz.instances import load_instance, load_instances, write_map, write_scenario
from mapf_pz.instances.instance import Grid, Scenario
from tests.instances.problem_files import POGEMA_INSTANCES, write_lorr, write_pogema

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
    with pytest.raises(ValueError, match=r"num_agents=4: .*small\.scen has 3 agents$"):
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
        ({"scenario": SCENARIO, "num_agents": 4}, "num_agents=4: the scenario has 3 agents"),
        ({"scenario": SCENARIO, "num_agents": 0}, "num_agents=0: expected a whole number, 1 or more"),
        ({"scenario": None}, "num_agents: expected a number, as there is no scenario"),
        ({"scenario": "depot.json"}, "scenario='depot.json': expected a .scen file of the map; problem files are"),
        ({"scenario": SCENARIO, "headings": "north"}, "headings='north': expected 'east', 'random' or 3 numbers"),
        ({"scenario": SCENARIO, "headings": [0, 4, 0]}, "headings: expected 3 numbers 0 to 3"),
        ({"scenario": SCENARIO, "map": ".@..\n@@..\n...."}, "agent 0: no path on map 'custom' leads from its start"),
        ({"scenario": SCENARIO, "map": "....\n....\n...@"}, r"agent 1: start \[row 2, col 3\] is an obstacle"),
    ],
)
def test_invalid_arguments_are_refused(keywords, message):
    with pytest.raises(ValueError, match=message):
        load_instance(**{"map": MAP} | keywords)


@pytest.fixture
def scenarios(tmp_path):
    """The files of two scenarios of one map, of three agents and of two."""
    grid = Grid(np.ones((3, 4), bool), "small")
    write_map(grid, tmp_path / "small.map")
    write_scenario(SCENARIO, grid, tmp_path / "a.scen")
    write_scenario(Scenario(SCENARIO.goals[:2], SCENARIO.starts[:2]), grid, tmp_path / "b.scen")
    return tmp_path


def sampled(env, episodes=20):
    """Return the different starts and goals of some episodes."""
    found = set()
    for seed in range(episodes):
        env.reset(seed=seed)
        found.add((str(env.positions.tolist()), str(env.goals.tolist())))
    return found


def test_each_episode_samples_one_of_the_scenarios(scenarios):
    files = [scenarios / "a.scen", str(scenarios / "b.scen")]
    env = mapf_pz.parallel_env(map=scenarios / "small.map", scenario=files, view_size=(3, 3))
    assert len(env.possible_agents) == 2
    starts, goals = (str(cells[:2].tolist()) for cells in (SCENARIO.starts, SCENARIO.goals))
    assert sampled(env) == {(starts, goals), (goals, starts)}
    assert env.simulator.source.grid is not None
    env = mapf_pz.parallel_env(map=scenarios / "small.map", scenario=files, num_agents=1, view_size=(3, 3))
    assert len(env.possible_agents) == 1


def test_a_robot_runners_problem_is_a_scenario(tmp_path):
    env = mapf_pz.parallel_env(scenario=write_lorr(tmp_path), on_target="restart", max_steps=30, initial_heading="east")
    env.reset(seed=0)
    assert env.simulator.shape == (6, 7)
    assert env.positions.tolist() == [[0, 0], [0, 3], [1, 6]]
    assert env.goals.tolist() == [[5, 6], [2, 6], [1, 1]]
    assert env.simulator.state.goals[0, 0, :4].tolist() == [41, 5, 20, 30]  # tasks 0, 3, 6 = 1, 9 = 4
    env = mapf_pz.parallel_env(scenario=str(tmp_path / "depot.json"), num_agents=2)
    env.reset(seed=0)
    assert env.goals.tolist() == [[5, 6], [2, 6]]


def test_pogema_instances_on_maps_of_different_sizes(tmp_path):
    env = mapf_pz.parallel_env(scenario=write_pogema(tmp_path), on_target="restart", max_steps=9)
    assert (env.simulator.shape, len(env.possible_agents)) == ((6, 7), 3)
    starts = [str(entry["agents_xy"][:3]) for entry in POGEMA_INSTANCES]
    assert {start for start, _ in sampled(env)} == set(starts)
    small, large = load_instances([tmp_path / "01-set.lmapf.json"])
    assert small.grid.free.tolist() == [[True] * 6 + [False]] * 5 + [[False] * 7]
    assert large.grid.free.sum() == 39
    assert small.scenario.goal_counts.tolist() == [2, 1, 2]


def test_several_problems_share_a_canvas(tmp_path):
    one, two = write_lorr(tmp_path), write_lorr(tmp_path, "hall", 4, 9, starts=(0, 35), tasks=(8, 9))
    first, second = load_instances([one, two])
    assert first.grid.shape == second.grid.shape == (6, 9)
    assert first.num_agents == second.num_agents == 2
    assert first.headings.tolist() == [0, 0]
    assert second.scenario.starts.tolist() == [[0, 0], [3, 8]]


@pytest.mark.parametrize("column", ["empty-8-8.map", "../maps/empty-8-8.map", "..\\maps\\empty-8-8.map", "empty-8-8"])
def test_the_map_beside_a_scenario_comes_first(tmp_path, column):
    grid = Grid(np.tri(8, 8, dtype=bool), "empty-8-8")
    write_map(grid, tmp_path / "empty-8-8.map")
    file = tmp_path / "own.scen"
    write_scenario(Scenario([[7, 0], [0, 0]], [[7, 7], [1, 1]]), grid, file)
    file.write_text(file.read_text().replace("empty-8-8.map", column))
    for scenario in (file, str(file), [str(file), file]):
        assert (mapf_pz.parallel_env(scenario=scenario).simulator.source.grid.free == grid.free).all()
    (tmp_path / "empty-8-8.map").unlink()
    assert mapf_pz.parallel_env(scenario=file).simulator.source.grid.free.all()


def test_maps_beside_scenarios_of_different_folders_differ(tmp_path):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        write_map(Grid(np.ones((3, 4), bool), "own"), tmp_path / name / "own.map")
        write_scenario(SCENARIO, Grid(np.ones((3, 4), bool), "own"), tmp_path / name / "own.scen")
    files = [tmp_path / name / "own.scen" for name in ("a", "b")]
    with pytest.raises(
        ValueError, match=r"scenario: expected scenarios of one map, got those of '.*/a/own\.map' \(.*/b/own"
    ):
        mapf_pz.parallel_env(scenario=files)


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"map": "small.map", "scenario": ("a.scen", "b.scen"), "num_agents": 3}, "num_agents=3: b.scen has 2 agents"),
        ({"scenario": "depot.json", "num_agents": 4}, "num_agents=4: depot.json has 3 agents"),
        ({"scenario": "depot.json", "map": "small.map"}, "map: not allowed with the scenario 'depot.json'"),
        (
            {"scenario": ("depot.json", "a.scen")},
            "scenario: expected only problem files, such as 'depot.json', or only",
        ),
        ({"map": "depot.json"}, "depot.json: expected a map with the member 'layout'; a problem's .json file is a sc"),
        ({"scenario": "broken.json"}, "broken.json:1:2: expected JSON"),
        ({"scenario": ("walled.scen", "a.scen"), "map": "walled.map"}, "walled.scen: agent 0: no path on map 'walled'"),
        ({"scenario": ("a.scen", "walled.scen"), "map": "small.map"}, "walled.scen:2:"),
        ({"scenario": ()}, r"scenario=\(\): expected the path of a file, several paths, or a Scenario"),
        ({"scenario": ("a.scen", 3)}, r"scenario=\('a.scen', 3\): expected the path of a file"),
        ({"scenario": (SCENARIO,)}, r"scenario=\(Scenario.*: expected the path of a file"),
    ],
)
def test_scenarios_that_environments_refuse(scenarios, monkeypatch, keywords, message):
    monkeypatch.chdir(scenarios)
    write_lorr(scenarios)
    (scenarios / "broken.json").write_text("{")
    walled = Grid([[True, False, True]], "walled")
    write_map(walled, scenarios / "walled.map")
    write_scenario(Scenario([[0, 0]], [[0, 2]]), Grid(np.ones((1, 3), bool), "walled"), scenarios / "walled.scen")
    with pytest.raises((ValueError, TypeError), match=f"^{message}") as caught:
        mapf_pz.parallel_env(**keywords)
    assert "\n" not in str(caught.value)


def test_a_pogema_goal_that_cannot_be_reached_is_named(tmp_path):
    file = write_pogema(tmp_path, [POGEMA_INSTANCES[0] | {"map_name": "apart"}])
    (tmp_path / "01-set.maps.json").write_text('{"apart": ["....#.", "....##", "......", "......", "......"]}')
    with pytest.raises(FormatError, match=r"01-set\.lmapf\.json: instance 0: agent 2: no path on map 'apart'"):
        mapf_pz.parallel_env(scenario=file)
