import numpy as np
import pytest

from mapf_pz.planners.deadline import Deadline
from mapf_pz.planners.sipp.improve import allocate_lns, plan_and_improve
from mapf_pz.planners.sipp.neighborhood import (
    AGENT_BASED,
    MAP_BASED,
    RANDOM,
    allocate_neighborhood,
    choose_around_missing,
    choose_neighborhood,
    delay,
    shortest,
)
from mapf_pz.planners.sipp.refine import NeighborhoodSearch, sipp_problem
from mapf_pz.planners.sipp.reservations import NONE, allocate_reservations, discard, read_path, withdraw
from mapf_pz.planners.sipp.search import allocate_scratch
from tests.helpers.text_instances import drawn, problem

SEEDS = range(1, 9)
APART, ONE_LATE = "a..A b..B", [[0, 4], [1, 4], [2, 5], [3, 6], [3, 7]]
CROSSING, BOTH_LATE = "##b## a...A ##B##", [[5, 2], [6, 2], [6, 7], [7, 12], [8, 12], [9, 12]]
CROSSING_BEFORE = [[5, 2], [6, 7], [7, 12], [8, 12], [9, 12]]
ROW = "abcdefg"


class Chooser:
    """An instance in which agents have paths, `rows` (T + 1, N) of cells, or stay where they are."""

    def __init__(self, text, rows=None, headings=None):
        given = problem(drawn(text, headings))
        agents, cells = len(given.goals), given.leads_to.shape[1] - 1
        self.problem, self.agents, self.cells = sipp_problem(given), agents, cells
        self.reservations = allocate_reservations(agents, cells, 100)
        read_path(self.reservations, np.array([given.starts] if rows is None else rows, np.int32), False)

    def forget(self, agent):
        """Leave an agent without a path."""
        discard(self.reservations, withdraw(self.reservations, agent))

    def chosen(self, choose, *arguments, seed):
        neighborhood = allocate_neighborhood(self.agents, self.cells, seed)
        for _ in range(3):  # the result does not depend on the previous choice
            choose(*arguments, self.problem, self.reservations, neighborhood)
        agents = neighborhood.agents[: neighborhood.size[0]].tolist()
        assert np.flatnonzero(neighborhood.chosen).tolist() == sorted(agents)
        return agents


def test_delays():
    chooser = Chooser(CROSSING, BOTH_LATE)
    assert [shortest(chooser.problem, agent) for agent in range(2)] == [4, 2]
    assert [delay(chooser.problem, chooser.reservations, agent) for agent in range(2)] == [1, 1]
    chooser.forget(0)
    assert [delay(chooser.problem, chooser.reservations, agent) for agent in range(2)] == [0, 1]
    assert shortest(Chooser("a..A", headings=[1]).problem, 0) == 4


@pytest.mark.parametrize("seed", SEEDS)
def test_no_agent_is_delayed(seed):
    assert Chooser(ROW).chosen(choose_neighborhood, AGENT_BASED, 8, seed=seed) == []


@pytest.mark.parametrize("seed", SEEDS)
def test_one_agent_is_delayed_with_no_agent_in_its_way(seed):
    assert Chooser(APART, ONE_LATE).chosen(choose_neighborhood, AGENT_BASED, 8, seed=seed) == [1]


@pytest.mark.parametrize("headings", [None, [0, 1]])
def test_a_delayed_agent_and_the_agent_in_its_way(headings):
    # b is in the way of a, if that does not wait; a is not in the way of b.
    chooser = Chooser(CROSSING, BOTH_LATE, headings)
    found = [chooser.chosen(choose_neighborhood, AGENT_BASED, 8, seed=seed) for seed in range(1, 30)]
    assert [0, 1] in found
    assert [1] in found
    assert all(chosen in ([0, 1], [1]) for chosen in found)
    assert chooser.chosen(choose_neighborhood, AGENT_BASED, 1, seed=1) in ([0], [1])


@pytest.mark.parametrize("wanted", [1, 3, 7, 8])
@pytest.mark.parametrize("seed", SEEDS)
def test_random_agents(wanted, seed):
    assert len(Chooser(ROW).chosen(choose_neighborhood, RANDOM, wanted, seed=seed)) == min(wanted, 7)


def test_every_agent_is_chosen_sometimes():
    firsts = [Chooser(ROW).chosen(choose_neighborhood, RANDOM, 1, seed=seed)[0] for seed in range(1, 100)]
    assert set(firsts) == set(range(7))


@pytest.mark.parametrize("wanted", [1, 2, 4, 7])
@pytest.mark.parametrize("seed", SEEDS)
def test_map_based_chooses_the_agents_around_a_cell(wanted, seed):
    chosen = Chooser(ROW).chosen(choose_neighborhood, MAP_BASED, wanted, seed=seed)
    center = chosen[0]
    by_distance = sorted(range(7), key=lambda agent: abs(agent - center))
    assert len(chosen) == wanted
    assert [abs(agent - center) for agent in chosen] == [abs(agent - center) for agent in by_distance[:wanted]]


def test_map_based_where_no_agent_passes_any_more():
    # b has left the cells behind it for good; the next agent there is chosen.
    chooser = Chooser("a...b...AB", [[0, 4], [1, 5], [2, 6], [3, 7], [4, 8], [5, 9], [6, 9], [7, 9], [8, 9]])
    found = {tuple(sorted(chooser.chosen(choose_neighborhood, MAP_BASED, 8, seed=seed))) for seed in range(1, 60)}
    assert found == {(0, 1)}


@pytest.mark.parametrize("seed", SEEDS)
def test_map_based_needs_a_path(seed):
    chooser = Chooser("a")
    chooser.forget(0)
    assert chooser.chosen(choose_neighborhood, MAP_BASED, 8, seed=seed) == []


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(("missing", "rows"), [(0, BOTH_LATE), (1, BOTH_LATE), (1, CROSSING_BEFORE)])
def test_the_agents_in_the_way_of_an_agent_without_a_path(missing, rows, seed):
    chooser = Chooser(CROSSING, rows)
    chooser.forget(missing)
    chosen = chooser.chosen(choose_around_missing, 8, seed=seed)
    assert chosen[0] == missing
    # On its shortest path a meets b where b rests or crosses; b is past before a comes, unless a waits.
    assert chosen.count(1 - missing) == in_the_way(chooser, missing)


def in_the_way(chooser, agent):
    """Return whether the other agent is on this one's only shortest path when it is, or at its goal afterwards."""
    paths = {0: [5, 6, 7, 8, 9], 1: [2, 7, 12]}
    visits, other = chooser.reservations.visits, 1 - agent
    visit = chooser.reservations.first[other]
    met = False
    while visit != NONE:
        one = visits[visit]
        steps = [step for step, cell in enumerate(paths[agent]) if cell == one["cell"]]
        last = paths[agent][-1]
        met |= any(one["begin"] <= step <= one["end"] for step in steps)
        met |= bool(one["cell"] == last and one["end"] >= len(paths[agent]) - 1)
        visit = one["next"]
    return met


def search_in_order(text):
    """Plan the agents sequentially; the last one finds no path."""
    search = NeighborhoodSearch(problem(drawn(text)), np.random.default_rng(0))
    search.plan_all(np.array([0, 1]), Deadline(np.inf))
    assert search.missing == 1
    return search


def test_the_last_path_is_found_though_all_others_are_the_shortest():
    search = search_in_order("b.A.B ##a##")
    search.improve(work=2000)
    assert search.missing == 0
    assert search.sum_of_costs == 7


def test_a_path_is_worth_waiting_for():
    search = search_in_order(f"BA{'.' * 98}b #a{'#' * 99}")
    search.improve(work=20_000)
    assert search.missing == 0
    assert search.sum_of_costs == 200


def test_kinds_that_gain_nothing_lose_success():
    reservations, scratch = allocate_reservations(2, 10, 100), allocate_scratch(111, 1, 100)
    neighborhood, lns = allocate_neighborhood(2, 10, seed=1), allocate_lns(2)
    given, state = sipp_problem(problem(drawn("b.A.B ##a##"))), (reservations, scratch, neighborhood, lns)
    plan_and_improve(given, np.array([0, 1]), 2000, *state)
    assert reservations.arrival.sum() == 7  # the best, though each agent alone would be quicker
    plan_and_improve(given, np.zeros(0, np.int64), 1000, *state)
    assert (lns.success > 0).all()
    assert (lns.success < 0.95).all()
