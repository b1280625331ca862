import json
import re

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import mapf_pz
from mapf_pz.errors import FormatError
from mapf_pz.evaluation import load_suite, suite_names
from mapf_pz.evaluation.episodes import run_episodes
from mapf_pz.evaluation.policies import factory_for
from mapf_pz.evaluation.suite import suite_label
from mapf_pz.evaluation.tracker import KnownCost
from mapf_pz.instances import write_map, write_scenario
from mapf_pz.instances.benchmarks.pogema import instance_names
from mapf_pz.instances.heading import Heading
from mapf_pz.instances.instance import Grid, Scenario
from tests.evaluation.test_episodes import Right

RANDOM = ["central-16", "central-4", "central-8", "delays-lifelong", "quickstart", "standard"]
NOT_BUNDLED = "lorr-2023"

GRID = Grid([[True] * 6, [True] * 3 + [False] * 3], "tiny")
SCENARIO = Scenario([[0, 0], [1, 0]], [[0, 5], [1, 2]])
SOURCES = {
    "map": {"map": "tiny.map"},
    "scenarios": {"map": "tiny.map", "scenarios": ["tiny.scen"]},
    "random": {"random": [5, 7, 0.1]},
    "pogema": {"pogema": "set.mapf.json"},
}


@pytest.fixture(autouse=True)
def no_benchmark(monkeypatch):
    monkeypatch.delenv("MAPF_PZ_BENCHMARK", raising=False)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Files that a suite may name."""
    folder = tmp_path_factory.mktemp("suite")
    write_map(GRID, folder / "tiny.map")
    write_scenario(SCENARIO, GRID, folder / "tiny.scen")
    (folder / "set.maps.json").write_text('{"m": ["...", "..."]}')
    instance = {"map_name": "m", "seed": 0, "num_agents": 2, "agents_xy": [[0, 0], [1, 0]]}
    (folder / "set.mapf.json").write_text(json.dumps([instance | {"targets_xy": [[0, 2], [1, 2]]}]))
    (folder / "problem.json").write_text(
        '{"mapFile": "tiny.map", "agentFile": "a.agents", "taskFile": "a.tasks", "teamSize": 2,'
        ' "taskAssignmentStrategy": "roundrobin"}'
    )
    (folder / "a.agents").write_text("2\n0\n6\n")
    (folder / "a.tasks").write_text("3\n5\n8\n1\n")
    return folder


def loaded(folder, *entries, **others):
    file = folder / "mine.json"
    file.write_text(json.dumps({"tasks": list(entries)} | others))
    return load_suite(file)


def message_of(folder, *entries):
    """Return the one-line error message, without the file's name."""
    with pytest.raises(FormatError) as caught:
        loaded(folder, *entries)
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith(f"{folder / 'mine.json'}: ")
    return message.partition("mine.json: ")[2]


# Suites that come with the package.


@pytest.mark.parametrize("name", suite_names())
def test_suites_that_come_with_the_package(name, monkeypatch, request):
    if name == NOT_BUNDLED:
        monkeypatch.setenv("MAPF_PZ_BENCHMARK", str(request.getfixturevalue("benchmark")))
    tasks = load_suite(name)
    assert {task.suite for task in tasks} == {suite_label(name)}
    assert tasks[0].suite.startswith(f"{name}/")
    assert len({task.label for task in tasks}) == len(tasks)
    for task in tasks:
        assert task.episodes > 0
        assert all(instance.num_agents == task.num_agents for instance in task.instances)
    assert (name in RANDOM) == (not any(task.instances for task in tasks))


@pytest.mark.parametrize("name", instance_names())
def test_agents_that_turn_have_the_instances_of_cardinal_agents_and_face_east(name):
    cardinal, turning = load_suite(name), load_suite(f"{name}-turning")
    assert [task.num_agents for task in turning] == [task.num_agents for task in cardinal]
    assert all(a.instances == b.instances for a, b in zip(cardinal, turning, strict=True))
    factor = 1 if name.endswith("-lifelong") else 2
    assert [task.keywords["max_steps"] for task in turning] == [
        factor * task.keywords["max_steps"] for task in cardinal
    ]
    env = mapf_pz.parallel_env(**turning[0].env_keywords(0))
    env.reset(seed=turning[0].seed)
    assert env.config.action_model == "rotate"
    assert (env.headings == Heading.EAST).all()


def test_every_preset_of_training_is_evaluated_on_a_suite_that_needs_nothing():
    pytest.importorskip("torchrl")
    from mapf_pz.commands.train import SUITES
    from mapf_pz.rl.presets import PRESETS

    assert {SUITES.get(preset, "standard") for preset in PRESETS} <= set(suite_names()) - {NOT_BUNDLED}


def test_the_suite_of_a_preset_has_the_number_of_agents_that_its_policy_acts_for():
    pytest.importorskip("torchrl")
    from mapf_pz.commands.train import SUITES
    from mapf_pz.rl.algorithms.named import algorithm_of
    from mapf_pz.rl.presets import PRESETS

    for preset, config in PRESETS.items():
        fixed = algorithm_of(config.algorithm).fixed_num_agents(config)
        counts = {task.num_agents for task in load_suite(SUITES.get(preset, "standard"))}
        assert fixed is None or counts == {fixed}, preset


def test_missing_files_are_named():
    with pytest.raises((FormatError, FileNotFoundError)) as caught:
        load_suite(NOT_BUNDLED)
    assert str(caught.value).count("\n") == 0
    assert f"{NOT_BUNDLED}.json: task 0: no " in str(caught.value)
    assert "MAPF_PZ_BENCHMARK" in str(caught.value)


def test_unknown_suites(tmp_path):
    with pytest.raises(
        ValueError, match=r"'standrad': did you mean 'standard'\? expected a \.json file, or one of cent"
    ):
        load_suite("standrad")
    with pytest.raises(FileNotFoundError, match=r"mine\.json: no such file"):
        load_suite(tmp_path / "mine.json")


# Versions and digests.


def test_a_version_comes_with_the_digest_of_instances_and_rules(folder):
    entry = {"random": [5, 5, 0.1], "num_agents": 2}
    assert {task.suite for task in loaded(folder, entry)} == {""}
    (one,), (same,), (renumbered,) = (loaded(folder, entry, version=version) for version in (1, 1, 2))
    assert one.suite == same.suite
    name, _, digest = one.suite.partition(" ")
    assert (name, renumbered.suite) == ("mine/1", f"mine/2 {digest}")
    changes = [{"max_steps": 9}, {"seed": 4}, {"episodes": 3}, {"name": "other"}, {"random": [5, 5, 0.2]}]
    changes += [{"env": {"action_model": "cardinal"}}, {"num_agents": 3}, {"best": 0.5}]
    others = [loaded(folder, entry | change, version=1)[0].suite for change in changes]
    assert len({one.suite, *others}) == 1 + len(changes)
    assert loaded(folder, entry, version=1, digest=digest)[0].suite == one.suite


def test_the_costs_that_a_user_knows_are_no_part_of_the_digest(folder, monkeypatch):
    entry = SOURCES["scenarios"] | {"num_agents": 2}
    (without,) = loaded(folder, entry, version=1)
    monkeypatch.setattr("mapf_pz.evaluation.suite.known_cost", lambda *_: KnownCost(1, 5))
    (known,) = loaded(folder, entry, version=1)
    assert known.best_costs == (5,)
    assert known.suite == without.suite


@pytest.mark.parametrize(
    ("members", "message"),
    [
        ({"version": 0}, "expected 'version' to be a whole number, 1 or more, got 0"),
        ({"version": "1"}, "expected 'version' to be a whole number, 1 or more, got '1'"),
        ({"digest": "0"}, "expected 'digest' only together with 'version'"),
        ({"version": 3, "digest": "ab"}, r"expected the digest 'ab' of version 3, got '\w{16}': a changed suite needs"),
    ],
)
def test_wrong_versions(folder, members, message):
    with pytest.raises(FormatError, match=rf"mine\.json: {message}"):
        loaded(folder, {"random": [5, 5, 0.1], "num_agents": 2}, **members)


# A user's own.


def test_a_map_beside_the_suite(folder):
    (task,) = loaded(folder, {"map": "tiny.map", "num_agents": 3, "max_steps": 20, "seed": 7})
    assert (task.label, task.episodes, task.seed) == ("3 agents on tiny", 64, 7)
    assert task.keywords["map"].free.tolist() == GRID.free.tolist()
    assert task.keywords["max_steps"] == 20
    (episode,) = run_episodes(factory_for(Right()), task, [0])
    assert episode["ep_length"] <= 20


def test_a_bundled_map_by_name(folder):
    (task,) = loaded(folder, {"map": "empty-8-8", "num_agents": 1, "episodes": 5, "name": "nothing in the way"})
    assert (task.label, task.episodes, task.instances) == ("1 agents on nothing in the way", 5, ())


def test_scenarios_are_instances_of_their_first_agents(folder, monkeypatch):
    one, two = loaded(folder, SOURCES["scenarios"] | {"num_agents": [1, 2]})
    assert [task.instances[0].num_agents for task in (one, two)] == [1, 2]
    assert (one.episodes, one.instances[0].scenario.goals.tolist()) == (1, [[0, 5]])
    assert [next(run_episodes(factory_for(Right()), task, [0]))["SoC"] for task in (one, two)] == [5, 5 + 2]
    for kind in ("maps", "scens"):
        (folder / kind).mkdir()
    write_map(GRID, folder / "maps" / "named.map")
    write_scenario(SCENARIO, GRID, folder / "scens" / "named-random-1.scen")
    monkeypatch.setenv("MAPF_PZ_BENCHMARK", str(folder))
    (named,) = loaded(folder, {"map": "named", "scenarios": ["random-1"], "num_agents": 2})
    assert named.instances[0].scenario.starts.tolist() == [[0, 0], [1, 0]]
    assert "expected 3 agents, got 2" in message_of(
        folder, {"map": "named", "scenarios": ["random-1"], "num_agents": 3}
    )


def test_random_maps(folder):
    small, large = loaded(folder, {"random": [5, 7, 0.2], "num_agents": [2, 4], "env": {"action_model": "cardinal"}})
    assert [task.label for task in (small, large)] == [
        "2 agents on random 5 x 7, 20 % obstacles",
        "4 agents on random 5 x 7, 20 % obstacles",
    ]
    assert (large.keywords["source"].shape, large.keywords["source"].num_agents) == ((5, 7), 4)
    assert large.keywords["action_model"] == "cardinal"


def test_instances_of_pogema(folder):
    (task,) = loaded(folder, SOURCES["pogema"] | {"num_agents": 2})
    assert (task.label, len(task.instances), task.episodes) == ("2 agents on set.mapf", 1, 1)
    assert next(run_episodes(factory_for(Right()), task, [0]))["SoC"] == 4


def test_a_problem_of_the_league_of_robot_runners(folder):
    (task,) = loaded(folder, {"lorr": "problem.json", "max_steps": 6, "best": 0.5})
    assert (task.label, task.episodes, task.best) == ("2 agents on problem", 1, 0.5)
    assert task.keywords == {"max_steps": 6, "on_target": "restart"}
    assert task.instances[0].headings.tolist() == [0, 0]
    (cardinal,) = loaded(folder, {"lorr": "problem.json", "env": {"action_model": "cardinal"}})
    assert cardinal.instances[0].headings is None


# Errors are one line.

GOOD = {"random": [5, 5, 0.1], "num_agents": 2}


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        (5, "task 0: expected an object, got 5"),
        (GOOD | {"num_agent": 3}, "task 0: unknown keyword 'num_agent': did you mean 'num_agents'"),
        ({"num_agents": 3}, "task 0: expected exactly one of map, random, pogema, lorr, got none"),
        (GOOD | {"map": "empty-8-8"}, "task 0: expected exactly one of .*, got map and random"),
        ({"map": 5, "num_agents": 1}, "task 0: map=5: expected text"),
        ({"map": "nowhere", "num_agents": 1}, "task 0: no .map file is named 'nowhere'"),
        ({"random": [5, 5], "num_agents": 1}, r"task 0: random=\[5, 5\]: expected \[rows, columns, obstacle d"),
        ({"random": [5.5, 5, 0.1], "num_agents": 1}, "task 0: random=.*: expected .rows, columns, obstacle d"),
        ({"random": [5, 5, 1], "num_agents": 1}, "task 0: random=.*: expected .rows, columns, obstacle d"),
        ({"random": [50000, 50000, 0.1], "num_agents": 1}, "task 0: random=.*: expected .rows, columns, obstacle d"),
        ({"random": [5, 5, 0.1]}, "task 0: expected 'num_agents'"),
        (GOOD | {"num_agents": 0}, "task 0: num_agents=.*: expected a whole number, 1 or more, or a list"),
        (GOOD | {"num_agents": []}, "task 0: num_agents=.*: expected a whole number, 1 or more, or a list"),
        (GOOD | {"num_agents": [2, True]}, "task 0: num_agents=.*: expected a whole number, 1 or more, or a list"),
        (GOOD | {"num_agents": 26}, "task 0: 26 agents fit on none of"),
        (GOOD | {"num_agents": [2, 2]}, "expected unique task names .* got '2 agents on random .*' twice"),
        ({"lorr": "problem.json", "num_agents": 2}, "task 0: expected 'num_agents', except with 'lorr'"),
        (GOOD | {"max_steps": 0}, "task 0: max_steps=0: expected a whole number, 1 or more"),
        (GOOD | {"episodes": 2.5}, "task 0: episodes=2.5: expected a whole number"),
        (GOOD | {"seed": -1}, "task 0: seed=-1: expected a whole number, 0 or more"),
        (GOOD | {"best": "3"}, "task 0: best='3': expected a number greater than 0"),
        (GOOD | {"best": 0}, "task 0: best=0: expected a number greater than 0"),
        (GOOD | {"name": "two\nlines"}, "task 0: name=.*: expected a single line of text"),
        (GOOD | {"name": ""}, "task 0: name=.*: expected a single line of text"),
        (GOOD | {"scenarios": ["random-1"]}, "task 0: expected 'scenarios' only together with 'map'"),
        (SOURCES["map"] | {"scenarios": [], "num_agents": 1}, r"task 0: scenarios=\[\]: expected 1 or more items"),
        (SOURCES["map"] | {"scenarios": [1], "num_agents": 1}, r"task 0: scenarios\[0\]=1: expected text"),
        (
            SOURCES["map"] | {"scenarios": "tiny.scen", "num_agents": 1},
            "task 0: scenarios='tiny.scen': expected a tuple",
        ),
        (GOOD | {"env": []}, r"task 0: env=\[\]: expected a valid dictionary"),
        (GOOD | {"env": {"max_step": 3}}, "task 0: env: expected one of action_model, .*, got 'max_step'"),
        (GOOD | {"env": {"map": "empty-8-8"}}, "task 0: env: expected one of action_model, .*, got 'map'"),
        (GOOD | {"env": {"action_model": "fly"}}, "task 0: action_model='fly': expected one of"),
    ],
    ids=str,
)
def test_wrong_entries(folder, entry, message):
    assert re.match(message, message_of(folder, entry))


def test_the_largest_random_maps(folder, monkeypatch):
    monkeypatch.setattr("mapf_pz.evaluation.suite.MAX_CELLS", 30)
    assert message_of(folder, {"random": [5, 7, 0.1], "num_agents": 1}).startswith(
        "task 0: random=[5, 7, 0.1]: expected ["
    )
    assert len(loaded(folder, {"random": [5, 6, 0.1], "num_agents": 1})) == 1


def test_the_error_has_the_number_of_the_task(folder):
    assert message_of(folder, GOOD, GOOD | {"seed": "x"}).startswith("task 1: ")
    same_name = "expected unique task names ('name'), got '2 agents on random 5 x 5, 10 % obstacles' twice"
    assert message_of(folder, GOOD, GOOD) == same_name
    assert message_of(folder, GOOD | {"name": "first"}, GOOD, GOOD) == same_name
    assert len(loaded(folder, GOOD, GOOD | {"name": "others"})) == 2


def test_wrong_files(folder):
    for text, message in [
        ("{", "expected JSON"),
        ("[]", "expected a JSON object"),
        ("{}", "expected 'tasks' to be a list"),
        ('{"tasks": []}', "expected 1 items in 'tasks', got 0"),
        ('{"task": []}', "expected one of description, version, digest, tasks, got 'task'"),
    ]:
        (folder / "mine.json").write_text(text)
        with pytest.raises(FormatError, match=message):
            load_suite(folder / "mine.json")


def test_absent_and_malformed_files_of_an_entry(folder):
    with pytest.raises(FileNotFoundError, match=r"mine\.json: task 0: no file 'other\.mapf\.json' in the folders"):
        loaded(folder, {"pogema": "other.mapf.json", "num_agents": 1})
    (folder / "bad.map").write_text("type octile\nheight x\n")
    with pytest.raises(FormatError, match=r"bad\.map:2"):
        loaded(folder, {"map": "bad.map", "num_agents": 1})


JUNK = st.recursive(
    st.none() | st.booleans() | st.integers(-2, 40) | st.floats() | st.sampled_from([2**64, 10**400, "x", "tiny.map"]),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["map", "env", "x"]), inner, max_size=2)
    ),
    max_leaves=4,
)
KEYS = ["map", "scenarios", "random", "pogema", "lorr", "num_agents", "max_steps", "episodes", "seed", "task", "best"]
ENV = ["action_model", "on_target", "view_size", "channels", "edge_weights", "reward", "initial_heading", "features"]


@settings(max_examples=300, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_mutated_suites_are_refused_or_read(folder, data):
    entry = {"num_agents": 2} | data.draw(st.sampled_from(list(SOURCES.values())))
    entry |= data.draw(st.dictionaries(st.sampled_from(KEYS), JUNK, max_size=2))
    entry["env"] = data.draw(st.dictionaries(st.sampled_from(ENV), JUNK, max_size=2) | JUNK)
    text = json.dumps({"tasks": [entry]})
    cut = data.draw(st.just(len(text)) | st.integers(0, len(text)))
    (folder / "mutated.json").write_text(text[:cut] + data.draw(st.sampled_from(["", "]", "\0", "}"])))
    try:
        assert load_suite(folder / "mutated.json")
    except (ValueError, FileNotFoundError) as error:
        message = str(error)
    else:
        message = ""
    assert "\n" not in message
