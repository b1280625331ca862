import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapf_pz.instances import RandomObstacles, load_instance
from mapf_pz.instances.instance import Instance
from mapf_pz.planners import LaCAM, Plan, Trace, validate
from mapf_pz.planners.deadline import Deadline
from mapf_pz.planners.problem import Path
from mapf_pz.planners.sipp.prioritized import PrioritizedSIPP
from mapf_pz.planners.sipp.refine import NeighborhoodSearch, refine
from tests.helpers.hand_clock import HandClock
from tests.helpers.text_instances import drawn, problem

NEVER = Deadline(np.inf)


def plan_of(instance, path):
    return Plan(np.stack(np.divmod(path.cells, instance.grid.shape[1]), axis=-1), path.headings)


def slow_path():
    """Two agents that move sequentially, although each has a separate row; each needs 3 steps."""
    rows = [[0, 4], [1, 4], [2, 4], [3, 4], [3, 4], [3, 5], [3, 6], [3, 6], [3, 7]]
    return drawn("a..A b..B"), Path(np.array(rows, np.int32), None)


def test_a_bad_solution_becomes_the_best():
    instance, path = slow_path()
    assert plan_of(instance, path).sum_of_costs == 11
    trace = Trace(HandClock())
    better = refine(
        NeighborhoodSearch(problem(instance), np.random.default_rng(0)), path, NEVER, trace
    )  # ends because no path can be shorter
    assert trace.solutions[-1].sum_of_costs == 6
    assert plan_of(instance, better).sum_of_costs == 6
    assert validate(instance, plan_of(instance, better)) is None


@pytest.mark.parametrize(
    "rows",
    [
        [[0, 4], [0, 5], [1, 6], [2, 7], [3, 7]],
        [[0, 4], [1, 4], [2, 5], [3, 6], [3, 7]],
        [[0, 4], [0, 4], [1, 5], [2, 6], [3, 7]],
        [[0, 4], [1, 4], [2, 4], [2, 5], [2, 6], [3, 7]],
    ],
)
def test_delayed_agents_become_early(rows):
    search = NeighborhoodSearch(problem(drawn("a..A b..B")), np.random.default_rng(0))
    search.set_paths(Path(np.array(rows, np.int32), None))
    assert not search.is_shortest
    search.improve(work=1000)
    assert search.sum_of_costs == 6
    assert search.is_shortest


def test_a_deadline_in_the_past_changes_nothing():
    instance, path = slow_path()
    search = NeighborhoodSearch(problem(instance), np.random.default_rng(0))
    assert refine(search, path, Deadline(-1), Trace(HandClock())) is path


def test_an_optimal_solution_does_not_change():
    instance = drawn("a..A b..B")
    path = Path(np.array([[0, 4], [1, 5], [2, 6], [3, 7]], np.int32), None)
    assert (
        refine(NeighborhoodSearch(problem(instance), np.random.default_rng(0)), path, NEVER, Trace(HandClock())) is path
    )


def test_no_agents_to_plan_for():
    one = problem(drawn("a.A"))
    none = one._replace(starts=one.starts[:0], headings=one.headings[:0], goals=one.goals[:0], table=one.table[:0])
    path = PrioritizedSIPP().plan(none, 1000)
    assert path is not None
    assert path.cells.shape == (1, 0)


@pytest.mark.parametrize("model", ["cardinal", "rotate"])
@pytest.mark.parametrize("weights", ["uniform", "crisscross", "random"])
@settings(max_examples=10)
@given(seed=st.integers(0, 2**31))
def test_paths_stay_legal_and_get_no_longer(model, weights, seed):
    rng = np.random.default_rng(seed)
    instance = RandomObstacles(8, 8, 0.1, 12).sample(rng)
    if model == "rotate":
        instance = Instance(instance.grid, instance.scenario, rng.integers(4, size=12))
    path = PrioritizedSIPP(anytime=False).plan(problem(instance, weights), 1.0)
    if path is None:
        return
    search = NeighborhoodSearch(problem(instance, weights), rng)
    search.set_paths(path)
    cost = plan_of(instance, path).sum_of_costs
    for _ in range(20):
        search.improve(work=50)
        plan = plan_of(instance, search.path())
        assert validate(instance, plan) is None
        assert plan.sum_of_costs == search.sum_of_costs <= cost
        cost = search.sum_of_costs


def test_a_benchmark_instance():
    instance = load_instance("random-32-32-20", "random-1", 100, "cardinal")
    plan = LaCAM(anytime=False).solve(instance, time_limit=60)
    assert plan is not None
    path = Path((plan.positions @ np.array([instance.grid.shape[1], 1])).astype(np.int32), None)
    clock = HandClock(pace=0.004)
    search = NeighborhoodSearch(problem(instance), np.random.default_rng(0))
    better = refine(search, path, Deadline(1, clock), Trace(clock))
    assert validate(instance, plan_of(instance, better)) is None
    assert 2253 <= plan_of(instance, better).sum_of_costs <= plan.sum_of_costs  # the best known lower bound
