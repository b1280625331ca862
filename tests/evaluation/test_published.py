"""Published results are compared only with instances on which they are possible."""

import dataclasses
from collections import Counter

import numpy as np
import pytest

from mapf_pz.evaluation import Episode
from mapf_pz.evaluation.reports.bounds import least_costs, most_goals
from mapf_pz.evaluation.reports.published import check_possible, impossible_episodes, published_episodes
from mapf_pz.evaluation.suite import suite_label
from mapf_pz.instances import load_pogema
from mapf_pz.instances.benchmarks.pogema import SETS, instance_names, read_results
from mapf_pz.instances.instance import Grid, Instance, Scenario
from mapf_pz.instances.place import place

CORRIDOR = Grid(np.ones((1, 6), bool))
AGENTS = {"random": (8, 16, 24, 32, 48, 64), "warehouse": (32, 64, 96, 128, 160, 192), "puzzles": (2, 3, 4)}
AGENTS |= {"mazes": AGENTS["random"], "cities": (64, 128, 192, 256)}


def corridor(starts, goals, counts=None):
    return Instance(CORRIDOR, Scenario([[0, c] for c in starts], [[[0, c] for c in one] for one in goals], counts))


def episode(value, num_agents=1, *, lifelong=False, policy="A", number=0):
    return Episode(policy, "corridor", num_agents, number, {"avg_throughput" if lifelong else "SoC": value}, "map")


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
        (episode(0, 1, number=1), True),  # no such instance
        (episode(0, 1, number=-1), True),  # the source does not state the instance
    ],
)
def test_what_is_possible(published, possible):
    instances = [corridor([0, 5], [[3, 5], [4, 0]])]
    assert impossible_episodes([published], instances, max_steps=6) == ([] if possible else [published])


def test_an_unsolved_agent_counts_no_more_than_the_limit():
    instances = [corridor([0], [[5]])]
    assert impossible_episodes([episode(3)], instances, max_steps=4) == []
    assert impossible_episodes([episode(2)], instances, max_steps=4) == [episode(2)]


def test_more_than_one_in_five_impossible_episodes_are_refused():
    instances = [corridor([0], [[3]])] * 10
    episodes = [episode(2 if number < 2 else 3, number=number) for number in range(10)]
    assert len(check_possible(episodes, instances, 10)) == 2
    others = [dataclasses.replace(one, policy="B") for one in episodes]
    episodes[5] = episode(2, number=5)
    with pytest.raises(ValueError, match=r"A with 1 agents are impossible .* in 3 of 10 .*episode 0, map"):
        check_possible([*episodes, *others], instances, 10)


def test_episodes_that_are_not_compared_do_not_count():
    episodes = [episode(2 if number == 0 else 3, number=number) for number in range(10)]
    with pytest.raises(ValueError, match=r"A with 1 agents are impossible .* in 1 of 2 episodes"):
        check_possible(episodes, [corridor([0], [[3]])] * 2, 10)


def own(name, *counts):
    """Episodes of a policy of ours on all instances of a suite."""
    suite, numbers = suite_label(name), range(len(load_pogema(name, max(counts))))
    return [Episode("pibt", "its task", count, k, {"CSR": 1.0}, suite=suite) for count in counts for k in numbers]


def test_published_episodes_are_those_of_the_same_tasks():
    published = published_episodes(own("pogema-mazes", 32))
    assert {(one.task, one.num_agents, one.suite) for one in published} == {
        ("its task", 32, suite_label("pogema-mazes"))
    }
    episodes = {one.number: one for one in published if one.policy == "LaCAM (published)"}
    assert sorted(episodes) == list(range(128))
    first = episodes[0]
    assert first.instance == "validation-mazes-seed-000"
    assert first.metrics["CSR"] == first.metrics["ISR"] == 1
    bound = least_costs(load_pogema("pogema-mazes", 32)[0]).sum()
    assert first.metrics["SoC_ratio"] == first.metrics["SoC"] / bound > 1
    assert len(published_episodes(own("pogema-mazes", 8, 16))) == 2 * len(published_episodes(own("pogema-mazes", 8)))


def test_a_metric_that_only_solved_episodes_state_is_left_out():
    published = [one for one in published_episodes(own("pogema-mazes", 64)) if one.policy == "DMM-08M (published)"]
    assert (len(published), {frozenset(one.metrics) for one in published}) == (128, {frozenset({"CSR", "ISR"})})
    assert sum(one.metrics["CSR"] for one in published) == 117


def test_episodes_without_a_stated_instance_are_not_paired():
    published = published_episodes(own("pogema-warehouse", 32))
    unpaired = [one.number for one in published if one.policy == "EPH (published)"]
    assert len(set(unpaired)) == len(unpaired) == 128
    assert max(unpaired) < 0


def test_published_episodes_are_those_on_the_measured_instances():
    """Methods whose sources do not state the instances are omitted, unless all are measured."""
    some = [one for one in own("pogema-warehouse", 32, 64) if one.number in ((2, 7) if one.num_agents == 32 else (0,))]
    published = published_episodes(some)
    shown = Counter((one.policy, one.num_agents, one.number) for one in published)
    assert set(shown.values()) == {1}
    assert {(num_agents, number) for _, num_agents, number in shown} == {(32, 2), (32, 7), (64, 0)}
    assert len(shown) == 3 * len({one.policy for one in published}) > 20
    assert "EPH (published)" not in {one.policy for one in published}


@pytest.mark.parametrize("suite", ["", "mine/1 0123456789abcdef", "pogema-mazes/1 0123456789abcdef", "pogema-mazes"])
def test_other_suites_have_no_published_episodes(suite):
    assert published_episodes([Episode("pibt", "POGEMA mazes", 32, 0, {"CSR": 1.0}, suite=suite)]) == []


EXCEEDING = {("RHCR", 8): 20, ("RHCR", 16): 2, ("RHCR", 24): 3, ("RHCR", 32): 3, ("RHCR", 48): 1, ("QPLEX", 8): 1}
"""The published lifelong results in mazes that are above the throughput of agents that never wait, of 128 each."""


@pytest.mark.slow
@pytest.mark.parametrize("name", instance_names())
def test_the_benchmarks_results_are_possible_on_its_instances(name):
    counts = AGENTS[name.split("-")[1]]
    steps = 256 if "lifelong" in name or "cities" in name else 128
    found = check_possible(published_episodes(own(name, *counts)), load_pogema(name, max(counts)), steps)
    expected = EXCEEDING if name == "pogema-mazes-lifelong" else {}
    assert Counter((one.policy.removesuffix(" (published)"), one.num_agents) for one in found) == expected


def test_starts_and_goals_anywhere_in_the_warehouse_are_refused():
    """The benchmark's goals lie along the shelves; goals anywhere are farther apart on average."""
    rng = np.random.default_rng(0)
    elsewhere = [
        Instance(one.grid, place(one.grid, one.num_agents, rng, goals_per_agent=30))
        for one in load_pogema("pogema-warehouse-lifelong", 32)
    ]
    with pytest.raises(ValueError, match="are impossible on these instances"):
        check_possible(published_episodes(own("pogema-warehouse-lifelong", 32)), elsewhere, max_steps=256)


def test_all_sets_have_published_results_for_all_numbers_of_agents():
    for name in SETS:
        for count in AGENTS[name.split("-")[1]]:
            for kind in (name, f"{name}-lifelong"):
                assert len({one.algorithm for one in read_results(kind, count)}) >= 8
