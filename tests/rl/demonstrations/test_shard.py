"""Shards: what is written is read, and other files are refused in one line."""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapf_pz._internal.npz import read_npz, write_npz
from mapf_pz.instances.instance import Grid, Instance
from mapf_pz.instances.place import place
from mapf_pz.rl.demonstrations import Demonstration, load_dataset, make_dataset
from mapf_pz.rl.demonstrations.demonstration import METRICS
from mapf_pz.rl.demonstrations.shard import read_shard, write_shard
from mapf_pz.simulator.config import EnvConfig
from tests.helpers.corrupt_files import Case, bounded, changed, fuzzed, outcome, refused
from tests.helpers.text_instances import drawn
from tests.rl.demonstrations.small_dataset import small

NAMES = (
    *("format", "shape", "grids", "names", "grid", "seeds", "starts", "headings", "num_goals", "goals"),
    *("num_steps", "actions", "metric_names", "metrics"),
)


@st.composite
def drawn_demonstrations(draw, model):
    """Return the size of maps, a number of agents, and demonstrations of it."""
    shape, num_agents = (
        (draw(st.integers(2, 5)), draw(st.integers(2, 9) | st.integers(255, 300))),
        draw(st.integers(1, 4)),
    )
    grids = [Grid(np.ones(shape), draw(st.text("ab\n", max_size=3))) for _ in range(2)]
    rng = np.random.default_rng(draw(st.integers(0, 99)))
    num_actions = 5 if model == "cardinal" else 4

    def demonstration(num_goals, num_steps, grid, metrics):
        headings = None if model == "cardinal" else rng.integers(4, size=num_agents)
        instance = Instance(grid, place(grid, num_agents, rng, num_goals), headings)
        actions = rng.integers(num_actions, size=(num_steps, num_agents)).astype(np.uint8)
        return Demonstration(instance, actions, int(rng.integers(2**40)), metrics)

    metrics = st.dictionaries(st.sampled_from(METRICS), st.floats(allow_nan=False))
    one = st.builds(demonstration, st.integers(1, 4), st.integers(1, 9), st.sampled_from(grids), metrics)
    return shape, num_agents, draw(st.lists(one, max_size=4))


@pytest.mark.parametrize("model", ["rotate", "cardinal"])
@given(data=st.data())
def test_what_is_written_is_read(model, data):
    shape, num_agents, demonstrations = data.draw(drawn_demonstrations(model))
    with TemporaryDirectory() as folder:
        file = Path(folder) / "shard.npz"
        write_shard(file, demonstrations, shape, num_agents)
        shard = read_shard(file, model)
    assert len(shard) == len(demonstrations)
    for k, expected in enumerate(demonstrations):
        found = shard.demonstration(k)
        assert found.instance == expected.instance
        assert found.instance.grid.name == expected.instance.grid.name
        assert np.array_equal(found.actions, expected.actions)
        assert (found.seed, found.metrics) == (expected.seed, expected.metrics)
        assert shard.sizes()[k].tolist() == [*shape, num_agents, expected.num_steps]


@pytest.fixture(scope="module")
def arrays(tmp_path_factory):
    folder = tmp_path_factory.mktemp("data")
    make_dataset(small(num_agents=(3,), episodes=4, shard_size=4, solved_only=False), folder)
    return read_npz(next(folder.glob("*.npz")), NAMES)


def with_first(array, value):
    """Return the array with another first number."""
    copy = array.astype(np.int64) if array.dtype.kind in "iu" else array.copy()
    copy.flat[0] = value
    return copy


def blocked(packed):
    return np.zeros_like(packed)


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("format", lambda a: a + 1, "format: expected 1, got 2"),
        ("shape", lambda a: a + 1, "grids: expected whole numbers"),
        ("shape", lambda a: a[:1], "shape: expected whole numbers"),
        ("shape", lambda a: a * 100_000, "names: expected"),
        ("grids", blocked, "goals: expected at least one goal for each agent, and a path"),
        ("grids", lambda a: a.astype(np.float64), "grids: expected whole numbers"),
        ("names", lambda a: a[:-1], "grids: expected whole numbers"),
        ("names", lambda a: np.arange(len(a)), "names: expected"),
        ("grid", lambda a: with_first(a, 99), "grid: expected whole numbers from 0 to"),
        ("seeds", lambda a: with_first(a, -1), "seeds: expected whole numbers"),
        ("starts", lambda a: with_first(a, -1), "starts: expected whole numbers"),
        ("starts", lambda a: with_first(a, a.flat[1]), "starts: expected different cells"),
        ("starts", lambda a: a[0], "not enough values"),
        ("starts", lambda a: a[:, :0], "starts: expected at least one agent"),
        ("starts", lambda a: a[:-1], "grid: expected whole numbers"),
        ("headings", lambda a: with_first(a, 4), "headings: expected whole numbers from 0 to 3"),
        ("num_goals", lambda a: with_first(a, 2), "goals: expected whole numbers"),
        ("num_goals", lambda a: np.array([0, 2, 1, 1]), "goals: expected at least one goal"),
        ("goals", lambda a: with_first(a, 64), "goals: expected whole numbers from 0 to 63"),
        ("num_steps", lambda a: with_first(a, 0), "actions: expected whole numbers"),
        ("num_steps", lambda a: np.array([0, a[0] + a[1], a[2], a[3]]), "num_steps: expected at least one step"),
        ("actions", lambda a: with_first(a, 4), "actions: expected whole numbers from 0 to 3"),
        ("actions", lambda a: a[:, :-1], "actions: expected whole numbers"),
        ("metrics", lambda a: a[:, :-1], "metrics: expected a number for each demonstration and name"),
        ("metric_names", lambda a: np.arange(len(a)), "metrics: expected a number"),
    ],
)
def test_arrays_that_do_not_fit(tmp_path, arrays, name, change, message):
    file = tmp_path / "shard.npz"
    write_npz(file, arrays | {name: change(arrays[name])})
    refused(lambda: read_shard(file, "rotate"), f"shard.npz: expected demonstrations: {message}")


def test_a_shard_that_is_too_large_is_not_written(tmp_path, monkeypatch):
    file = tmp_path / "shard.npz"
    instance = drawn("a.A")
    demonstrations = [Demonstration(instance, np.zeros((500, 1), np.uint8))]
    monkeypatch.setattr("mapf_pz.rl.demonstrations.shard.MAX_FILE_BYTES", 2000)
    write_shard(file, demonstrations, (1, 3), 1)
    with pytest.raises(ValueError, match="expected a smaller shard_size"):
        write_shard(file, demonstrations * 4, (1, 3), 1)
    assert len(read_shard(file, "cardinal")) == 1


def test_cardinal_actions_are_read_as_such(tmp_path, arrays):
    file = tmp_path / "shard.npz"
    write_npz(file, arrays | {"actions": with_first(arrays["actions"], 4)})
    assert read_shard(file, "cardinal").headings is None


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("data")
    make_dataset(small(num_agents=(3,), episodes=2, env=EnvConfig(max_steps=20, on_target="restart")), folder)
    assert len(load_dataset(folder)) == 2
    return {file.name: file.read_bytes() for file in folder.iterdir() if file.suffix != ".md"}


@pytest.mark.parametrize("ending", [".npz", ".json"])
@fuzzed
@given(data=st.data())
def test_any_bytes_are_read_or_refused(files, ending, data):
    name = next(name for name in files if name.endswith(ending))
    case = Case(files, load_dataset)
    with TemporaryDirectory() as folder, bounded():
        read = case.written(Path(folder), {name: data.draw(changed(files[name]))})
        outcome(read)
