import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapf_pz.errors import FormatError
from mapf_pz.evaluation.reports.bounds import most_goals
from mapf_pz.instances import InstanceList, load_pogema
from mapf_pz.instances.files import pogema
from tests.helpers.corrupt_files import near_misses

MAPS = {"a": [".@#", "$!."], "b": ["...."]}
ONE_SHOT = [
    {"map_name": "a", "seed": 0, "agents_xy": [[0, 0], [1, 2], [0, 1]], "targets_xy": [[1, 2], [0, 0], [1, 0]]},
    {"map_name": "b", "seed": 0, "agents_xy": [[0, 3], [0, 0], [0, 1]], "targets_xy": [[0, 0], [0, 1], [0, 2]]},
]
LIFELONG = [
    {
        "map_name": "b",
        "seed": 0,
        "agents_xy": [[0, 3], [0, 0]],
        "targets_xy": [[[0, 0], [0, 1]], [[0, 3], [0, 2], [0, 1]]],
    }
]


def files(folder, entries, maps=MAPS, name="a-set.mapf.json"):
    for file, content in (("a-set.maps.json", maps), (name, entries)):
        (folder / file).write_text(content if isinstance(content, str) else json.dumps(content), "utf-8")
    return folder / name


def message_of(path, num_agents=2):
    with pytest.raises(FormatError) as caught:
        load_pogema(path, num_agents)
    message = str(caught.value)
    assert "\n" not in message
    return message.replace(f"{path.parent}/", "")


def changed(**members):
    return [ONE_SHOT[0] | members]


def test_one_shot_instances(tmp_path):
    first, second = load_pogema(files(tmp_path, ONE_SHOT), 3)
    assert first.grid.name == "a"
    assert first.grid.free.tolist() == [[True, True, False], [True, True, True]]
    assert first.scenario.starts.tolist() == [[0, 0], [1, 2], [0, 1]]
    assert first.scenario.goals.tolist() == [[1, 2], [0, 0], [1, 0]]
    assert second.grid.shape == (1, 4)
    assert first.headings is None


def test_the_first_agents_are_taken(tmp_path):
    for instance, entry in zip(load_pogema(files(tmp_path, ONE_SHOT), 2), ONE_SHOT, strict=True):
        assert instance.scenario.starts.tolist() == entry["agents_xy"][:2]
        assert instance.scenario.goals.tolist() == entry["targets_xy"][:2]


def test_lifelong_sequences_of_different_length(tmp_path):
    path = files(tmp_path, LIFELONG, name="a-set.lmapf.json")
    (instance,) = load_pogema(path, 2)
    assert instance.scenario.goals.tolist() == [[[0, 0], [0, 1], [0, 0]], [[0, 3], [0, 2], [0, 1]]]
    assert instance.scenario.goal_counts.tolist() == [2, 3]
    (alone,) = load_pogema(path, 1)
    assert alone.scenario.goals.tolist() == [[[0, 0], [0, 1]]]


def test_instances_of_one_map_share_it(tmp_path):
    first, second = load_pogema(files(tmp_path, [ONE_SHOT[0], ONE_SHOT[0]]), 2)
    assert first.grid is second.grid


@pytest.mark.parametrize("num_agents", [0, -1])
def test_huge_numbers_of_agents(tmp_path, num_agents):
    with pytest.raises(ValueError, match=f"num_agents={num_agents}: expected a whole number, 1 or more"):
        load_pogema(files(tmp_path, ONE_SHOT), num_agents)


WHERE = "a-set.mapf.json: instance 0: "
TARGETS = WHERE + "expected 'targets_xy' to be [row, col] of each agent, or lists of them"


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ("[", "a-set.mapf.json:1:2: expected JSON: Expecting value"),
        ({"map_name": "a"}, "a-set.mapf.json:1: expected a list of instances, got {'map_name': 'a'}"),
        ([], "a-set.mapf.json:1: expected a list of instances, got []"),
        ([ONE_SHOT[0], 7], "a-set.mapf.json: instance 1: expected an object, got 7"),
        (changed(map_name=None), WHERE + "expected 'map_name' to be text, got None"),
        (changed(map_name="c\n"), WHERE + "expected the name of a map, got 'c\\n'"),
        (changed(agents_xy={}), WHERE + "expected 'agents_xy' to be a list, got {}"),
        (changed(agents_xy=[[0, 0]]), WHERE + "expected 2 items in 'agents_xy', got 1"),
        (changed(agents_xy=[[0, 0], [1]]), WHERE + "expected 'agents_xy' to be [row, col] of each agent"),
        (changed(agents_xy=[[0, 0], [0, -1]]), WHERE + "expected 'agents_xy' to be [row, col] of each agent"),
        (changed(agents_xy=[[0, 0], [0, 1.0]]), WHERE + "expected 'agents_xy' to be [row, col] of each agent"),
        (changed(agents_xy=[[0, 0], [0, 2**40]]), WHERE + "expected 'agents_xy' to be [row, col] of each agent"),
        (changed(targets_xy=[[0, 0], [True, 1]]), TARGETS),
        (changed(targets_xy=[[0, 0], [[0, 1]]]), TARGETS),
        (changed(targets_xy=[[[0, 0]], []]), TARGETS),
        (
            changed(agents_xy=[[0, 0], [0, 2]]),
            WHERE + "agent 1: start [row 0, col 2] is an obstacle of map 'a' (2 x 3)",
        ),
        (changed(targets_xy=[[0, 0], [2, 0]]), WHERE + "agent 1: goal [row 2, col 0] is outside of map 'a' (2 x 3)"),
        (changed(agents_xy=[[0, 0], [0, 0]]), WHERE + "agent 1: start [row 0, col 0] is also another agent's start"),
    ],
)
def test_malformed_instances(tmp_path, entries, message):
    assert message_of(files(tmp_path, entries)) == message


@pytest.mark.parametrize(
    ("maps", "message"),
    [
        ([], "a-set.maps.json:1: expected a JSON object, got []"),
        ({"a": "..."}, "a-set.maps.json: map 'a': expected rows of text, got '...'"),
        ({"a": []}, "a-set.maps.json: map 'a': expected rows of text, got []"),
        ({"a": [""]}, "a-set.maps.json: map 'a': expected rows of text, got ['']"),
        ({"a": ["...", 3]}, "a-set.maps.json: map 'a': expected rows of text, got ['...', 3]"),
        ({"a\nb": ["..", "..."]}, "a-set.maps.json: map 'a\\nb':1:3: expected a row of 3 cells, got 2"),
        ({"a": ["...", ".é."]}, "a-set.maps.json: map 'a':2:2: expected one of .@$!#, got 'é'"),
    ],
)
def test_malformed_maps(tmp_path, maps, message):
    assert message_of(files(tmp_path, ONE_SHOT, maps)) == message


def test_missing_files(tmp_path):
    path = files(tmp_path, ONE_SHOT)
    with pytest.raises(FileNotFoundError, match=r"a-set\.lmapf\.json: no such file"):
        load_pogema(tmp_path / "a-set.lmapf.json", 2)
    (tmp_path / "a-set.maps.json").unlink()
    with pytest.raises(FileNotFoundError, match=r"a-set\.maps\.json: no such file"):
        load_pogema(path, 2)


def test_a_goal_sequence_that_others_would_repeat_too_often(tmp_path, monkeypatch):
    """Two instances of 2 agents and 3 goals are 12 goals, though the file holds 10."""
    path = files(tmp_path, LIFELONG * 2)
    monkeypatch.setattr(pogema, "MAX_GOALS", 12)
    assert len(load_pogema(path, 2)) == 2
    monkeypatch.setattr(pogema, "MAX_GOALS", 11)
    assert message_of(path) == WHERE + "expected at most 5 goals, got 2 x 3"


@given(near_misses(json.dumps(MAPS)), near_misses(json.dumps(ONE_SHOT)), near_misses(json.dumps(LIFELONG)))
def test_any_text_is_instances_or_a_format_error(tmp_path_factory, maps, one_shot, lifelong):
    folder = tmp_path_factory.getbasetemp() / "fuzz-pogema"
    folder.mkdir(exist_ok=True)
    for entries, drawn in ((ONE_SHOT, maps), (one_shot, MAPS), (lifelong, MAPS)):
        try:
            load_pogema(files(folder, entries, drawn), 2)
        except FormatError as error:
            assert "\n" not in str(error)  # noqa: PT017 (most texts, not all, are refused)


values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(".#@a", max_size=3),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["a", "map_name"]), inner, max_size=2),
    max_leaves=6,
)


@given(st.sampled_from(["map_name", "agents_xy", "targets_xy"]), values, values)
def test_any_value_is_instances_or_a_format_error(tmp_path_factory, member, value, rows):
    folder = tmp_path_factory.getbasetemp() / "fuzz-pogema-values"
    folder.mkdir(exist_ok=True)
    for entries, maps in (
        (changed(**{member: value}), MAPS),
        (ONE_SHOT, MAPS | {"a": rows}),
        (value, MAPS),
        ([], value),
    ):
        try:
            load_pogema(files(folder, json.dumps(entries), json.dumps(maps)), 2)
        except FormatError as error:
            assert "\n" not in str(error)  # noqa: PT017 (most values, not all, are refused)


@pytest.mark.parametrize(
    ("name", "instances", "num_maps", "most_agents"),
    [("01-random", 128, 128, 64), ("03-warehouse", 128, 1, 192), ("05-puzzles", 160, 16, 4)],
)
def test_published_instances(pogema_benchmark, name, instances, num_maps, most_agents):
    for num_agents in (1, most_agents):
        one_shot = load_pogema(pogema_benchmark / f"{name}.mapf.json", num_agents)
        lifelong = load_pogema(pogema_benchmark / f"{name}.lmapf.json", num_agents)
        assert len(one_shot) == len(lifelong) == instances
        assert len({id(instance.grid) for instance in one_shot}) == num_maps
        assert all(instance.scenario.goals.shape == (num_agents, 2) for instance in one_shot)
        assert all(instance.scenario.goals.shape[::2] == (num_agents, 2) for instance in lifelong)
        assert InstanceList(one_shot[:1]).num_agents == num_agents
    with pytest.raises(FormatError, match=rf"instance 0: expected {most_agents + 1} items in 'agents_xy'"):
        load_pogema(pogema_benchmark / f"{name}.mapf.json", most_agents + 1)


def test_published_goal_sequences_are_long_enough(pogema_benchmark):
    """Not even alone on the map, in the 256 steps of an episode."""
    for file in sorted(pogema_benchmark.glob("*.lmapf.json")):
        for instance in load_pogema(file):
            assert (most_goals(instance, 256) < instance.scenario.goal_counts).all(), file.name
