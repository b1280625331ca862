import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mapf_pz
from mapf_pz.guidance import GuidanceGraph
from mapf_pz.instances import RandomObstacles, load_instance
from mapf_pz.instances.heading import Heading
from mapf_pz.instances.instance import Instance, Scenario
from mapf_pz.planners import Plan, validate
from mapf_pz.planners.base import simulator_of
from mapf_pz.planners.problem import problem_of
from mapf_pz.planners.sipp import prioritized
from mapf_pz.planners.sipp.prioritized import PrioritizedSIPP
from mapf_pz.planners.sipp.refine import NeighborhoodSearch, sipp_problem
from mapf_pz.planners.sipp.reservations import (
    NONE,
    allocate_reservations,
    discard,
    read_path,
    reserve,
    withdraw,
    write_path,
)
from mapf_pz.planners.sipp.search import allocate_scratch, find_path
from mapf_pz.simulator.kernels.cost_lookup import num_headings
from tests.helpers.episodes import play
from tests.helpers.text_instances import drawn, problem

NEVER = 10**6


def first_solution(instance, **keywords):
    return PrioritizedSIPP(anytime=False).solve(instance, **keywords)


def wander(instance, steps, rng):
    """Return where agents are that act at random: (steps + 1, N) cells."""
    simulator = simulator_of(instance, steps + 1, "uniform", 0)
    cells = [simulator.agents[0]["cell"].copy()]
    for _ in range(steps):
        simulator.step(rng.integers(simulator.num_actions, size=(1, instance.num_agents)))
        cells.append(simulator.agents[0]["cell"].copy())
    return np.stack(cells)


def moves(problem, cell, heading):
    if num_headings(problem.to_go) == 1:
        return [(cell, 0), *((int(problem.leads_to[d, cell]), 0) for d in range(4))]
    ahead = int(problem.leads_to[heading, cell])
    return [(cell, heading), (cell, (heading + 1) % 4), (cell, (heading + 3) % 4), (ahead, heading)]


def earliest_arrival(problem, agent, others):
    """Search breadth-first in space and time; `others` (T + 1, M) stay at the end. Returns None if there is no path."""
    goal, last = problem.goals[agent], len(others) - 1
    crossed = [step for step in range(last + 1) if goal in others[step]]
    states = {(int(problem.starts[agent]), int(problem.headings[agent]))}
    for step in range(last + 4 * problem.leads_to.shape[1]):
        if step > max(crossed, default=-1) and any(cell == goal for cell, _ in states):
            return step
        before, after = others[min(step, last)].tolist(), others[min(step + 1, last)].tolist()
        moving = set(zip(before, after, strict=True))
        states = {
            (target, facing)
            for cell, heading in states
            for target, facing in moves(problem, cell, heading)
            if target not in after and (target == cell or (target, cell) not in moving)
        }
    return None


@pytest.mark.parametrize("model", ["cardinal", "rotate"])
@pytest.mark.parametrize("weights", ["uniform", "crisscross", "random"])
@settings(max_examples=80)
@given(seed=st.integers(0, 2**31), size=st.integers(4, 7), steps=st.integers(0, 25), crossed=st.booleans())
def test_the_earliest_arrival_among_others(model, weights, seed, size, steps, crossed):
    rng = np.random.default_rng(seed)
    drawn_instance = RandomObstacles(size, size, 0.15, 6).sample(rng)
    grid, starts = drawn_instance.grid, drawn_instance.scenario.starts
    headings = rng.integers(4, size=6) if model == "rotate" else None
    their_headings = None if headings is None else headings[:5]
    others = wander(Instance(grid, Scenario(starts[:5], starts[:5]), their_headings), steps, rng)
    goal = np.ravel_multi_index(drawn_instance.scenario.goals[5], (size, size))
    passed = np.setdiff1d(others[steps // 2 :], others[-1])
    if crossed and len(passed):  # another agent crosses the goal late
        goal = rng.choice(passed)
    goals = np.stack(np.divmod([*others[-1], goal], size), axis=1)
    instance = Instance(grid, Scenario(starts, goals), headings)
    problem = problem_of(simulator_of(instance, NEVER, weights, 0))
    expected = earliest_arrival(problem, 5, others)

    sipp = sipp_problem(problem)
    headings_count = num_headings(problem.to_go)
    reservations = allocate_reservations(6, size * size, 300)
    scratch = allocate_scratch(len(reservations.visits), headings_count, 300)
    read_path(reservations, others, False)
    for rotation in range(4):
        first = find_path(sipp, 5, NEVER, rotation, reservations, scratch)
        assert (first == NONE) == (expected is None)
        if expected is None:
            continue
        assert find_path(sipp, 5, expected - 1, rotation, reservations, scratch) == NONE
        reserve(reservations, 5, first)
        assert reservations.arrival[5] == expected
        shape = (max(expected, steps) + 1, 6)
        cells, facing = np.zeros(shape, np.int32), np.zeros(shape if model == "rotate" else (0, 0), np.int8)
        write_path(reservations, problem.leads_to, problem.headings, cells, facing)
        plan = Plan(np.stack(np.divmod(cells, size), axis=-1), facing if model == "rotate" else None)
        assert validate(instance, plan) is None
        discard(reservations, withdraw(reservations, 5))


@pytest.mark.parametrize(("headings", "steps"), [(None, 4), ([0], 4), ([1], 5), ([2], 6)])
def test_no_path_beyond_the_limit_or_the_horizon(headings, steps):
    given = problem(drawn("a...A", headings))

    def found(limit, horizon):
        reservations, scratch = (
            allocate_reservations(1, 5, 10),
            allocate_scratch(16, num_headings(given.to_go), horizon),
        )
        return find_path(sipp_problem(given), 0, limit, 0, reservations, scratch) != NONE

    assert [found(limit, 20) for limit in (steps - 1, steps)] == [False, True]
    assert [found(NEVER, horizon) for horizon in (steps, steps + 1)] == [False, True]


def test_visits_are_reused():
    given = problem(drawn("a...A"))
    reservations, scratch = allocate_reservations(1, 5, 6), allocate_scratch(12, 1, 10)
    for _ in range(10):
        first = find_path(sipp_problem(given), 0, NEVER, 0, reservations, scratch)
        assert first != NONE
        reserve(reservations, 0, first)
        discard(reservations, withdraw(reservations, 0))
    assert reservations.num_spare[0] == 6


@pytest.mark.parametrize("room", range(6))
def test_too_few_visits_for_a_path(room):
    given = problem(drawn("a...A"))
    reservations, scratch = allocate_reservations(1, 5, room), allocate_scratch(12, 1, 10)
    assert (find_path(sipp_problem(given), 0, NEVER, 0, reservations, scratch) != NONE) == (room == 5)
    assert reservations.num_spare[0] == (0 if room == 5 else room)


@pytest.mark.parametrize("headings", [None, [2]])
def test_an_agent_at_its_goal_stays(headings):
    plan = first_solution(drawn("a.", headings))
    assert plan is not None
    assert plan.num_steps == 0
    assert headings is None or plan.headings.tolist() == [headings]


@pytest.mark.parametrize("headings", [None, [3, 2]])
def test_it_waits_for_a_long_time(headings):
    instance = drawn(f"BA{'.' * 98}b #a{'#' * 99}", headings)
    plan = first_solution(instance)
    assert plan is not None
    assert plan.costs.tolist() == [100, 100]  # a moves as b leaves its goal


@pytest.mark.parametrize(("headings", "cost"), [(None, 4), ([0], 4), ([2], 6), ([1], 5)])
def test_one_agent_takes_the_shortest_path(headings, cost):
    plan = first_solution(drawn("a...A", headings))
    assert plan is not None
    assert plan.sum_of_costs == cost


@pytest.mark.parametrize("headings", [None, [0, 2]])
def test_a_passing_bay_lets_two_pass(headings):
    instance = drawn("Ba...bA #.#####", headings)
    plan = first_solution(instance)
    assert plan is not None
    assert validate(instance, plan) is None


def test_it_waits_for_a_crossing_agent():
    plan = first_solution(drawn("##b## ##.## a...A ##.## ##.## ##B##"))
    assert plan is not None
    assert plan.costs.tolist() == [5, 5]  # both would be at the crossing after 2 steps; b has farther to go


def test_it_arrives_after_an_agent_that_crosses_its_goal():
    instance = drawn("b.A.B ##a##")
    plan = first_solution(instance)
    assert plan is not None
    assert plan.costs.tolist() == [3, 4]
    assert validate(instance, plan) is None


def test_an_agent_at_its_goal_makes_way():
    instance = drawn("b.a.B ##.##")
    plan = first_solution(instance)
    assert plan is not None
    assert plan.costs.tolist() == [3, 4]


def test_a_corridor_that_is_too_narrow_has_no_plan():
    assert first_solution(drawn("aB.bA"), time_limit=0.1) is None


def test_it_restarts_in_another_order(monkeypatch):
    orders, plan_all, improve = set(), NeighborhoodSearch.plan_all, NeighborhoodSearch.improve

    def recorded(search, order, deadline):
        orders.add(tuple(order.tolist()))
        plan_all(search, order, deadline)

    monkeypatch.setattr(prioritized, "PATIENCE", 1)
    monkeypatch.setattr(NeighborhoodSearch, "plan_all", recorded)
    monkeypatch.setattr(NeighborhoodSearch, "improve", lambda *these, work=100: improve(*these, work=work))
    planner = PrioritizedSIPP(anytime=False)
    planner.compile("cardinal")
    orders.clear()
    assert planner.solve(drawn("aB.bA ##### c.d.. .C.D."), time_limit=0.5) is None
    assert len(orders) > 1
    assert all(sorted(order) == [0, 1, 2, 3] for order in orders)


def test_no_plan_for_one_goal_of_two():
    instance = drawn("a.b")
    problem = problem_of(simulator_of(instance, NEVER, "uniform", 0))
    both = problem._replace(goals=problem.goals[[0, 0]], table=problem.table[[0, 0]])
    assert PrioritizedSIPP().plan(both, 10.0) is None


@pytest.mark.parametrize("model", ["cardinal", "rotate"])
@pytest.mark.parametrize("weights", ["uniform", "crisscross", "random"])
@settings(max_examples=15)
@given(seed=st.integers(0, 2**31))
def test_every_plan_is_legal(model, weights, seed):
    instance = RandomObstacles(8, 8, 0.1, 14).sample(np.random.default_rng(seed))
    if model == "rotate":
        headings = np.random.default_rng(seed).integers(4, size=14)
        instance = Instance(instance.grid, instance.scenario, headings)
    plan = first_solution(instance, time_limit=1.0, edge_weights=weights)
    assert plan is None or validate(instance, plan) is None


def test_weights_decide_between_paths_of_equal_length():
    instance = drawn("a. .A")
    move = np.full((4, 2, 2), np.inf)
    move[0, :, 0] = move[2, :, 1] = move[1, 0] = move[3, 1] = 1
    for expensive, expected in ((Heading.EAST, [1, 0]), (Heading.SOUTH, [0, 1])):
        weights = move.copy()
        weights[expensive, 0, 0] = 3
        plan = first_solution(instance, edge_weights=GuidanceGraph(weights, np.ones((2, 2))))
        assert plan is not None
        assert plan.positions[1, 0].tolist() == expected


def test_it_respects_one_way_edges():
    move = np.full((4, 2, 2), np.inf)
    move[0, :, 0] = move[2, :, 1] = move[1, 0] = move[3, 1] = 1
    move[0, 0, 0] = np.inf
    plan = first_solution(drawn("aA .."), edge_weights=GuidanceGraph(move, np.ones((2, 2))))
    assert plan is not None
    assert plan.sum_of_costs == 3


@pytest.mark.parametrize("model", ["cardinal", "rotate"])
def test_benchmark_instances(model):
    instance = load_instance("random-32-32-20", "random-1", 150, model)
    plans = [PrioritizedSIPP(seed=1, anytime=False).solve(instance, time_limit=60) for _ in range(2)]
    assert plans[0] is not None
    assert plans[1] is not None
    assert validate(instance, plans[0]) is None
    assert np.array_equal(plans[0].positions, plans[1].positions)


@pytest.mark.parametrize("model", ["cardinal", "rotate"])
def test_as_a_policy_it_brings_all_agents_to_their_goals(model):
    env = mapf_pz.parallel_env(source=RandomObstacles(8, 8, 0.1, 6), action_model=model, max_steps=200)
    assert len(list(play(env, PrioritizedSIPP(env, anytime=False), seed=1))) < 200
    assert (env.positions == env.goals).all()
