"""Published results are compared only with instances on which they are possible."""

import dataclasses
from collections import Counter

import numpy as np
import pytest

from mapf_pz.errors import FormatError
from mapf_pz.evaluation.reports.bounds import least_costs, most_goals
from mapf_pz.evaluation.reports.published import PublishedEpisode, check_possible, impossible_episodes, load_published
from mapf_pz.instances.files.pogema import load_pogema, pogema_keys
from mapf_pz.instances.instance import Grid, Instance, Scenario
from mapf_pz.instances.place import place

CORRIDOR = Grid(np.ones((1, 6), bool))
SETS = {"01-random": 64, "02-mazes": 64, "03-warehouse": 192, "04-movingai": 256, "05-puzzles": 4}
STEPS = {"04-movingai": 256}
HEADER = "kind,algorithm,num_agents,map_name,seed,CSR,ISR,SoC,makespan,ep_length,avg_throughput,runtime\n"


def corridor(starts, goals, counts=None):
    return Instance(CORRIDOR, Scenario([[0, c] for c in starts], [[[0, c] for c in one] for one in goals], counts))


def episode(value, num_agents=1, *, lifelong=False, algorithm="A", seed="0"):
    metrics = {"avg_throughput" if lifelong else "SoC": value}
    return PublishedEpisode(lifelong, algorithm, num_agents, ("corridor", seed), metrics)


def test_bounds_of_agents_that_never_wait():
    instance = corridor([0, 5], [[3, 0, 5], [4, 4, 0]])
    assert least_costs(instance).tolist() == [3, 1]
    assert [most_goals(instance, steps).tolist() for steps in (0, 1, 2, 3, 5, 6, 11)] == [
        [0, 0],
        [0, 1],
        [0, 2],  # a goal in the same cell takes a step
        [1, 2],
        [1, 2],
        [2, 3],
        [3, 3],
    ]


def test_a_sequence_ends_for_the_bound_where_the_agent_has_no_more_goals():
    assert most_goals(corridor([0, 5], [[1, 2, 3], [4, 3, 2]], [2, 3]), 10).tolist() == [2, 3]


@pytest.mark.parametrize(
    ("published", "possible"),
    [
        (episode(4, 2), True),
        (episode(3.9, 2), False),
        (episode(3, 1), True),
        (episode(2, 1), False),
        (episode(5 / 6, 2, lifelong=True), False),
        (episode(4 / 6, 2, lifelong=True), True),
        (episode(0, 3), True),  # more agents than the instance has: not compared
        (episode(0, 1, seed="1"), True),  # no such instance
    ],
)
def test_what_is_possible(published, possible):
    instances = {("corridor", "0"): corridor([0, 5], [[3, 5], [4, 0]])}
    assert impossible_episodes([published], instances, max_steps=6) == ([] if possible else [published])


def test_an_unsolved_agent_counts_no_more_than_the_limit():
    instances = {("corridor", "0"): corridor([0], [[5]])}
    assert impossible_episodes([episode(3)], instances, max_steps=4) == []
    assert impossible_episodes([episode(2)], instances, max_steps=4) == [episode(2)]


def test_more_than_one_in_five_impossible_episodes_are_refused():
    instances = {("corridor", str(seed)): corridor([0], [[3]]) for seed in range(10)}
    episodes = [episode(2 if seed < 2 else 3, seed=str(seed)) for seed in range(10)]
    assert len(check_possible(episodes, instances, 10)) == 2
    others = [dataclasses.replace(one, algorithm="B") for one in episodes]
    episodes[5] = episode(2, seed="5")
    with pytest.raises(
        ValueError, match=r"A with 1 agents are impossible .* in 3 of 10 .*A, 1 agents on corridor, seed 0"
    ):
        check_possible([*episodes, *others], instances, 10)


def test_episodes_that_are_not_compared_do_not_count():
    instances = {("corridor", str(seed)): corridor([0], [[3]]) for seed in range(2)}
    episodes = [episode(2 if seed == 0 else 3, seed=str(seed)) for seed in range(10)]
    with pytest.raises(ValueError, match=r"A with 1 agents are impossible .* in 1 of 2 episodes"):
        check_possible(episodes, instances, 10)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("kind,algorithm\n", r"r\.csv:1: expected the columns num_agents, map_name, seed, CSR"),
        (HEADER + "mapf,A,eight,m,0,1,1,9,3,3,,1\n", r"r\.csv:2: expected an episode"),
        (HEADER + "mapf,A,8,m,0,1,1,many,3,3,,1\n", r"r\.csv:2: expected an episode"),
        (HEADER + "mapf,A\n", r"r\.csv:2: expected an episode"),
    ],
)
def test_damaged_files(tmp_path, text, message):
    (tmp_path / "r.csv").write_text(text)
    with pytest.raises(FormatError, match=message):
        load_published(tmp_path / "r.csv")


def test_rows(tmp_path):
    (tmp_path / "r.csv").write_text(HEADER + "mapf,A,8,m,0,1,1.0,90,20,20,,6\nlmapf,B,4,m,,,,,,,0.5,\n")
    assert load_published(tmp_path / "r.csv") == [
        PublishedEpisode(False, "A", 8, ("m", "0"), {"CSR": 1, "ISR": 1, "SoC": 90, "makespan": 20}),
        PublishedEpisode(True, "B", 4, ("m", ""), {"avg_throughput": 0.5}),
    ]


def published_set(folder, name, lifelong):
    """The published episodes of a set, and its instances by key."""
    file = folder / f"{name}.{'lmapf' if lifelong else 'mapf'}.json"
    instances = dict(zip(pogema_keys(file), load_pogema(file, SETS[name]), strict=True))
    episodes = [one for csv in folder.glob(f"{name}.results*.csv") for one in load_published(csv)]
    return [one for one in episodes if one.lifelong == lifelong], instances


EXCEEDING = {("RHCR", 8): 20, ("RHCR", 16): 2, ("RHCR", 24): 3, ("RHCR", 32): 3, ("RHCR", 48): 1, ("QPLEX", 8): 1}
"""The published lifelong results in mazes that are above the throughput of agents that never wait, of 128 each."""


@pytest.mark.parametrize("name", SETS)
@pytest.mark.parametrize("lifelong", [False, True])
def test_the_benchmarks_results_are_possible_on_its_instances(pogema_benchmark, name, lifelong):
    episodes, instances = published_set(pogema_benchmark, name, lifelong)
    found = check_possible(episodes, instances, 256 if lifelong else STEPS.get(name, 128))
    expected = EXCEEDING if (name, lifelong) == ("02-mazes", True) else {}
    assert Counter((one.algorithm, one.num_agents) for one in found) == expected


def test_starts_and_goals_anywhere_in_the_warehouse_are_refused(pogema_benchmark):
    """The benchmark's goals lie along the shelves; goals anywhere are farther apart on average."""
    episodes, instances = published_set(pogema_benchmark, "03-warehouse", lifelong=True)
    rng = np.random.default_rng(0)
    elsewhere = {
        key: Instance(one.grid, place(one.grid, one.num_agents, rng, goals_per_agent=30))
        for key, one in instances.items()
    }
    with pytest.raises(ValueError, match="are impossible on these instances"):
        check_possible(episodes, elsewhere, max_steps=256)
