import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given

import mapf_pz
from mapf_pz.errors import FormatError
from mapf_pz.instances import InstanceList, LorrProblem, load_problem
from mapf_pz.instances.delays import Delays
from mapf_pz.instances.files.lorr import format_problem
from tests.helpers.corrupt_files import near_misses

MAP = "type octile\nheight 2\nwidth 3\nmap\n.ES\n.T@\n"
JSON = {"mapFile": "maps/a.map", "agentFile": "a.agents", "taskFile": "a.tasks", "teamSize": 2}
AGENTS = "3\n0\n2\n3\n"
TASKS_2023 = "5\n0\n1\n2\n3\n1\n"
TASKS_2024 = "# version for LoRR 2024\n3\n0,1\n2,3,0\n1,3\n"


def problem(folder, json_changes=None, agents=AGENTS, tasks=TASKS_2023, text=None):
    (folder / "maps").mkdir(exist_ok=True)
    data = JSON | {"taskAssignmentStrategy": "roundrobin"} | (json_changes or {})
    files = {"maps/a.map": MAP, "a.agents": agents, "a.tasks": tasks, "a.json": text or json.dumps(data)}
    for name, content in files.items():
        (folder / name).write_text(content)
    return folder / "a.json"


def message_of(path):
    with pytest.raises(FormatError) as caught:
        load_problem(path)
    message = str(caught.value)
    assert "\n" not in message
    return message.replace(f"{path.parent}/", "")


def cells(goals):
    return (goals @ np.array([3, 1])).tolist()


def test_a_problem_of_2023(tmp_path):
    loaded = load_problem(problem(tmp_path))
    assert isinstance(loaded, LorrProblem)
    assert loaded.grid.free.tolist() == [[True, True, True], [True, False, False]]
    assert (loaded.team_size, loaded.num_tasks, loaded.strategy, loaded.version) == (2, 5, "roundrobin", None)
    assert cells(loaded.starts) == [0, 2]
    assert [cells(loaded.task(k)) for k in (0, 3, 8)] == [[0], [3], [3]]


def test_tasks_repeat_in_file_order(tmp_path):
    instance = load_problem(problem(tmp_path)).instance()
    assert cells(instance.scenario.goals) == [[0, 2, 1, 1, 3], [1, 3, 0, 2, 1]]
    assert instance.headings.tolist() == [0, 0]
    assert InstanceList([instance]).num_agents == 2


@pytest.mark.parametrize("count", [1, 3, 12])
def test_as_many_goals_as_are_asked_for(tmp_path, count):
    goals = load_problem(problem(tmp_path)).instance(count).scenario.goals
    tasks = [0, 1, 2, 3, 1]
    assert cells(goals) == [[tasks[(agent + 2 * n) % 5] for n in range(count)] for agent in range(2)]


def test_a_problem_of_2024(tmp_path):
    path = problem(tmp_path, {"version": "2024 LoRR", "numTasksReveal": 1.5}, tasks=TASKS_2024)
    data = json.loads(path.read_text())
    del data["taskAssignmentStrategy"]
    path.write_text(json.dumps(data))
    loaded = load_problem(path)
    assert (loaded.version, loaded.strategy, loaded.num_tasks) == ("2024 LoRR", "entrant", 3)
    assert [cells(loaded.task(k)) for k in range(4)] == [[0, 1], [2, 3, 0], [1, 3], [0, 1]]
    # Robot 0 gets the tasks 0, 2, 1, and robot 1 the tasks 1, 0, 2.
    loaded = replace(loaded, not_modeled=())
    assert cells(loaded.instance().scenario.goals) == [[0, 1, 1, 3, 2, 3, 0], [2, 3, 0, 0, 1, 1, 3]]
    assert cells(loaded.instance(3).scenario.goals) == [[0, 1, 1], [2, 3, 0]]
    assert cells(loaded.instance(9).scenario.goals)[0] == [0, 1, 1, 3, 2, 3, 0, 0, 1]


def test_what_is_not_modeled_is_reported(tmp_path):
    neutral = {"numTasksReveal": 1, "agentSize": 1.0, "version": "2026 LoRR"}
    load_problem(problem(tmp_path, neutral)).instance()
    delays = {"pDelay": 0.01, "minDelay": 1, "maxDelay": 4, "durationModel": "gaussian", "gaussMeanRatio": 0.3}
    others = {"numTasksReveal": 1.5, "agentCounter": 3, "delayConfig": delays}
    loaded = load_problem(problem(tmp_path, neutral | others))
    told = "'numTasksReveal', 'agentCounter', 'delayConfig'; results are not comparable with the competition's"
    with pytest.warns(UserWarning, match=f"^a: not modeled: {told}$"):
        loaded.instance()


DELAYS = {
    "seed": 0,
    "pDelay": 0.003,
    "minDelay": 2,
    "maxDelay": 8,
    "eventModel": "poisson",
    "durationModel": "gaussian",
    "gaussMeanRatio": 0.5,
    "gaussStdRatio": 0.22,
}


def test_delays_are_those_of_the_instance(tmp_path):
    loaded = load_problem(problem(tmp_path, {"delayConfig": DELAYS}))
    expected = Delays(0.003, (2, 8), "poisson", "normal")
    assert (loaded.delays, loaded.not_modeled) == (expected, ())
    assert loaded.instance().delays == expected
    files = format_problem(loaded)
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    assert load_problem(tmp_path / "a.json").delays == expected


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"pDelay": 2}, "'delayConfig': probability=2: expected"),
        ({"pDelay": None}, "'delayConfig': probability=None: expected a number"),
        ({"minDelay": 9}, r"'delayConfig': duration=\(9, 8\): expected the smallest number of steps first"),
        ({"minDelay": 0}, r"'delayConfig': duration=\(0, 8\): expected"),
        ({"eventModel": "gamma"}, "'delayConfig': events='gamma': expected one of 'bernoulli', 'poisson'"),
        ({"durationModel": 1}, "'delayConfig': durations=1: expected one of 'uniform', 'normal'"),
    ],
)
def test_malformed_delays(tmp_path, changes, message):
    with pytest.raises(FormatError, match=f"a.json: {message}"):
        load_problem(problem(tmp_path, {"delayConfig": DELAYS | changes}))


def test_an_environment_has_the_delays_of_its_problem(tmp_path):
    path = problem(tmp_path, {"delayConfig": DELAYS | {"pDelay": 1}})
    env = mapf_pz.parallel_env(scenario=path, on_target="restart", max_steps=5)
    env.reset(seed=0)
    *_, infos = env.step(dict.fromkeys(env.agents, 0))
    assert [info["delayed"] for info in infos.values()] == [1, 1]
    env = mapf_pz.parallel_env(scenario=path, on_target="restart", max_steps=5, delays="0:1-1")
    env.reset(seed=0)
    *_, infos = env.step(dict.fromkeys(env.agents, 0))
    assert [info["delayed"] for info in infos.values()] == [0, 0]


@pytest.mark.parametrize("strategy", ["greedy", "roundrobin_fixed"])
def test_other_strategies_give_no_sequence_of_goals(tmp_path, strategy):
    loaded = load_problem(problem(tmp_path, {"taskAssignmentStrategy": strategy}))
    with pytest.raises(ValueError, match=f"strategy '{strategy}' gives robots no fixed sequence of goals"):
        loaded.instance()


@pytest.mark.parametrize("count", [0, -1, 10**9])
def test_huge_numbers_of_goals(tmp_path, count):
    with pytest.raises(ValueError, match=f"goals_per_agent: expected 1 to 8000000 for 2 robots, got {count}"):
        load_problem(problem(tmp_path)).instance(count)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"teamSize": 4}, "a.json: expected a 'teamSize' of at most 3, the agents in a.agents"),
        ({"teamSize": 0}, "a.json: expected 'teamSize' to be a whole number, 1 or more, got 0"),
        ({"teamSize": 2.0}, "a.json: expected 'teamSize' to be a whole number, 1 or more, got 2.0"),
        ({"teamSize": True}, "a.json: expected 'teamSize' to be a whole number, 1 or more, got True"),
        ({"teamSize": 10**30}, "a.json: expected 'teamSize' to be a whole number, 1 or more, got 1000000000000"),
        ({"mapFile": None}, "a.json: expected 'mapFile' to be text, got None"),
        ({"mapFile": "../a.map"}, "a.json: expected 'mapFile' to be a file in the folder of the JSON, got '../a.map'"),
        ({"taskFile": "/etc/passwd"}, "a.json: expected 'taskFile' to be a file in the folder of the JSON, got '/etc"),
        ({"agentFile": "a\0"}, "a.json: expected 'agentFile' to be a file in the folder of the JSON, got 'a\\x00'"),
        ({"taskAssignmentStrategy": "best"}, "a.json: expected 'taskAssignmentStrategy' roundrobin, roundrobin_fixed"),
        ({"taskAssignmentStrategy": []}, "a.json: expected 'taskAssignmentStrategy' roundrobin, roundrobin_fixed"),
        ({"version": 2024}, "a.json: expected 'version' to be text, got 2024"),
        ({"mapFile": "maps"}, "maps: expected a file, got a folder or device"),
    ],
)
def test_malformed_members(tmp_path, changes, message):
    assert message_of(problem(tmp_path, changes)).startswith(message)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "a.json:1:2: expected JSON: Expecting property name enclosed in double quotes"),
        ("[1]", "a.json:1: expected a JSON object, got [1]"),
        ('{"a":' * 40_000, "a.json: expected a problem of at most 100000 characters"),
        ("[" * 20_000, "a.json: expected JSON that is not nested deeply"),
        ('{"a": ' + "9" * 9000 + "}", "a.json: expected JSON, got a number with thousands of digits"),
    ],
)
def test_malformed_json(tmp_path, text, message):
    assert message_of(problem(tmp_path, text=text)) == message


@pytest.mark.parametrize(
    ("agents", "message"),
    [
        ("", "a.agents:1: expected the number of lines that follow, 1 or more, got ''"),
        ("0\n", "a.agents:1: expected the number of lines that follow, 1 or more, got '0'"),
        ("two\n", "a.agents:1: expected the number of lines that follow, 1 or more, got 'two'"),
        ("999999999\n0\n", "a.agents:2: expected 999999999 lines, got 1"),
        ("9" * 5000, "a.agents:1: expected the number of lines that follow, 1 or more, got '999999999999...9999999"),
        ("2\n0\n\n2\n", "a.agents:3: expected a cell's number, got ''"),
        ("2\n0\n2\n3\n", "a.agents:4: expected the end of the file after 2 lines"),
        ("2\n0\n-2\n", "a.agents:3: expected a cell's number, got '-2'"),
        ("2\n0\n2.0\n", "a.agents:3: expected a cell's number, got '2.0'"),
        ("2\n0\n1,2\n", "a.agents:3: expected a cell's number, got '1,2'"),
        ("2\n0\n6\n", "a.agents:3: expected a free cell of map 'a' (2 x 3), got 6, outside"),
        ("# a\n# b\n2\n4\n0\n", "a.agents:4: expected a free cell of map 'a' (2 x 3), got 4, an obstacle"),
        ("3\n0\n2\n0\n", "a.agents:4: expected different starts, got [row 0, col 0] again"),
    ],
)
def test_malformed_agents(tmp_path, agents, message):
    assert message_of(problem(tmp_path, agents=agents)).startswith(message)


@pytest.mark.parametrize(
    ("tasks", "message"),
    [
        ("2\n0,1\n2,3,5\n", "a.tasks:3: expected a free cell of map 'a' (2 x 3), got 5, an obstacle"),
        ("2\n0,1\n2,\n", "a.tasks:3: expected 1 to 100 cells' numbers between commas, got '2,'"),
        ("1\n" + ",".join(["0"] * 101), "a.tasks:2: expected 1 to 100 cells' numbers between commas, got '0,0,0,"),
    ],
)
def test_malformed_tasks(tmp_path, tasks, message):
    assert message_of(problem(tmp_path, tasks=tasks)).startswith(message)


def test_a_goal_that_cannot_be_reached(tmp_path):
    path = problem(tmp_path)
    (tmp_path / "maps" / "a.map").write_text(MAP.replace(".ES\n.T@", ".@S\n.TE"))
    (tmp_path / "a.tasks").write_text("1\n0\n")
    with pytest.raises(ValueError, match="agent 1: no path on map 'a' leads from its start"):
        load_problem(path).instance()


def test_a_link_that_leads_out_is_not_followed(tmp_path):
    inner = tmp_path / "inner"
    inner.mkdir()
    path = problem(inner)
    (tmp_path / "other.agents").write_text(AGENTS)
    (inner / "a.agents").unlink()
    (inner / "a.agents").symlink_to(tmp_path / "other.agents")
    assert message_of(path).startswith("a.json: expected 'agentFile' to be a file in the folder of the JSON")


def test_missing_files(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"b\.json: no such file"):
        load_problem(tmp_path / "b.json")
    with pytest.raises(FileNotFoundError, match=r"b\.map: no such file"):
        load_problem(problem(tmp_path, {"mapFile": "b.map"}))


@given(near_misses(json.dumps(JSON)), near_misses(AGENTS), near_misses(TASKS_2024))
def test_any_text_is_a_problem_or_a_format_error(tmp_path_factory, text, agents, tasks):
    folder = tmp_path_factory.getbasetemp() / "fuzz-problem"
    folder.mkdir(exist_ok=True)
    good = json.dumps(JSON)
    for changes in ({"text": text}, {"text": good, "agents": agents}, {"text": good, "tasks": tasks}):
        try:
            load_problem(problem(folder, **changes)).instance()
        except (FormatError, FileNotFoundError) as error:
            assert "\n" not in str(error)  # noqa: PT017 (most texts, not all, are refused)


def test_all_published_problems_load(benchmark):
    files = sorted((benchmark / "lorr").glob("*/*.domain/*.json"))
    assert len(files) == 39
    large = {"EI23-warehouse_large", "orz-example", "iron-example"}
    for file in files:
        if file.stem.rsplit("_", 1)[0] not in large:
            loaded = load_problem(file)
            assert loaded.team_size == json.loads(file.read_text())["teamSize"]
            assert replace(loaded, not_modeled=()).instance(2).num_agents == loaded.team_size
            expected = {"2024": ("numTasksReveal",), "2026": ("numTasksReveal", "agentCounter")}
            assert (loaded.delays is not None) == (loaded.version == "2026 LoRR")
            assert loaded.not_modeled == expected.get((loaded.version or "2023")[:4], ())


def test_a_large_problem(benchmark):
    folder = benchmark / "lorr" / "archive-2023-example" / "warehouse.domain"
    loaded = load_problem(folder / "EI23-warehouse_large_8000.json")
    assert (loaded.team_size, loaded.num_tasks) == (8000, 500_000)
    assert loaded.instance().scenario.goals.shape == (8000, 125, 2)


def test_a_team_smaller_than_the_agents_file(benchmark):
    loaded = load_problem(benchmark / "lorr" / "start-kit-2026" / "room.domain" / "room-example_150.json")
    assert loaded.team_size == 150
    assert loaded.version == "2026 LoRR"
