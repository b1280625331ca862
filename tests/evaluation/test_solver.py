"""Solvers by name: a policy's plan is its steps in the environment."""

import numpy as np
import pytest

from mapf_pz import EnvConfig, Instance, Scenario
from mapf_pz.evaluation import solver_of
from mapf_pz.instances.library import load_map
from mapf_pz.planners import validate
from mapf_pz.simulator.source import sample_instance


def instance(action_model: str, num_agents: int = 6) -> Instance:
    return sample_instance(EnvConfig(map="random-16-16-20", num_agents=num_agents, action_model=action_model), seed=4)


def test_a_planner_is_the_planner():
    problem = instance("rotate")
    plan = solver_of("pibt", seed=3).solve(problem)
    assert plan is not None
    assert validate(problem, plan) is None


@pytest.mark.parametrize(
    ("name", "action_model"), [("mappo+pibt", "rotate"), ("mappo-cardinal:temperature=0", "cardinal")]
)
def test_a_policy_solves_an_instance(name, action_model):
    pytest.importorskip("torchrl")
    problem, solver = instance(action_model), solver_of(name)
    plan = solver.solve(problem)
    assert plan is not None
    assert validate(problem, plan) is None
    assert (plan.headings is None) == (action_model == "cardinal")
    assert [solution.sum_of_costs for solution in solver.trace.solutions] == [plan.sum_of_costs]
    again = solver_of(name).solve(problem)
    assert again is not None
    assert np.array_equal(plan.positions, again.positions)


def test_without_a_plan_the_steps_are_returned_only_if_wanted():
    problem, solver = instance("rotate"), solver_of("random", seed=1)
    assert solver.solve(problem, max_steps=5) is None
    steps = solver.solve(problem, max_steps=5, partial=True)
    assert steps is not None
    assert steps.num_steps == 5
    assert steps.away(problem).any()
    assert not solver.trace.solutions
    violation = validate(problem, steps)
    assert violation is not None
    assert violation.kind == "goal"


def test_a_time_limit_that_has_passed_leaves_the_start():
    problem = instance("rotate")
    steps = solver_of("random").solve(problem, time_limit=0.0, partial=True)
    assert steps is not None
    assert steps.positions.tolist() == [problem.scenario.starts.tolist()]


def test_agents_at_their_goals_need_no_step():
    grid = load_map("empty-8-8")
    cells = np.array([[1, 2], [3, 4]])
    plan = solver_of("random").solve(Instance(grid, Scenario(cells, cells), np.zeros(2, np.int64)))
    assert plan is not None
    assert (plan.num_steps, plan.sum_of_costs) == (0, 2)


def test_errors_name_what_was_expected():
    with pytest.raises(ValueError, match="policy 'nobody': expected random, a planner"):
        solver_of("nobody")
    pytest.importorskip("torchrl")
    with pytest.raises(ValueError, match="requires action_model='rotate', got 'cardinal'"):
        solver_of("mappo").solve(instance("cardinal"))
