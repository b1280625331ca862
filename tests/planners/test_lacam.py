from collections import deque
from itertools import product

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import mapf_pz
from mapf_pz.evaluation.reports.bounds import least_costs
from mapf_pz.guidance import GuidanceGraph
from mapf_pz.instances import RandomObstacles, generate, load_instance
from mapf_pz.instances.heading import HEADING_STEPS
from mapf_pz.instances.instance import Grid, Instance, Scenario
from mapf_pz.instances.place import largest_component, place
from mapf_pz.planners import validate
from mapf_pz.planners.hashing import refill_slots
from mapf_pz.planners.lacam import planner as lacam
from mapf_pz.planners.lacam import search as core
from mapf_pz.planners.lacam.planner import LaCAM
from mapf_pz.planners.lacam.step import allocate_scratch
from tests.helpers.episodes import play
from tests.helpers.text_instances import drawn, problem

MODELS = ["cardinal", "rotate"]


def facing_east(instance, model):
    headings = np.zeros(instance.num_agents, np.int8) if model == "rotate" else None
    return Instance(instance.grid, instance.scenario, headings)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("text", ["aB.......bA #.#########", "abc..CBA ####.###"])
def test_swaps_with_little_room(text, model):
    instance = facing_east(drawn(text), model)
    plan = LaCAM(anytime=False).solve(instance)
    assert plan is not None
    assert validate(instance, plan) is None


@pytest.mark.parametrize("model", MODELS)
def test_agents_move_around_a_cycle(model):
    grid = Grid(np.ones((2, 2), bool))
    square = [(0, 0), (0, 1), (1, 1), (1, 0)]
    instance = facing_east(Instance(grid, Scenario(square, square[1:] + square[:1])), model)
    plan = LaCAM(anytime=False).solve(instance)
    assert validate(instance, plan) is None
    assert plan.makespan == (1 if model == "cardinal" else 3)


def test_one_agent_takes_the_shortest_path():
    assert LaCAM(anytime=False).solve(drawn("a..# ..#A ....")).sum_of_costs == 6


def test_no_agent_waits_without_need():
    plan = LaCAM(anytime=False).solve(drawn("a..# ..#A ....", headings=[2]))
    moved = (plan.positions[1:] != plan.positions[:-1]).any(axis=2)
    assert moved.sum() == 6
    assert (moved | (plan.headings[1:] != plan.headings[:-1])).all()


def test_agents_at_their_goals_stay():
    plan = LaCAM(anytime=False).solve(drawn("a.. .b."))
    assert plan.num_steps == 0


@pytest.mark.parametrize("model", MODELS)
def test_a_corridor_that_is_too_narrow_has_no_plan(model):
    assert LaCAM(anytime=False).solve(facing_east(drawn("aB.bA"), model), time_limit=1000) is None
    # More configurations than are allocated at first.
    assert LaCAM(anytime=False).solve(facing_east(drawn("abcd........DCAB"), model), time_limit=1000) is None


@pytest.mark.parametrize("text", ["aB.bA", "aB.C.cbA", "aB#bA ..###", "abcd.DCAB", "aB.bA ##### ..C.. ..c.. ....."])
def test_it_visits_all_configurations_with_minimal_capacity(text):
    instance = drawn(text)
    given, agents = problem(instance), instance.num_agents
    nodes, constraints = core.allocate_nodes(1, agents), core.allocate_constraints(1)
    scratch, counters = allocate_scratch(agents, instance.grid.free.size, seed=1), np.zeros(4, np.int64)
    core.start(given, given.goals, np.arange(agents, dtype=np.int32)[::-1], nodes, constraints, scratch, counters)
    while core.search(given, given.goals, 10**5, nodes, constraints, scratch, counters) == core.FULL:
        if counters[core.NUM_NODES] == len(nodes.parent):
            nodes = nodes._make(np.concatenate([array, np.zeros_like(array)]) for array in nodes)
            refill_slots(nodes, counters[core.NUM_NODES])
        else:
            constraints = constraints._make(np.append(array, np.int32(0)) for array in constraints)
    assert core.search(given, given.goals, 1, nodes, constraints, scratch, counters) == core.EXHAUSTED
    rows, cols = np.divmod(nodes.rows[: counters[core.NUM_NODES]], instance.grid.shape[1])
    seen = [tuple(zip(*cells, strict=True)) for cells in zip(rows.tolist(), cols.tolist(), strict=True)]
    assert sorted(seen) == sorted(reachable(instance))


@pytest.mark.parametrize("room", range(6, 30))
def test_growing_capacity_changes_nothing(room, monkeypatch):
    instance = RandomObstacles(4, 4, 0.0, 14).sample(np.random.default_rng(0))
    plan = LaCAM(anytime=False).solve(instance)
    allocate = core.allocate_nodes, core.allocate_constraints
    monkeypatch.setattr(core, "allocate_nodes", lambda _, agents: allocate[0](room - 5, agents))
    monkeypatch.setattr(core, "allocate_constraints", lambda _: allocate[1](room))
    small = LaCAM(anytime=False).solve(instance)
    assert plan is not None
    assert small is not None
    assert np.array_equal(plan.positions, small.positions)


def test_a_goal_out_of_reach_has_no_plan():
    assert LaCAM(anytime=False).solve(drawn("a#A"), time_limit=1000) is None


# The agents a and b can never pass each other, but the others have many configurations.
HOPELESS = "aB.bA ##### c..dC .e.f. ED.F."


def test_it_stops_at_the_time_limit():
    assert LaCAM(anytime=False).solve(drawn(HOPELESS), time_limit=0.05) is None


def test_it_stops_at_the_memory_limit(monkeypatch):
    monkeypatch.setattr(lacam, "MAX_BYTES", 1 << 20)
    assert LaCAM(anytime=False).solve(drawn(HOPELESS), time_limit=1000) is None


def test_a_shared_goal_has_no_plan():
    instance = Instance(Grid(np.ones((2, 2), bool)), Scenario([(0, 0), (1, 1)], [(0, 1), (0, 1)]))
    assert LaCAM(anytime=False).solve(instance, time_limit=1000) is None


@pytest.mark.parametrize("model", MODELS)
@settings(max_examples=40)
@given(free=st.lists(st.booleans(), min_size=9, max_size=9), agents=st.integers(1, 3), seed=st.integers(0, 2**31))
def test_it_solves_exactly_the_solvable_instances(model, free, agents, seed):
    grid = Grid(np.array(free).reshape(3, 3) | np.eye(3, k=1, dtype=bool))
    assume(len(largest_component(grid.free)) >= max(agents, 2))
    instance = facing_east(Instance(grid, place(grid, agents, np.random.default_rng(seed))), model)
    plan = LaCAM(anytime=False, seed=seed).solve(instance, time_limit=1000)
    assert (plan is not None) == is_solvable(instance)
    assert plan is None or validate(instance, plan) is None


def is_solvable(instance):
    return tuple(map(tuple, instance.scenario.goals.tolist())) in reachable(instance)


def reachable(instance):
    """Return all reachable configurations; turns make no difference, because all agents can wait for them."""
    free = {tuple(cell) for cell in np.argwhere(instance.grid.free).tolist()}
    start = tuple(map(tuple, instance.scenario.starts.tolist()))
    steps = [(0, 0), *map(tuple, HEADING_STEPS.tolist())]
    queue, seen = deque([start]), {start}
    while queue:
        here = queue.popleft()
        reached = [[(row + dr, col + dc) for dr, dc in steps if (row + dr, col + dc) in free] for row, col in here]
        for there in product(*reached):
            moves = set(zip(here, there, strict=True))
            swapped = any(a != b and (b, a) in moves for a, b in moves)
            if there not in seen and len(set(there)) == len(there) and not swapped:
                seen.add(there)
                queue.append(there)
    return seen


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("weights", ["uniform", "random", "crisscross"])
@settings(max_examples=15)
@given(seed=st.integers(0, 2**31))
def test_plans_are_valid(model, weights, seed):
    instance = facing_east(RandomObstacles(8, 8, 0.2, 14).sample(np.random.default_rng(seed)), model)
    plan = LaCAM(anytime=False, seed=seed).solve(instance, time_limit=0.1, edge_weights=weights)
    assert plan is None or validate(instance, plan) is None


def test_it_follows_the_weights():
    instance = drawn("a.A ...")
    move = np.ones((4, 2, 3), np.float32)
    move[0, 0, 0] = 9.0
    plan = LaCAM(anytime=False).solve(instance, edge_weights=GuidanceGraph(move, np.ones((2, 3), np.float32)))
    assert plan.sum_of_costs == 4


@pytest.mark.parametrize("model", MODELS)
def test_same_seed_same_plan(model):
    instance = facing_east(RandomObstacles(8, 8, 0.2, 14).sample(np.random.default_rng(3)), model)
    one, other = (LaCAM(anytime=False, seed=5).solve(instance) for _ in range(2))
    assert np.array_equal(one.positions, other.positions)
    assert model == "cardinal" or np.array_equal(one.headings, other.headings)


@pytest.mark.parametrize("model", MODELS)
def test_agents_that_share_goals_keep_arriving(model):
    env = mapf_pz.parallel_env(
        source=RandomObstacles(8, 8, 0.1, 10), action_model=model, on_target="restart", max_steps=100
    )
    shared = [len(np.unique(env.goals, axis=0)) < 10 for _ in play(env, LaCAM(env, anytime=False), seed=1)]
    assert any(shared)
    assert env.simulator.agents[0]["arrivals"].sum() > 40


@pytest.mark.slow
@pytest.mark.parametrize("model", MODELS)
def test_more_time_gives_shorter_paths_in_a_warehouse(model):
    grid = generate.warehouse(columns=4, rows=6, length=6, depth=2, aisle=1)
    rng = np.random.default_rng(0)
    instance = facing_east(Instance(grid, place(grid, 120, rng)), model)
    first, improved = (
        LaCAM(anytime=anytime, clock="work").solve(instance, time_limit=2.5) for anytime in (False, True)
    )
    assert first is not None
    assert improved is not None
    assert validate(instance, improved) is None
    assert improved.sum_of_costs < 0.7 * first.sum_of_costs


@pytest.mark.parametrize("model", MODELS)
def test_all_reach_their_goals_in_an_environment(model):
    env = mapf_pz.parallel_env(source=RandomObstacles(8, 8, 0.1, 10), action_model=model, max_steps=300)
    assert len(list(play(env, LaCAM(env, anytime=False), seed=1))) < 300
    assert (env.positions == env.goals).all()


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(
    ("name", "agents"), [("random-32-32-20", 200), ("random-32-32-20", 400), ("warehouse-10-20-10-2-1", 500)]
)
def test_benchmark(model, name, agents):
    instance = load_instance(name, "random-1", agents, model)
    plan = LaCAM(anytime=False).solve(instance, time_limit=30.0, max_steps=3000)
    assert plan is not None
    assert validate(instance, plan) is None
    if model == "cardinal":
        assert plan.sum_of_costs >= least_costs(instance).sum()
