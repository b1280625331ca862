"""Reproducibility: the same seed and actions give the same arrays, whatever else there is."""

import hashlib
import subprocess
import sys

import numba
import numpy as np
import pytest

from mapf_pz.instances import RandomObstacles
from mapf_pz.instances.instance import Grid, Instance, Scenario
from mapf_pz.simulator import Simulator
from mapf_pz.simulator.config import EnvConfig
from mapf_pz.simulator.kernels.observation.channels import CHANNELS
from mapf_pz.simulator.kernels.observation.features import FEATURES
from mapf_pz.simulator.kernels.step import step

ON_TARGET = ("nothing", "finish", "restart")
MAPS = ("one map", "many maps")
B = 5


def make_config(on_target, maps, **keywords):
    """Everything that can be observed, and rewards that read the cost to go and the neighbours."""
    goals = 4 if on_target == "restart" else 1
    place = {"source": RandomObstacles(6, 5, 0.2, 6, goals)} if maps == "many maps" else {"map": np.ones((5, 5), bool)}
    options = {
        "num_agents": 6,
        "max_steps": 15,
        "on_target": on_target,
        "view_size": (4, 3),
        "see_through_walls": False,
        "channels": tuple(CHANNELS),
        "features": tuple(FEATURES),
        "num_frames": 2,
        "num_neighbors": 2,
        "neighbor_radius": 3,
        "edge_weights": "random" if maps == "many maps" else "crisscross",
        "reward": "progress",
    }
    return EnvConfig(**place | options | keywords)


class Recorder:
    """A simulator; each row of it has a random stream of actions of its own, and some resets in the middle."""

    def __init__(self, config, num_envs, first_seed=0, num_threads=1):
        self.simulator = Simulator(config, num_envs, num_threads)
        self.seeds = {b: first_seed + b for b in range(num_envs)}
        self.rngs = [np.random.default_rng([7, seed]) for seed in self.seeds.values()]
        self.simulator.reset(seeds=self.seeds)

    def play(self, num_steps=60):
        """Return all arrays of all steps by name: (steps, B, ...) each."""
        log = [self._arrays()]
        for _ in range(num_steps):
            shape = (self.simulator.num_agents,)
            actions = [rng.choice(4, shape, p=(0.7, 0.1, 0.1, 0.1)) for rng in self.rngs]
            self.simulator.step(np.stack(actions))
            log.append(self._arrays())
            agents = self.simulator.agents
            over = agents["truncated"].any(axis=1) | (agents["terminated"] | ~agents["active"]).all(axis=1)
            over |= [rng.random() < 0.05 for rng in self.rngs]
            if over.any():
                self.simulator.reset(np.flatnonzero(over).tolist())
                log.append(self._arrays())
            else:
                log.append(log[-1])  # so that rows which begin anew at other times stay aligned
        return {name: np.stack([arrays[name] for arrays in log]) for name in log[0]}

    def _arrays(self):
        state = self.simulator.state
        agents = {name: state.agents[name].copy() for name in state.agents.dtype.names if name not in UNSEEN}
        metrics = [list(self.simulator.metrics(b).values()) for b in range(self.simulator.num_envs)]
        return (
            self.simulator.observe()._asdict()
            | agents
            | {"history": state.history.copy(), "time": state.time.copy(), "metrics": np.array(metrics)}
        )


UNSEEN = ("want", "next_cell", "table")  # scratch, and numbers of tables, which depend on the batch


@pytest.mark.parametrize("maps", MAPS)
@pytest.mark.parametrize("on_target", ON_TARGET)
def test_any_row_of_a_batch_is_the_single_environment(on_target, maps):
    config = make_config(on_target, maps)
    batch = Recorder(config, B, first_seed=11).play()
    for b in range(B):
        single = Recorder(config, 1, first_seed=11 + b).play()
        for name, arrays in single.items():
            np.testing.assert_array_equal(arrays[:, 0], batch[name][:, b], err_msg=name)


several_threads = pytest.mark.skipif(
    numba.config.NUMBA_NUM_THREADS < 2, reason="one core; set NUMBA_NUM_THREADS=2 to test it all the same"
)


@several_threads
@pytest.mark.parametrize("maps", MAPS)
@pytest.mark.parametrize("on_target", ON_TARGET)
def test_threads_change_nothing(on_target, maps):
    config = make_config(on_target, maps)
    one, two = (Recorder(config, B, num_threads=threads).play(30) for threads in (1, 2))
    for name, arrays in one.items():
        np.testing.assert_array_equal(arrays, two[name], err_msg=name)


@several_threads
def test_threads_are_used():
    """Numba's cache would give out a kernel for one thread where one for several is asked for, and the reverse."""
    kernels = (step._serial, step._parallel)
    assert kernels[0].stats.cache_path != kernels[1].stats.cache_path
    assert Simulator(EnvConfig(), 1, num_threads=2)._num_threads == 2


def test_seeds_decide_and_differ():
    config = make_config("nothing", "many maps")
    first, again, other = (Recorder(config, 1, seed).play(20) for seed in (5, 5, 6))
    for name, arrays in first.items():
        np.testing.assert_array_equal(arrays, again[name], err_msg=name)
    assert not np.array_equal(first["cell"], other["cell"])


def test_without_a_seed_the_next_episode_differs():
    simulator = Simulator(make_config("nothing", "one map"))
    cells = []
    for seeds in ({0: 1}, None, None, {0: 1}, None):
        simulator.reset(seeds=seeds)
        cells.append(simulator.agents["cell"][0].tolist())
    first, second, third, *again = cells
    assert again == [first, second]
    assert first != second != third != first


def test_unseeded_simulators_differ():
    cells = []
    for _ in range(2):
        simulator = Simulator(make_config("nothing", "one map"), 2)
        simulator.reset()
        cells += simulator.agents["cell"].tolist()
    assert len({tuple(row) for row in cells}) == 4


def test_resetting_one_row_leaves_the_others_alone():
    simulator = Simulator(make_config("restart", "many maps"), 3)
    simulator.reset(seeds={b: b for b in range(3)})
    simulator.step(np.zeros((3, 6), np.int64))
    before = simulator.observe()
    simulator.reset([1], {1: 9})
    after = simulator.observe()
    for old, new in zip(before, after, strict=True):
        np.testing.assert_array_equal(old[[0, 2]], new[[0, 2]])
    assert not np.array_equal(before.image[1], after.image[1])
    assert simulator.steps.tolist() == [1, 0, 1]


@pytest.mark.parametrize("maps", MAPS)
def test_arrays_are_never_reused(maps):
    simulator = Simulator(make_config("nothing", maps), 2)
    simulator.reset(seeds={0: 0, 1: 1})
    seen = []
    for _ in range(4):
        seen.append(simulator.observe())
        simulator.step(np.zeros((2, 6), np.int64))
    kept = [[array.copy() for array in observation] for observation in seen]
    groups = (
        simulator.world,
        simulator.state,
        simulator._inputs.layers,
        simulator._inputs.origins,
        vars(simulator._inputs).values(),
        simulator._observer._frames,
        simulator._observer._own,
    )
    own = [array for group in groups for array in group]
    for k, observation in enumerate(seen):
        for array in observation:
            others = [other for later in seen[k + 1 :] for other in later] + own
            assert not any(np.shares_memory(array, other) for other in others if isinstance(other, np.ndarray))
            assert array.flags.writeable
    simulator.reset()
    for observation, copies in zip(seen, kept, strict=True):
        for array, copy in zip(observation, copies, strict=True):
            np.testing.assert_array_equal(array, copy)


def digest():
    """Hash all arrays of some episodes."""
    total = hashlib.sha256()
    for on_target in ON_TARGET:
        for name, arrays in Recorder(make_config(on_target, "many maps"), 2).play(40).items():
            total.update(name.encode() + arrays.tobytes())
    return total.hexdigest()


def test_another_process_gives_the_same():
    code = "from tests.simulator.test_simulator import digest; print(digest())"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == digest()


def test_a_given_instance():
    free = np.ones((3, 4), np.bool_)
    grid = Grid(free)
    simulator = Simulator(EnvConfig(map=grid, num_agents=2, view_size=(1, 1), initial_heading="east"))
    simulator.reset(instances={0: Instance(grid, Scenario([(0, 0), (2, 3)], [(2, 3), (0, 0)]))})
    assert simulator.positions(0).tolist() == [[0, 0], [2, 3]]
    assert simulator.goals(0).tolist() == [[2, 3], [0, 0]]
    assert simulator.agents["heading"][0].tolist() == [0, 0]
    other = Grid(np.array([[True, True, False, True]] * 3))
    simulator.reset(instances={0: Instance(other, Scenario([(0, 0), (2, 1)], [(0, 1), (0, 0)]), [1, 2])})
    assert simulator.grid(0) is other
    assert simulator.agents["heading"][0].tolist() == [1, 2]
    simulator.reset()
    assert simulator.grid(0) is grid


def test_a_batch_on_one_map_keeps_it():
    grid, other = Grid(np.ones((3, 3), np.bool_)), Grid(np.ones((3, 3), np.bool_))
    simulator = Simulator(EnvConfig(map=grid, num_agents=1, view_size=(1, 1)), num_envs=2)
    with pytest.raises(ValueError, match="instance on another map"):
        simulator.reset(instances={0: Instance(other, Scenario([(0, 0)], [(1, 1)]))})


def test_few_goals_are_repeated():
    grid = Grid(np.ones((1, 4), np.bool_))
    config = EnvConfig(
        map=grid, num_agents=1, view_size=(1, 1), on_target="restart", action_model="cardinal", max_steps=20
    )
    simulator = Simulator(config)
    simulator.reset(instances={0: Instance(grid, Scenario([(0, 0)], [[(0, 1), (0, 3)]]))})
    goals = [simulator.goals(0)[0, 1]]
    for action in (4, 4, 4, 3, 3, 4, 4):  # right is 4, left 3
        simulator.step(np.array([[action]]))
        goals.append(simulator.goals(0)[0, 1])
    assert goals == [1, 3, 3, 1, 1, 3, 3, 1]


@pytest.mark.parametrize(("name", "value"), [("num_envs", 0), ("num_threads", 0)])
def test_sizes_are_checked(name, value):
    with pytest.raises(ValueError, match=f"^{name}=0: expected a whole number, 1 or more$"):
        Simulator(EnvConfig(), **{name: value})


@pytest.mark.parametrize("shape", [(6,), (1, 6), (2, 5), (2, 6, 1)])
def test_the_shape_of_actions_is_checked(shape):
    simulator = Simulator(make_config("nothing", "one map"), 2)
    simulator.reset()
    with pytest.raises(ValueError, match=r"^actions: expected the shape \(2, 6\), got "):
        simulator.step(np.zeros(shape, np.int64))


def test_actions_are_integers_of_any_size_and_order():
    config, rng = make_config("nothing", "one map"), np.random.default_rng(0)
    actions = rng.integers(4, size=(2, 6))
    cells = []
    for given in (actions, actions.astype(np.int8), actions.astype(np.uint64), np.asfortranarray(actions)):
        simulator = Simulator(config, 2)
        simulator.reset(seeds={0: 0, 1: 1})
        simulator.step(given)
        cells.append((simulator.agents["cell"].tolist(), simulator.agents["heading"].tolist()))
    assert all(one == cells[0] for one in cells)
    with pytest.raises(TypeError, match="'same_kind'"):
        simulator.step(actions.astype(np.float32))
