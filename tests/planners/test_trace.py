"""The solutions that planners find over time."""

import csv

import pytest

import mapf_pz
from mapf_pz.commands.main import main
from mapf_pz.instances import load_instance
from mapf_pz.planners import PIBT, PLANNERS, LaCAM, PrioritizedSIPP, Trace


@pytest.mark.parametrize("action_model", ["cardinal", "rotate"])
@pytest.mark.parametrize("kind", [LaCAM, PrioritizedSIPP])
def test_the_costs_decrease_to_that_of_the_plan(kind, action_model):
    instance = load_instance("random-16-16-20", None, 40, action_model, seed=1)
    planner = kind()
    planner.compile(action_model)
    plan = planner.solve(instance, time_limit=1.0)
    seconds, costs = zip(*planner.trace.solutions, strict=True)
    assert len(costs) > 3
    assert list(costs) == sorted(set(costs), reverse=True)
    assert costs[-1] == plan.sum_of_costs
    assert list(seconds) == sorted(seconds)
    assert 0 < seconds[0] < seconds[-1] < 1.1


@pytest.mark.parametrize("name", PLANNERS)
def test_every_planner_has_at_least_its_plan(name):
    instance = load_instance("empty-8-8", None, 4, seed=2)
    planner = PLANNERS[name]()
    assert planner.trace.solutions == []
    plan = planner.solve(instance, time_limit=0.2)
    assert planner.trace.solutions[-1].sum_of_costs == plan.sum_of_costs
    again = planner.solve(instance, time_limit=0.2)
    assert planner.trace.solutions[-1].sum_of_costs == again.sum_of_costs  # of this call only
    assert planner.trace.solutions[-1].seconds < 0.3


def test_without_a_plan_there_is_no_solution():
    planner = PIBT()
    planner.solve(load_instance("empty-8-8", None, 4), time_limit=1)
    assert planner.solve(load_instance("empty-8-8", None, 4), max_steps=1, time_limit=1) is None
    assert planner.trace.solutions == []


def test_the_latest_plan_of_an_episode():
    env = mapf_pz.parallel_env(map="random-16-16-20", num_agents=8, max_steps=100, action_model="cardinal")
    planner = LaCAM(env, time_limit=0.05)
    observations, _ = env.reset(seed=0)
    planner.reset_states()
    while env.agents:
        observations = env.step(planner.act(observations))[0]
    assert env.metrics()["SoC"] == planner.trace.solutions[-1].sum_of_costs


def test_only_better_solutions_are_added():
    now = [10.0]
    trace = Trace(lambda: now[0])
    for seconds, cost in ((1, 9), (2, 9), (3, 8), (4, 10), (5, 7)):
        now[0] = 10.0 + seconds
        trace.add(cost)
    assert trace.solutions == [(1, 9), (3, 8), (5, 7)]


def test_the_command(tmp_path, capsys):
    file = tmp_path / "new" / "trace.csv"
    words = ["--map", "random-16-16-20", "--num-agents", "40", "--planner", "lacam", "--time-limit", "0.5"]
    assert main(["solve", str(tmp_path / "plan.json"), *words, "--trace", str(file)]) == 0
    out = capsys.readouterr().out
    with file.open() as lines:
        rows = list(csv.DictReader(lines))
    assert len(rows) > 1
    assert f"sum of costs {rows[-1]['sum_of_costs']}, " in out
    assert 0 < float(rows[0]["seconds"]) < float(rows[-1]["seconds"]) < 1
