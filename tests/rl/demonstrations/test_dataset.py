"""Datasets: demonstrations are those of the planner, and replays repeat them."""

import json
import time
from itertools import islice, pairwise

import numpy as np
import pytest

from mapf_pz._internal.parallel import job_runner
from mapf_pz.guidance import GuidanceGraph, save_guidance
from mapf_pz.instances import InstanceList, MapMixture, load_map, place, write_scenario
from mapf_pz.instances.instance import Instance
from mapf_pz.planners import PIBT, PLANNERS, planner_of
from mapf_pz.rl.demonstrations import load_dataset, make_dataset
from mapf_pz.rl.demonstrations.demonstration import METRICS, demonstrate
from mapf_pz.simulator import Simulator
from mapf_pz.simulator.config import EnvConfig
from tests.helpers.text_instances import drawn
from tests.rl.demonstrations.small_dataset import small

VIEW = {"view_size": (5, 5), "channels": ("view", "cost_to_go"), "features": ("time", "last_actions")}


def made(folder, config):
    make_dataset(config, folder)
    return load_dataset(folder)


def contents(folder):
    return {file.name: file.read_bytes() for file in folder.iterdir()}


@pytest.mark.parametrize("model", ["rotate", "cardinal"])
@pytest.mark.parametrize("on_target", ["nothing", "finish", "restart"])
@pytest.mark.parametrize("collisions", ["soft", "priority"])
def test_replays_repeat_the_episodes(tmp_path, model, on_target, collisions):
    env = EnvConfig(action_model=model, on_target=on_target, collision_system=collisions, max_steps=30)
    data = made(tmp_path, small(env=env, solved_only=False))
    assert len(data) == 10
    assert data.rules.action_model == model
    for demonstration, (simulator, actions) in zip(data, data.replay(VIEW), strict=True):
        for step in actions:
            assert not simulator.over[0]
            simulator.step(step)
        assert simulator.over[0]
        metrics = simulator.metrics(0)
        assert demonstration.metrics == {name: metrics[name] for name in METRICS if name in metrics}
        assert ("avg_throughput" in metrics) == (on_target == "restart")


@pytest.mark.parametrize(
    ("planner", "env"),
    [
        ("pibt", EnvConfig(max_steps=40)),
        ("epibt:depth=3", EnvConfig(max_steps=40, on_target="restart")),
        ("lacam:anytime=False", EnvConfig(max_steps=60, action_model="cardinal")),
        ("prioritized:anytime=False", EnvConfig(max_steps=60, edge_weights="crisscross")),
        ("windowed", EnvConfig(map="random-16-16-20", max_steps=20, on_target="restart")),
    ],
)
def test_demonstrations_are_episodes_of_the_planner(tmp_path, planner, env):
    # On maps like these, planners of whole paths find a plan at once, whatever their time limit is.
    mixture = MapMixture(height=(6, 8), width=8, density=0.1)
    config = small(planner=planner, env=env, mixture=mixture, num_agents=(5,), solved_only=False)
    data = made(tmp_path, config)
    simulator, expected = Simulator(config.env_config(5)), planner_of(planner, config.seed)
    expected.compile(env.action_model)
    for seed, demonstration in enumerate(data, config.seed):
        simulator.reset(seeds={0: seed})
        expected.reset_states()
        assert demonstration.seed == seed
        assert demonstration.instance.grid.free.tolist() == simulator.grid(0).free.tolist()
        assert demonstration.instance.scenario.starts.tolist() == simulator.positions(0).tolist()
        for actions in demonstration.actions:
            chosen = expected.decide(simulator)
            assert actions.tolist() == chosen.tolist()
            simulator.step(chosen[None])
        assert simulator.over[0]


def test_batches_are_the_observations_of_the_episodes(tmp_path):
    data = made(tmp_path, small(env=EnvConfig(max_steps=40, on_target="finish")))
    for k in range(len(data)):
        demonstration = data[k]
        (simulator, _), *_ = data.subset(np.array([k])).replay(VIEW)
        steps = islice(data.subset(np.array([k])).batches(VIEW, num_envs=2), 2 * demonstration.num_steps)
        for number, batch in enumerate(steps):
            step = number % demonstration.num_steps
            assert batch.is_first.tolist() == [step == 0] * 2
            if step == 0:
                simulator.reset(instances={0: demonstration.instance})
            observation = simulator.observe()
            for b in range(2):
                assert np.array_equal(batch.image[b], observation.image[0])
                assert np.array_equal(batch.features[b], observation.features[0])
                assert np.array_equal(batch.action_mask[b], observation.action_mask[0])
                assert np.array_equal(batch.active[b], simulator.agents["active"][0])
                assert np.array_equal(batch.at_goal[b], simulator.agents["at_goal"][0])
                assert batch.actions[b].tolist() == demonstration.actions[step].tolist()
            simulator.step(batch.actions[:1])


def test_batches_contain_all_demonstrations_equally_often(tmp_path):
    data = made(tmp_path, small(num_agents=(3,), episodes=12))
    lengths = sorted(data.num_steps.tolist())
    seen = []
    batches = data.batches(VIEW, num_envs=1, seed=5)
    for _ in range(3):
        starts = [batch.is_first[0] for batch in islice(batches, sum(lengths))]
        ends = [*np.flatnonzero(starts).tolist(), len(starts)]
        seen.append([after - before for before, after in pairwise(ends)])
        assert sorted(seen[-1]) == lengths
    assert seen[0] != seen[1] != seen[2]


def test_batches_have_one_number_of_agents_in_proportion_to_the_steps(tmp_path):
    data = made(tmp_path, small(solved_only=False)).subset(np.array([0, 5, 6, 7, 8, 9]))
    counts = [batch.actions.shape for batch in islice(data.batches(num_envs=3), 1000)]
    assert set(counts) == {(3, 2), (3, 4)}
    assert np.isclose(counts.count((3, 2)) / 1000, data.num_steps[0] / data.num_steps.sum(), atol=0.05)


def test_the_seed_determines_the_batches(tmp_path):
    data = made(tmp_path, small())
    one, same, other = ([*islice(data.batches(VIEW, 4, seed), 60)] for seed in (1, 1, 2))
    assert all(np.array_equal(x, y) for a, b in zip(one, same, strict=True) for x, y in zip(a, b, strict=True))
    assert any(not np.array_equal(a.actions, b.actions) for a, b in zip(one, other, strict=True))


@pytest.mark.slow
@pytest.mark.usefixtures("forked_processes")
def test_interruptions_and_processes_do_not_change_the_result(tmp_path):
    config = small(solved_only=False)
    make_dataset(config, tmp_path / "at once")

    def interrupted(function, items):
        yield from map(function, items[:2])
        raise KeyboardInterrupt

    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            make_dataset(config, tmp_path / "resumed", interrupted)
    assert len(load_dataset(tmp_path / "resumed")) == 7
    first = min((tmp_path / "resumed").glob("*.npz"))
    before = first.stat().st_mtime_ns
    left = []
    with job_runner(2) as run:
        make_dataset(config, tmp_path / "resumed", run, left.append)
    assert left == [2, 1, 0]
    assert first.stat().st_mtime_ns == before
    assert contents(tmp_path / "resumed") == contents(tmp_path / "at once")


def test_the_size_of_shards_does_not_change_the_demonstrations(tmp_path):
    for size in (1, 10):
        config = small(planner="windowed", env=EnvConfig(max_steps=15, on_target="restart"), shard_size=size)
        make_dataset(config, tmp_path / str(size))
    one, other = (load_dataset(tmp_path / str(size)) for size in (1, 10))
    assert len(one) == len(other) == 10
    for a, b in zip(one, other, strict=True):
        assert (a.instance, a.seed, a.metrics) == (b.instance, b.seed, b.metrics)
        assert np.array_equal(a.actions, b.actions)


def test_another_dataset_in_the_folder(tmp_path):
    make_dataset(small(episodes=1), tmp_path)
    with pytest.raises(ValueError, match="contains demonstrations with other settings"):
        make_dataset(small(episodes=1, seed=4), tmp_path)


def test_another_map_file_of_the_same_name(tmp_path):
    file = tmp_path / "a.map"
    file.write_text("type octile\nheight 2\nwidth 6\nmap\n......\n...@@@\n")
    config = small(env=EnvConfig(map=file, max_steps=20), episodes=1)
    make_dataset(config, tmp_path / "data")
    file.write_text("type octile\nheight 2\nwidth 6\nmap\n......\n....@@\n")
    with pytest.raises(ValueError, match="contains demonstrations with other settings"):
        make_dataset(config, tmp_path / "data")


@pytest.mark.parametrize("during", [False, True])
@pytest.mark.parametrize("changed", ["0.scen", "1.scen", "2.scen", "weights.npz"])
def test_a_changed_input(tmp_path, changed, during):
    grid = load_map("empty-8-8")

    def write(name, seed):
        rng = np.random.default_rng(seed)
        if name == "weights.npz":
            save_guidance(GuidanceGraph.random(grid.free, rng), tmp_path / name, grid)
        else:
            write_scenario(place(grid, 2, rng), grid, tmp_path / name)

    files = {name: seed for seed, name in enumerate(["0.scen", "1.scen", "2.scen", "weights.npz"])}
    for name, seed in files.items():
        write(name, seed)
    scenarios = [tmp_path / name for name in list(files)[:3]]
    env = EnvConfig(map="empty-8-8", scenario=scenarios, edge_weights=tmp_path / "weights.npz", max_steps=20)
    config = small(env=env, num_agents=None, episodes=2, shard_size=1)
    if during:
        with pytest.raises(ValueError, match="a map, scenario or edge weights differ from the start"):
            make_dataset(config, tmp_path / "data", show=lambda left: write(changed, 9) if left == 1 else None)
        assert len(list((tmp_path / "data").glob("shard-*"))) == 1
        write(changed, files[changed])
    else:
        with pytest.raises(KeyboardInterrupt):
            make_dataset(config, tmp_path / "data", run=interrupted)
        write(changed, 9)
        with pytest.raises(ValueError, match="contains demonstrations with other settings"):
            make_dataset(config, tmp_path / "data")
        write(changed, files[changed])
    assert len(made(tmp_path / "data", config)) == 2


def interrupted(make, jobs):
    yield make(jobs[0])
    raise KeyboardInterrupt


def test_unsolved_episodes_are_omitted(tmp_path):
    # The second instance has no solution, as the agents cannot pass each other.
    instances = [drawn("a.A.. .b..B"), drawn("aB.bA #####")]
    headings = np.zeros(2, np.int64)
    source = InstanceList([Instance(i.grid, i.scenario, headings) for i in instances])
    env = EnvConfig(source=source, max_steps=20)
    everything = made(tmp_path / "all", small(env=env, num_agents=None, episodes=20, solved_only=False))
    solved = made(tmp_path / "solved", small(env=env, num_agents=None, episodes=20))
    assert 0 < len(solved) < len(everything) == 20
    assert [d.seed for d in solved] == [d.seed for d in everything if d.metrics["CSR"] == 1]


def test_time_limits_are_in_cpu_time(tmp_path, monkeypatch):
    clocks = []

    class Timed(PIBT):
        def decide(self, simulator, b=0):
            clocks.append(self.clock)
            return super().decide(simulator, b)

    monkeypatch.setitem(PLANNERS, "timed", Timed)
    make_dataset(small(planner="timed", episodes=1), tmp_path)
    assert set(clocks) == {time.thread_time}


def test_a_subset_is_replayed_in_its_order(tmp_path):
    data = made(tmp_path, small(solved_only=False)).subset(np.array([9, 0, 5, 1]))
    replayed = [(simulator.num_agents, actions[:, 0].tolist()) for simulator, actions in data.replay()]
    assert replayed == [(d.num_agents, d.actions.tolist()) for d in data]
    assert [n for n, _ in replayed] == [4, 2, 4, 2]


def test_groups_have_the_same_number_of_agents(tmp_path):
    data = made(tmp_path, small(solved_only=False))
    assert [(len(group), {d.num_agents for d in group}) for group in data.groups()] == [(5, {2}), (5, {4})]
    assert data.num_agent_steps == sum(d.actions.size for d in data)
    assert data.num_steps.tolist() == [d.num_steps for d in data]


def test_demonstrations_on_one_map_share_it(tmp_path):
    data = made(tmp_path, small(env=EnvConfig(map="random-16-16-20", max_steps=60)))
    assert len(data.grids()) == 1
    assert len({id(d.instance.grid) for d in data}) == 1
    assert len(made(tmp_path / "many", small()).grids()) > 3


def test_a_lifelong_instance_has_the_goals_that_were_needed():
    simulator = Simulator(EnvConfig(num_agents=3, max_steps=50, on_target="restart"))
    planner = PIBT()
    planner.compile("rotate")
    demonstration = demonstrate(simulator, planner, 0)
    reached = simulator.agents["arrivals"][0].max()
    assert demonstration.instance.scenario.goals.shape == (3, reached + 1, 2)


def test_files_are_small(tmp_path):
    data = made(tmp_path, small(episodes=50, shard_size=50, env=EnvConfig(max_steps=60, on_target="restart")))
    size = sum(file.stat().st_size for file in tmp_path.glob("*.npz"))
    assert size < data.num_agent_steps


def test_the_card(tmp_path):
    data = made(tmp_path, small(episodes=2, license="CC-BY-4.0", solved_only=False))
    card = (tmp_path / "README.md").read_text()
    assert card.startswith("---\nlicense: cc-by-4.0\n")
    assert "# Demonstrations of `pibt`" in card
    of_two = [d for d in data if d.num_agents == 2]
    steps, solved = sum(d.actions.size for d in of_two), np.mean([d.metrics["CSR"] for d in of_two])
    assert f"| 2 | 2 | {len(of_two)} | {steps} | {solved:.4g} |" in card
    assert "avg_throughput" not in card
    settings = json.loads((tmp_path / "dataset.json").read_text())
    assert all(f"| {name} | `{json.dumps(value)}` |" in card for name, value in settings.items() if name != "rules")


def test_keywords_of_other_rules(tmp_path):
    data = made(tmp_path, small(episodes=1, num_agents=(2,), solved_only=False))
    with pytest.raises(ValueError, match="action_model='cardinal': the demonstrations have action_model='rotate'"):
        data.batches({"action_model": "cardinal"})
    with pytest.raises(TypeError, match="unknown keyword 'chanels'"):
        next(data.replay({"chanels": ("view",)}))
    everything = EnvConfig(map="empty-8-8", max_steps=9).keywords()
    assert next(data.batches(everything, num_envs=2)).image.shape == (2, 2, 7, 5, 5)
    others = {"map": "empty-8-8", "num_agents": 7, "max_steps": 5, "channels": ("goal",), "initial_heading": "east"}
    assert next(data.batches(others, num_envs=2)).image.shape == (2, 2, 1, 5, 5)


def test_no_demonstrations(tmp_path):
    data = made(tmp_path, small(env=EnvConfig(max_steps=1), episodes=2))
    assert len(data) == 0
    assert data.groups() == []
    assert list(data.replay()) == []
    with pytest.raises(ValueError, match="expected at least one demonstration"):
        data.batches()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"planner": "best"}, "planner 'best': expected one of"),
        ({"planner": "pibt:depth=3"}, "option 'depth=3'"),
        ({"episodes": 0}, "episodes=0: expected a whole number, 1 or more"),
        ({"shard_size": 0}, "shard_size=0: expected a whole number, 1 or more"),
        ({"num_agents": (3, 0)}, r"num_agents\[1]=0: expected a whole number, 1 or more"),
        ({"num_agents": ()}, r"num_agents=\(\): expected 1 or more items"),
        ({"seed": -1}, "seed=-1: expected a whole number, 0 or more"),
        ({"env": EnvConfig(edge_weights="random")}, "edge_weights: expected"),
        ({"env": EnvConfig(edge_weights=GuidanceGraph.uniform(load_map("empty-8-8").free))}, "edge_weights: expected"),
    ],
)
def test_invalid_settings(changes, message):
    with pytest.raises(ValueError, match=message):
        small(**changes)


def test_no_dataset(tmp_path):
    with pytest.raises(FileNotFoundError):
        load_dataset(tmp_path)
    with pytest.raises(FileNotFoundError):
        load_dataset(tmp_path / "none")
