"""One schema of environments: training has all of it, and runs save it."""

import dataclasses
import inspect
import json
from pathlib import Path

import numpy as np
import pytest

import mapf_pz
from mapf_pz import Grid, GuidanceGraph, Instance, Scenario
from mapf_pz.instances import (
    FixedMap,
    FixedScenario,
    InstanceList,
    MapMixture,
    SourceMixture,
    write_map,
    write_scenario,
)
from mapf_pz.rl import config as rl_config
from mapf_pz.rl import load_policy, train
from mapf_pz.rl.config import TaskConfig
from mapf_pz.rl.config_file import CONFIG, load_config, save_config
from mapf_pz.rl.training.train import resume
from tests.helpers.small_run import ENV_FIELDS, TINY, changed, rows

GRID = Grid(np.ones((6, 6), np.bool_), "hall")
SCENARIO = Scenario([[0, 0], [0, 1], [0, 2]], [[5, 0], [5, 1], [5, 2]])
SHUTTLES = Scenario([[0, 0]] + [[1, 1], [2, 2]], [[[5, 0], [0, 0]], [[5, 1], [5, 1]], [[5, 2], [5, 2]]], [2, 1, 1])
INSTANCES = [Instance(GRID, SCENARIO, [0, 1, 2]), Instance(GRID, SCENARIO)]
OBJECTS = {
    "map": {"map": GRID},
    "array": {"map": GRID.free},
    "drawing": {"map": "......\n" * 6},
    "scenario": {"map": GRID, "scenario": SCENARIO},
    "goals in sequence": {"map": GRID, "scenario": SHUTTLES, "on_target": "restart"},
    "edge weights": {"map": GRID, "edge_weights": GuidanceGraph.crisscross(GRID.free)},
    "fixed map": {"source": FixedMap(GRID, 3)},
    "fixed scenario": {"source": FixedScenario(GRID, SCENARIO, 3)},
    "instances": {"source": InstanceList(INSTANCES)},
    "mixture of sources": {"source": SourceMixture([FixedMap(GRID, 3), InstanceList(INSTANCES)])},
    "files": {"scenario": ("a.scen", Path("b.scen"))},
    "mixture of maps": {"maps": ("maze", "empty-8-8"), "height": (5, 6), "density": (0.1, 0.3), "corridor": (1, 2)},
    "headings": {"initial_heading": [0, 1, 3]},
    "name of a reward": {"reward": "report"},
}


def with_env(**fields):
    return dataclasses.replace(TINY, task=changed(TINY.task, **fields))


def test_no_field_of_an_environment_is_declared_twice():
    for name, kind in inspect.getmembers(rl_config, dataclasses.is_dataclass):
        if isinstance(kind, type) and kind.__module__.startswith("mapf_pz.rl"):
            assert not ENV_FIELDS & {field.name for field in dataclasses.fields(kind)}, name


@pytest.mark.parametrize("fields", OBJECTS.values(), ids=list(OBJECTS))
def test_a_saved_configuration_is_read_back_equal(tmp_path, fields):
    config = with_env(**fields)
    save_config(tmp_path, config)
    text = (tmp_path / CONFIG).read_text()
    assert load_config(tmp_path / CONFIG) == config
    assert "object at 0x" not in text
    assert "array(" not in text


def test_a_path_stays_a_path(tmp_path):
    config = with_env(map=tmp_path / "a.map", scenario="b.scen")
    save_config(tmp_path, config)
    assert load_config(tmp_path / CONFIG) == config


def test_instances_on_one_map_still_share_it(tmp_path):
    save_config(tmp_path, with_env(source=InstanceList(INSTANCES)))
    source = load_config(tmp_path / CONFIG).task.env.source
    assert source.grid is source.instances[0].grid is source.instances[1].grid


def test_files_of_another_configuration_are_removed(tmp_path):
    save_config(tmp_path, with_env(map=GRID, scenario=SCENARIO))
    save_config(tmp_path, TINY)
    assert [file.name for file in tmp_path.iterdir()] == [CONFIG]


@pytest.mark.parametrize("fields", [OBJECTS["goals in sequence"], OBJECTS["instances"]], ids=["scenario", "instances"])
def test_a_run_on_given_instances_continues(tmp_path, fields):
    config = dataclasses.replace(with_env(**fields), agent_steps=192)
    resume(train(config, tmp_path), agent_steps=384)
    assert load_policy(tmp_path).config.task == config.task
    assert len(rows(tmp_path)) == 2


def test_the_scenario_determines_the_number_of_agents():
    config = with_env(map=GRID, scenario=SCENARIO, num_agents=None)
    assert (config.task.num_agents, config.steps_per_update) == (3, 3 * 4 * 16)


def test_the_files_of_a_task_are_read_once(tmp_path):
    write_map(GRID, tmp_path / "hall.map")
    write_scenario(SCENARIO, GRID, tmp_path / "hall.scen")
    config = with_env(map=tmp_path / "hall.map", scenario=tmp_path / "hall.scen", num_agents=None)
    unread = dataclasses.replace(config, task=dataclasses.replace(config.task))
    assert config.task.num_agents == 3
    (tmp_path / "hall.map").unlink()
    assert config.steps_per_update == 3 * 4 * 16
    assert config.task.env_config().source is config.task.source
    assert config == unread
    save_config(tmp_path, config)
    assert load_config(tmp_path / CONFIG) == config


def test_a_generated_source_is_made_once():
    task = TaskConfig(mixture=MapMixture(maps=("maze", "random")))
    assert task.env_config().source is task.source
    assert task.source.num_agents == 8


def test_an_object_of_another_type_is_refused(tmp_path):
    class Own(FixedMap):
        pass

    with pytest.raises(ValueError, match="source: a run cannot save a Own, only GuidanceGraph, ") as caught:
        train(with_env(source=Own(GRID, 3)), tmp_path / "run")
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda task: task.update(task.pop("env")), r"task\.map: unknown field, which may be one of another version"),
        (lambda task: task["env"].pop("on_target"), r"task\.env: .*on_target: expected a value"),
        (lambda task: task["env"].update(colour=1), r"task\.env: .*colour: unknown field"),
        (lambda task: task["env"].update(channels=["colour"]), r"task\.env: .*channels: unknown "),
        (lambda task: task["env"].update(max_steps=0), r"task\.env: .*max_steps=0: expected a whole number"),
        (lambda task: task["env"].update(source="source.safetensors"), r"source\.safetensors: not a saved value"),
    ],
)
def test_other_forms_of_the_file_are_refused_in_one_line(tmp_path, change, told):
    save_config(tmp_path, TINY)
    file = tmp_path / CONFIG
    content = json.loads(file.read_text())
    change(content["task"])
    file.write_text(json.dumps(content))
    with pytest.raises(mapf_pz.FormatError, match=told) as caught:
        load_config(file)
    assert "\n" not in str(caught.value)


def test_random_maps_have_the_size_and_the_agents_of_the_task():
    task = TaskConfig(mixture=MapMixture(height=9, width=10, density=0.1))
    env = mapf_pz.MapfEnv(task.env_config())
    assert (env.simulator.shape, len(env.possible_agents)) == ((9, 10), 8)


def test_a_run_from_before_optimization_had_a_part_of_its_own_is_read(tmp_path):
    config = dataclasses.replace(TINY, ppo=dataclasses.replace(TINY.ppo, gamma=0.5))
    save_config(tmp_path, config)
    saved = json.loads((tmp_path / CONFIG).read_text())
    saved["ppo"] |= saved.pop("optimization")
    (tmp_path / CONFIG).write_text(json.dumps(saved))
    assert load_config(tmp_path / CONFIG) == config
