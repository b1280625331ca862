"""What all planners guarantee: their plans are valid, and no move is blocked."""

import inspect

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mapf_pz
from mapf_pz.instances import InstanceList, RandomObstacles
from mapf_pz.instances.instance import Grid, Instance, Scenario
from mapf_pz.planners import PLANNERS, LaCAM, Plan, validate
from mapf_pz.simulator.actions import Action
from tests.helpers.episodes import play
from tests.helpers.joint_search import lowest_cost
from tests.helpers.text_instances import drawn

MODELS = ["rotate", "cardinal"]
WEIGHTS = ["uniform", "random", "crisscross"]


def quick(name):
    """Return the options with which a planner is fastest."""
    known = inspect.signature(PLANNERS[name]).parameters
    if "anytime" in known:
        return {"anytime": False, "time_limit": 0.5}
    return {"time_limit": 0.02} if name == "cbs" else {}


@pytest.mark.parametrize("name", list(PLANNERS))
@pytest.mark.parametrize("model", MODELS)
@settings(max_examples=15)
@given(seed=st.integers(0, 2**31), weights=st.sampled_from(WEIGHTS), num_agents=st.integers(1, 10))
def test_solutions_are_valid(name, model, seed, weights, num_agents):
    rng = np.random.default_rng(seed)
    drawn = RandomObstacles(6, 6, 0.2, num_agents).sample(rng)
    headings = rng.integers(4, size=num_agents) if model == "rotate" else None
    instance = Instance(drawn.grid, drawn.scenario, headings)
    plan = PLANNERS[name](seed=seed, **quick(name)).solve(instance, time_limit=0.5, max_steps=300, edge_weights=weights)
    if plan is not None:
        assert validate(instance, plan) is None
        assert plan.num_steps <= 300


@pytest.mark.parametrize("name", list(PLANNERS))
@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("on_target", ["nothing", "restart", "finish"])
@settings(max_examples=8)
@given(seed=st.integers(0, 2**31), weights=st.sampled_from(WEIGHTS))
def test_every_step_is_valid_and_not_blocked(name, model, on_target, seed, weights):
    env = mapf_pz.parallel_env(
        source=RandomObstacles(6, 6, 0.2, 6),
        action_model=model,
        edge_weights=weights,
        on_target=on_target,
        max_steps=25,
    )
    env.reset(seed=seed)
    starts, first_headings = env.positions, env.headings
    cells, headings = [starts], [first_headings]
    for _ in play(env, PLANNERS[name](env, seed=seed, **quick(name)), seed):
        cells.append(env.positions)
        headings.append(env.headings)
    rotates = model == "rotate"
    if on_target == "finish":
        return  # agents that have disappeared may share a cell
    # As if each agent had several goals, so that none must be reached at the end.
    instance = Instance(Grid(env.grid), Scenario(starts, starts[:, None]), first_headings if rotates else None)
    assert validate(instance, Plan(np.array(cells), np.array(headings) if rotates else None)) is None


def played(name, instance):
    """Return the metrics of an episode in which agents disappear at their goals."""
    env = mapf_pz.parallel_env(
        source=InstanceList([instance]),
        action_model="cardinal" if instance.headings is None else "rotate",
        on_target="finish",
        max_steps=60,
    )
    assert len(list(play(env, PLANNERS[name](env, **WHOLE_PATHS[name]), seed=0))) > 0
    return env.metrics()


WHOLE_PATHS = {
    "lacam": {"time_limit": 0.1, "clock": "work"},
    "prioritized": {"time_limit": 0.1, "clock": "work"},
    "cbs": {"time_limit": 600.0},
}
"""Planners of whole paths, with options under which their results do not depend on the machine."""


@pytest.mark.parametrize("name", ["pibt", "epibt", "windowed"])
@pytest.mark.parametrize("model", MODELS)
def test_the_seed_determines_the_actions(name, model):
    rules = {"action_model": model, "on_target": "restart", "max_steps": 20}
    env = mapf_pz.parallel_env(source=RandomObstacles(8, 8, 0.1, 20), **rules)
    first, again, other = (list(play(env, PLANNERS[name](env, seed=seed), seed=0)) for seed in (3, 3, 4))
    assert first == again
    assert name == "epibt" or first != other  # `EPIBT` breaks no ties at random


@pytest.mark.parametrize("name", ["epibt", "windowed"])
def test_planners_that_keep_paths_notice_a_new_episode(name):
    env = mapf_pz.parallel_env(source=RandomObstacles(8, 8, 0.2, 8), max_steps=10)
    planner = PLANNERS[name](env, **quick(name))
    for seed in (0, 1):
        assert len(list(play(env, planner, seed))) > 0


@pytest.mark.parametrize("name", WHOLE_PATHS)
@pytest.mark.parametrize(
    ("text", "cost"),
    [
        ("ba.A..B", 2 + 6),  # b passes the goal of a, which is gone
        ("b.a.B", 1 + 4),  # a starts at its goal, and is gone when b passes
        ("ba.B", 1 + 4),
        ("bcaACB", 1 + 3 + 5),
        ("aB.bA ##.##", 4 + 4),
    ],
)
def test_agents_that_disappear_make_way(name, text, cost):
    instance = drawn(text)
    assert lowest_cost(instance, disappear=True) == cost
    metrics = played(name, instance)
    assert (metrics["CSR"], metrics["SoC"]) == (1, cost)


@pytest.mark.parametrize("name", WHOLE_PATHS)
def test_agents_that_disappear_may_share_a_goal(name):
    grid = drawn("a...").grid
    instance = Instance(grid, Scenario(np.array([[0, 0], [0, 1], [0, 3]]), np.array([[0, 3]] * 3)))
    metrics = played(name, instance)
    assert (metrics["CSR"], metrics["SoC"]) == (1, 1 + 2 + 3)


def small_instance(model, size, num_agents, seed):
    """Return an instance in which some agents start at their goals, and some share a goal."""
    rng = np.random.default_rng(seed)
    sample = RandomObstacles(*size, 0.2, num_agents).sample(rng)
    starts, goals = sample.scenario.starts, sample.scenario.goals.copy()
    at_goal, shared = rng.integers(num_agents, size=2)
    if rng.random() < 0.5:
        goals[at_goal] = starts[at_goal]
    if rng.random() < 0.5:
        goals[shared] = goals[0]
    headings = rng.integers(4, size=num_agents) if model == "rotate" else None
    return Instance(sample.grid, Scenario(starts, goals), headings)


SIZES = [
    ("cardinal", (3, 3), 3),
    pytest.param("cardinal", (1, 6), 3, marks=pytest.mark.slow),
    ("cardinal", (2, 4), 3),
    ("rotate", (2, 3), 2),
]


@pytest.mark.parametrize(("model", "size", "num_agents"), SIZES)
@settings(max_examples=15)
@given(seed=st.integers(0, 2**31))
def test_plans_of_agents_that_disappear(model, size, num_agents, seed):
    instance = small_instance(model, size, num_agents, seed)
    best = lowest_cost(instance, disappear=True)
    for name in WHOLE_PATHS:
        metrics = played(name, instance)
        if best is None or metrics["CSR"] == 0:
            assert metrics["CSR"] == (best is not None and name != "prioritized")
        else:
            assert metrics["SoC"] >= best
            assert name != "cbs" or metrics["SoC"] == best


@pytest.mark.parametrize("name", list(PLANNERS))
@pytest.mark.parametrize(
    ("instance", "reason"),
    [
        (drawn("a#A b#B"), "agent 0 cannot reach its goal"),
        (
            Instance(
                drawn("a..b").grid, Scenario(np.array([[0, 0], [0, 3], [0, 1]]), np.array([[0, 1], [0, 2]] * 2)[:3])
            ),
            "agents 0 and 2 have the same goal",
        ),
    ],
)
def test_planners_say_why_there_is_no_plan(name, instance, reason):
    planner = PLANNERS[name](**quick(name))
    assert planner.solve(instance, time_limit=600.0) is None
    assert planner.unsolvable == reason
    assert planner.solve(drawn("a.A"), time_limit=600.0) is not None
    assert planner.unsolvable is None


@pytest.mark.parametrize(
    ("name", "reason"),
    [("lacam", "the search has visited all configurations"), ("cbs", "the search has excluded all paths")],
)
def test_a_complete_search_proves_that_there_is_no_plan(name, reason):
    planner = PLANNERS[name]()
    assert planner.solve(drawn("aB.bA"), time_limit=600.0) is None
    assert planner.unsolvable == reason
    assert planner.solve(drawn("aB.bA"), time_limit=0.0) is None
    assert planner.unsolvable is None


def test_after_a_failure_it_plans_again_later():
    class Late(LaCAM):
        """Finds no plan in the first three attempts."""

        attempts = ()

        def plan(self, problem, time_limit):
            self.attempts = (*self.attempts, len(played))
            return super().plan(problem, time_limit) if len(self.attempts) > 3 else None

    played = []
    env = mapf_pz.parallel_env(map="empty-8-8", num_agents=4, max_steps=40)
    planner = Late(env, anytime=False)
    planner.compile("rotate")  # it plans, too
    planner.attempts = ()
    for actions in play(env, planner, seed=0):
        played.append(set(actions.values()))
    assert planner.attempts == (0, 1, 3, 7)
    assert played[:7] == [{Action.WAIT}] * 7
    assert played[7] != {Action.WAIT}
    assert env.metrics()["CSR"] == 1
