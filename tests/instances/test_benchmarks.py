"""The bundled benchmarks: what they hold, and that they equal their sources."""

import csv
import hashlib

import numpy as np
import pytest

import mapf_pz
from experiments.data import benchmark_packs
from mapf_pz.instances import (
    load_instances,
    load_map,
    load_pogema,
    load_problem,
    load_scenario,
    map_names,
    read_pogema,
    read_problem,
    read_scenario,
)
from mapf_pz.instances.benchmarks import lorr, movingai, packs, pogema
from mapf_pz.instances.bundled import BUNDLED, map_path

SIZES = {"random": 64, "mazes": 64, "warehouse": 192, "cities": 256, "puzzles": 4}


def test_the_digests_of_the_packs():
    lines = (packs.folder() / "SHA256SUMS").read_text().splitlines()
    stated = {name: digest for digest, name in (line.split() for line in lines)}
    assert stated == {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in packs.folder().glob("*.npz")}
    readme = (packs.folder() / "README.md").read_text()
    assert all(f"`{name}`" in readme for name in stated)


def test_the_packs_are_small():
    assert sum(file.stat().st_size for file in packs.folder().iterdir() if file.is_file()) < 6e6


@pytest.mark.parametrize("name", movingai.scenario_names()[::7])
def test_every_scenario_is_of_a_bundled_map(name):
    (instance,) = load_instances([name])
    map, _, number = name.rpartition("-random-")
    assert instance.grid.name == map
    assert load_scenario(f"random-{number}", load_map(map)) == instance.scenario


def test_scenarios_by_name_make_an_environment():
    env = mapf_pz.parallel_env(map="Paris_1_256", scenario="random-1", num_agents=100)
    env.reset(seed=0)
    same = mapf_pz.parallel_env(scenario="Paris_1_256-random-1", num_agents=100)
    same.reset(seed=0)
    assert env.grid.shape == (256, 256)
    assert (env.goals == same.goals).all()


def test_names_of_scenarios_that_do_not_fit():
    for scenario, message in {
        "random-11": "no .scen file is named 'den312d-random-11'",
        "even-1": "no .scen file is named 'den312d-even-1'",
        "den312d-random-0": "no .scen file is named 'den312d-random-0'",
        "empty-8-8-random-1": "expected a scenario of map 'den312d', got one of 'empty-8-8'",
    }.items():
        with pytest.raises(ValueError, match=message):
            load_scenario(scenario, load_map("den312d"))
    with pytest.raises(ValueError, match="scenario='random-1': expected a map, too"):
        load_instances(["random-1"])


@pytest.mark.parametrize("name", pogema.instance_names())
def test_instances_of_pogema(name):
    num_agents = SIZES[name.split("-")[1]]
    instances = load_pogema(name)
    assert len(instances) == (160 if "puzzles" in name else 128)
    assert {one.num_agents for one in instances} == {num_agents}
    assert instances[3].scenario.first(2).starts.tolist() == load_pogema(name, 2)[3].scenario.starts.tolist()
    assert load_instances([name], num_agents=2)[0].num_agents == 2
    with pytest.raises(ValueError, match=f"num_agents={num_agents + 1}: {name} has 1 to {num_agents} agents"):
        load_pogema(name, num_agents + 1)
    with pytest.raises(ValueError, match="num_agents=0"):
        load_pogema(name, 0)


def test_one_shot_goals_are_the_first_of_the_lifelong_ones():
    one_shot, lifelong = load_pogema("pogema-cities"), load_pogema("pogema-cities-lifelong")
    for first, second in zip(one_shot, lifelong, strict=True):
        assert (first.scenario.starts == second.scenario.starts).all()
        assert (first.scenario.goals == second.scenario.goals[:, 0]).all()


@pytest.mark.parametrize("name", lorr.problem_names())
def test_problems_of_the_league_of_robot_runners(name):
    problem = load_problem(name)
    assert problem.name == name
    assert problem.team_size == int(name.rpartition("_")[2])
    assert problem.grid.name in map_names()
    assert problem.not_modeled == ()
    assert problem.instance(5).num_agents == problem.team_size


def test_unknown_names():
    with pytest.raises(ValueError, match="no problem named 'warehouse_small_11': did you mean 'warehouse_small_10'"):
        load_problem("warehouse_small_11")
    with pytest.raises(ValueError, match="no instances of POGEMA's benchmark named 'pogema-maze': did you mean"):
        load_pogema("pogema-maze")


# Equal to the sources, where these are available.


def test_maps_equal_the_benchmarks(benchmark):
    sources = {file.stem: file for file in (benchmark / "maps").glob("*.map")}
    sources["warehouse_small"] = next(benchmark.glob("lorr/archive-2023-example/*/maps/warehouse_small.map"))
    for name in set(map_names()) - set(BUNDLED):
        assert map_path(name).read_bytes() == sources[name].read_bytes()


def test_scenarios_equal_the_benchmarks(benchmark):
    for name in movingai.scenario_names():
        assert load_scenario(name) == read_scenario(benchmark / "scens" / f"{name}.scen")


def test_problems_equal_the_examples(benchmark):
    for name in lorr.problem_names():
        (file,) = benchmark.glob(f"lorr/archive-2023-example/*/EI23-{name}.json")
        bundled, source = load_problem(name), read_problem(file)
        assert bundled.grid == source.grid
        assert (bundled.strategy, bundled.reveal, source.not_modeled) == (source.strategy, source.reveal, ())
        for part in ("starts", "errands", "offsets"):
            assert np.array_equal(getattr(bundled, part), getattr(source, part))


@pytest.mark.slow
def test_instances_equal_pogemas(pogema_benchmark):
    for name, own in pogema.SETS.items():
        assert load_pogema(name) == read_pogema(pogema_benchmark / f"{own}.mapf.json")
        assert load_pogema(f"{name}-lifelong") == read_pogema(pogema_benchmark / f"{own}.lmapf.json")
        assert load_pogema(f"{name}-lifelong", 2) == read_pogema(pogema_benchmark / f"{own}.lmapf.json", 2)


@pytest.mark.slow
def test_published_results_equal_pogemas(pogema_benchmark):
    for pack, own in pogema.SETS.items():
        files = (pogema_benchmark / f"{own}.{name}.csv" for name in ("results", "results-2026", "results-dmm"))
        texts = [file.read_text() for file in files if file.exists()]
        rows = [row for text in texts for row in csv.DictReader(text.splitlines())]
        counts = sorted({int(row["num_agents"]) for row in rows})
        assert packed_results(pack, counts) == published_results(rows, "mapf", ("CSR", "ISR", "SoC", "makespan"))
        assert packed_results(f"{pack}-lifelong", counts) == published_results(rows, "lmapf", ("avg_throughput",))


def packed_results(name, counts):
    """The packed results of a name, sorted."""
    keys = pogema.instance_keys(name)
    return sorted(
        (
            (one.algorithm, count, keys[one.instance] if one.instance >= 0 else None, _rounded(one.metrics))
            for count in counts
            for one in pogema.read_results(name, count)
        ),
        key=str,
    )


def published_results(rows, kind, metrics):
    """The same from rows of the source."""
    return sorted(
        (
            (
                row["algorithm"],
                int(row["num_agents"]),
                (row["map_name"], row["seed"]) if row["seed"] else None,
                _rounded({name: float(row[name]) for name in metrics if row[name]}),
            )
            for row in rows
            if row["kind"] == kind
        ),
        key=str,
    )


def _rounded(metrics):
    return {name: round(value, 6) for name, value in metrics.items()}


def test_the_program_writes_the_same_bytes(pogema_benchmark, benchmark, tmp_path):
    benchmark_packs.write(tmp_path / "a.npz", benchmark_packs.pogema(pogema_benchmark, "05-puzzles"))
    assert (tmp_path / "a.npz").read_bytes() == (packs.folder() / "pogema-puzzles.npz").read_bytes()
    benchmark_packs.write(tmp_path / "b.npz", benchmark_packs.movingai(benchmark / "scens"))
    assert (tmp_path / "b.npz").read_bytes() == (packs.folder() / "movingai.npz").read_bytes()
