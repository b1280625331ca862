"""POGEMA's configurations in YAML become the bundled instances."""

import json

import numpy as np
import pytest

from mapf_pz.errors import FormatError
from mapf_pz.instances import convert_pogema, load_pogema, read_pogema
from mapf_pz.instances.benchmarks import pogema
from mapf_pz.instances.benchmarks.packs import read_arrays
from mapf_pz.instances.pogema_placement import PogemaMap, place_agents

pytest.importorskip("yaml")

CONFIG = """
environment:
  on_target: {on_target}
  seed: {seed}
  num_agents:
    grid_search: [1, 2]
  map_name: {maps}
"""
MAPS = """
"open": |-
  ....
  .#..
"marked": |-
  @!$$
  @#@$
"""


MERGES = "a0: &a0 {k: 1}\n" + "".join(f"a{n}: &a{n} {{<<: [{f'*a{n - 1}, ' * 9}]}}\n" for n in range(1, 9))
"""Nested merge keys, which would copy a member 9**8 times."""


def converted(folder, on_target="nothing", seed="0", maps="open", drawn=MAPS, config=CONFIG):
    (folder / "maps.yaml").write_text(drawn)
    file = folder / "07-mine-mapf.yaml"
    file.write_text(config.format(on_target=on_target, seed=seed, maps=maps))
    return convert_pogema(file, folder / "maps.yaml", folder / "out")


def drawings(pack):
    """The maps of a pack as YAML."""
    names, shapes, cells = read_arrays(pack, "map_names", "map_shapes", "map_cells")
    ends = np.cumsum(shapes[:, 0].astype(int) * shapes[:, 1])
    rows = [part.reshape(shape) for part, shape in zip(np.split(cells, ends[:-1]), shapes, strict=True)]
    drawn = {name: " ".join(bytes(row).decode() for row in part) for name, part in zip(names, rows, strict=True)}
    return json.dumps(drawn)  # JSON is YAML


@pytest.mark.parametrize("pack", pogema.SETS)
@pytest.mark.parametrize("lifelong", [False, True])
def test_the_bundled_instances_are_those_of_the_seeds(tmp_path, pack, lifelong):
    name = pack + pogema.LIFELONG * lifelong
    bundled = load_pogema(name)
    keys = pogema.instance_keys(pack)
    chosen = range(0, len(bundled), 40)
    settings = {"on_target": "restart" if lifelong else "nothing", "num_agents": bundled[0].num_agents}
    (tmp_path / "maps.yaml").write_text(drawings(pack))
    for number in chosen:
        map_name, seed = keys[number]
        environment = settings | {"seed": int(seed), "map_name": map_name}
        (tmp_path / "a.yaml").write_text(json.dumps({"environment": environment}))
        _, file = convert_pogema(tmp_path / "a.yaml", tmp_path / "maps.yaml", tmp_path)
        (instance,) = read_pogema(file)
        if not lifelong:
            assert instance == bundled[number]
            continue
        assert instance.grid == bundled[number].grid
        mine, theirs = instance.scenario, bundled[number].scenario
        assert (mine.starts == theirs.starts).all()
        # The bundled sequences cover 300 steps of shortest paths, which takes fewer goals.
        for goals, count, others, other_count in zip(
            mine.goals, mine.goal_counts, theirs.goals, theirs.goal_counts, strict=True
        ):
            shorter = min(count, other_count)
            assert (goals[:shorter] == others[:shorter]).all()


def test_names_seeds_and_agents(tmp_path):
    files = converted(tmp_path, seed="{grid_search: [3, 4]}", maps="{grid_search: [open, marked]}")
    assert [file.name for file in files] == ["07-mine.maps.json", "07-mine.mapf.json"]
    entries = json.loads(files[1].read_text())
    assert [(one["map_name"], one["seed"]) for one in entries] == [
        ("open", 3),
        ("marked", 3),
        ("open", 4),
        ("marked", 4),
    ]
    assert {one["num_agents"] for one in entries} == {2}
    marked = entries[1]
    assert all(cell in [[0, 0], [1, 0], [1, 2]] for cell in marked["agents_xy"])
    assert all(cell in [[0, 2], [0, 3], [1, 3]] for cell in marked["targets_xy"])
    assert len(read_pogema(files[1])[0].scenario) == 2


def test_lifelong_sequences_cover_three_hundred_steps(tmp_path):
    files = converted(tmp_path, "restart")
    assert files[1].name == "07-mine.lmapf.json"
    (entry,) = json.loads(files[1].read_text())
    for start, goals in zip(entry["agents_xy"], entry["targets_xy"], strict=True):
        moves = np.abs(np.diff([start, *goals], axis=0)).sum(axis=1)
        assert sum(moves[:-1]) < 300 <= sum(moves)
        assert min(moves) > 0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"seed": "x"}, "expected 'seed' and 'num_agents' to be whole numbers"),
        ({"seed": "-1"}, "expected 'seed' and 'num_agents' to be whole numbers"),
        ({"seed": "{grid_search: 3}"}, r"07-mine-mapf\.yaml: expected 'seed' to have a value or a 'grid_search' list"),
        ({"maps": "[]"}, "expected 'map_name' to have a value or a 'grid_search' list"),
        ({"maps": "other"}, r"maps\.yaml: expected a drawing of the map 'other', got None"),
        ({"drawn": "open: 3"}, r"maps\.yaml: expected a drawing of the map 'open', got 3"),
        ({"drawn": "open: '.. .'"}, r"maps\.yaml: map 'open':2:2: expected a row of 2 cells, got 1"),
        ({"drawn": "open: '.a'"}, r"maps\.yaml: map 'open':1:2: expected one of .*, got 'a'"),
        ({"drawn": "open: '..'"}, "map 'open', seed 0: the map has no cells for 2 agents"),
        ({"drawn": "open: '@@$'"}, "map 'open', seed 0: the map has 2 starts and 1 goals for 2 agents"),
        ({"drawn": "open: [1"}, r"maps\.yaml:\d+: expected YAML: "),
        (
            {"drawn": "[" * 50_000},
            r"maps\.yaml:1: expected YAML with at most 20 levels and 100 aliases, and no merge keys",
        ),
        ({"drawn": "a: " + "[" * 21 + "]" * 21}, r"maps\.yaml:1: expected YAML with at most 20 levels"),
        ({"drawn": "a: &x 1\nb: [" + "*x, " * 101 + "]"}, r"maps\.yaml:2: expected YAML with at most 20 levels"),
        ({"drawn": MERGES}, r"maps\.yaml:2: expected YAML with at most 20 levels"),
        ({"drawn": "- 3"}, r"maps\.yaml: expected the file to be a mapping"),
        ({"config": "environment: 3"}, r"07-mine-mapf\.yaml: expected environment to be a mapping, got 3"),
        ({"config": "environment: !!python/object/apply:os.getcwd []"}, "expected YAML: could not determine a cons"),
    ],
)
def test_wrong_configurations(tmp_path, changes, message):
    with pytest.raises(FormatError, match=message) as caught:
        converted(tmp_path, **changes)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_a_limit_on_all_goals(tmp_path, monkeypatch):
    monkeypatch.setattr("mapf_pz.instances.files.pogema_config.MAX_GOALS", 1)
    with pytest.raises(FormatError, match="expected at most 1 goals in all instances"):
        converted(tmp_path)


def test_goals_on_marked_cells_need_two_of_them():
    with pytest.raises(ValueError, match="has 1 starts and 1 goals for 1 agents"):
        place_agents(PogemaMap(np.ones((1, 2), bool), ((0, 0),), ((0, 1),)), 1, 0, 10)
