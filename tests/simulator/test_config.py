"""`EnvConfig`: changed copies, equality by value, and the names that it knows."""

import dataclasses
import pickle
import sys
from collections import UserList
from functools import partial
from types import ModuleType

import numpy as np
import pytest

import mapf_pz
from mapf_pz import EnvConfig, Grid, GuidanceGraph, Instance, Scenario
from mapf_pz.instances import FixedMap, FixedScenario, InstanceList, RandomMaps, RandomObstacles, generate

FREE = np.ones((3, 4), np.bool_)
WALL = np.array([[True, False, True, True]] * 3)


def test_defaults_follow_the_action_model_of_a_changed_copy():
    rotate = EnvConfig()
    cardinal = dataclasses.replace(rotate, action_model="cardinal")
    assert (rotate.resolved_view, rotate.resolved_frame) == ("front", "egocentric")
    assert (cardinal.resolved_view, cardinal.resolved_frame) == ("centered", "map")
    assert dataclasses.replace(cardinal, action_model="rotate") == rotate
    env = mapf_pz.MapfEnv(dataclasses.replace(rotate, action_model="cardinal"))
    assert env.action_space("agent_0").n == 5


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"channels": ("nonsense",)}, "channels: unknown 'nonsense', expected one of view, "),
        (
            {"features": ("last_action",)},
            "features: unknown 'last_action', did you mean 'last_actions'?",
        ),
        ({"channels": ()}, "channels: expected at least one of view, "),
        ({"initial_heading": [0, 9]}, r"initial_heading=\[0, 9\]: expected 'random', 'east', or N numbers 0 to 3"),
    ],
)
def test_a_configuration_is_checked_when_it_is_made(fields, message):
    with pytest.raises(ValueError, match=message):
        EnvConfig(**fields)


def make_instance(free=FREE, start=(0, 0), headings=None):
    return Instance(Grid(free), Scenario([start], [[0, 3]]), headings)


DIFFERENT = [
    {},
    {"max_steps": 7},
    {"map": "empty-8-8"},
    {"map": FREE},
    {"map": WALL},
    {"map": Grid(FREE, "hall")},
    {"map": FREE, "scenario": Scenario([[0, 0]], [[0, 3]])},
    {"map": FREE, "scenario": Scenario([[0, 0]], [[0, 2]])},
    {"map": FREE, "scenario": Scenario([[0, 0]], [[[0, 2], [0, 1]]], [1])},
    {"initial_heading": [0, 1]},
    {"initial_heading": [1, 0]},
    {"edge_weights": GuidanceGraph.uniform(FREE)},
    {"edge_weights": GuidanceGraph.crisscross(FREE)},
    {"source": RandomObstacles(6, 6, 0.1, 2)},
    {"source": RandomObstacles(6, 6, 0.2, 2)},
    {"source": FixedMap(Grid(FREE), 2)},
    {"source": FixedMap(Grid(WALL), 2)},
    {"source": FixedScenario(Grid(FREE), Scenario([[0, 0]], [[0, 3]]), 1)},
    {"source": InstanceList([make_instance()])},
    {"source": InstanceList([make_instance(start=(1, 0))])},
    {"source": InstanceList([make_instance(headings=[2])])},
    {"source": RandomMaps(partial(generate.random, 6, 6, 0.1), 2)},
    {"source": RandomMaps(partial(generate.random, 6, 6, 0.2), 2)},
]


def copied(value):
    """Return an equal value that shares no array."""
    if isinstance(value, np.ndarray):
        return value.copy()
    if isinstance(value, partial):
        return partial(value.func, *value.args, **value.keywords)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        made = {field.name: copied(getattr(value, field.name)) for field in dataclasses.fields(value) if field.init}
        return type(value)(**made)
    return tuple(map(copied, value)) if isinstance(value, tuple) else value


@pytest.mark.parametrize("first", range(len(DIFFERENT)))
def test_configurations_are_equal_by_value(first):
    config = EnvConfig(**DIFFERENT[first])
    for second, fields in enumerate(DIFFERENT):
        other = EnvConfig(**{name: copied(value) for name, value in fields.items()})
        assert (config == other) == (first == second)
        assert (hash(config) == hash(other)) == (first == second)


def test_configurations_are_made_of_their_keywords():
    config = EnvConfig(map=FREE, num_agents=2, view_size=(3, 3), features=["time"])
    assert EnvConfig(**config.keywords()) == config


class Unpicklable(FixedMap):
    """A source and a reward."""

    def __init__(self):
        super().__init__(Grid(FREE), 2)

    def __call__(self, transition):
        return np.zeros(transition.actions.shape)

    def __reduce__(self):
        raise TypeError("not to be pickled")


@pytest.fixture
def plugin(monkeypatch):
    module = ModuleType("plugin")
    module.it = Unpicklable()
    monkeypatch.setitem(sys.modules, "plugin", module)
    return module


def test_what_is_named_is_imported_once(plugin):
    config = EnvConfig(source="plugin:it", reward="plugin:it")
    first, plugin.it = plugin.it, Unpicklable()
    assert config.resolved_source is config.reward_function is first
    again = dataclasses.replace(config)
    assert again.resolved_source is again.reward_function is plugin.it


def test_what_is_imported_is_no_part_of_a_configuration(plugin):
    config = EnvConfig(source="plugin:it", reward="plugin:it")
    assert config.resolved_source is plugin.it
    assert config.keywords()["source"] == config.keywords()["reward"] == "plugin:it"
    assert config.keywords().keys() == {field.name for field in dataclasses.fields(EnvConfig)}
    plugin.it = Unpicklable()
    copy = pickle.loads(pickle.dumps(config))
    assert copy == config == dataclasses.replace(config)
    assert hash(copy) == hash(config)
    assert copy.resolved_source is plugin.it


def test_sequences_become_tuples():
    given = {"channels": ["view", "goal"], "features": ["time"], "view_size": [7, 5], "scenario": ["a.scen"]}
    for config in (EnvConfig(**given), EnvConfig(**{name: UserList(value) for name, value in given.items()})):
        assert {name: getattr(config, name) for name in given} == {name: tuple(value) for name, value in given.items()}
        assert hash(config) == hash(EnvConfig(**given))
