"""CBS finds the lowest sum of costs: that of a search over the states of all agents together."""

import csv
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapf_pz.commands.main import main
from mapf_pz.instances import RandomObstacles, load_instance
from mapf_pz.instances.instance import Instance, Scenario
from mapf_pz.planners import CBS, LaCAM, validate
from tests.helpers.joint_search import lowest_cost
from tests.helpers.text_instances import drawn

MODELS = ["cardinal", "rotate"]


def cost_of(instance, **keywords):
    """Return the cost of the plan, which must be legal, or None if there is no plan."""
    plan = CBS().solve(instance, **({"time_limit": math.inf} | keywords))
    assert plan is None or validate(instance, plan) is None
    return None if plan is None else plan.sum_of_costs


@pytest.mark.parametrize(
    ("model", "size", "num_agents"),
    [("cardinal", (3, 3), 3), ("cardinal", (2, 4), 3), ("cardinal", (4, 4), 2), ("rotate", (3, 3), 2)],
)
@settings(max_examples=20)
@given(seed=st.integers(0, 2**31))
def test_the_cost_is_the_lowest(model, size, num_agents, seed):
    rng = np.random.default_rng(seed)
    sample = RandomObstacles(*size, 0.2, num_agents).sample(rng)
    headings = rng.integers(4, size=num_agents) if model == "rotate" else None
    instance = Instance(sample.grid, sample.scenario, headings)
    assert cost_of(instance) == lowest_cost(instance)


@pytest.mark.parametrize(
    ("text", "cost"),
    [
        ("a", 1),
        ("aA bB", 2),
        (".b. a.A .B.", 2 + 2 + 1),  # one waits
        ("a.b.A ##.##", 4 + 3),  # b leaves its goal for a
        ("aBbA ##.#", 7),  # one makes room for the other
    ],
)
def test_drawings(text, cost):
    assert cost_of(drawn(text)) == lowest_cost(drawn(text)) == cost


@pytest.mark.parametrize("text", ["aB.bA", "a.b.A"])
def test_drawings_without_a_solution(text):
    assert lowest_cost(drawn(text)) is None
    assert cost_of(drawn(text)) is None


@pytest.mark.parametrize("model", MODELS)
@settings(max_examples=10)
@given(seed=st.integers(0, 2**31))
def test_no_planner_is_better(model, seed):
    rng = np.random.default_rng(seed)
    sample = RandomObstacles(8, 8, 0.1, 4).sample(rng)
    instance = Instance(sample.grid, sample.scenario, rng.integers(4, size=4) if model == "rotate" else None)
    other = LaCAM(anytime=False).solve(instance, time_limit=math.inf)
    assert cost_of(instance) <= other.sum_of_costs


@pytest.mark.parametrize("model", MODELS)
def test_agents_that_pass_through_a_corridor_together(model):
    """Splitting one conflict after the other does not end here: the agents are merged."""
    grid = drawn("ab.. #... .##. ....").grid
    scenario = Scenario(np.array([[2, 0], [2, 3]]), np.array([[3, 1], [3, 0]]))
    instance = Instance(grid, scenario, np.zeros(2, np.int64) if model == "rotate" else None)
    assert cost_of(instance) == lowest_cost(instance) == {"cardinal": 24, "rotate": 35}[model]


def test_three_agents_of_one_group():
    instance = drawn("abc CBA ##.")
    assert cost_of(instance) == lowest_cost(instance) == 9


def test_costs_are_steps_whatever_the_weights_are():
    instance = load_instance("random-16-16-20", None, 6, "cardinal", seed=1)
    assert cost_of(instance) == cost_of(instance, edge_weights="random")


def test_a_long_path_needs_more_rows():
    """One agent, on a path of more steps than the search has rows at first."""
    rows = [
        "." * 20 if row % 2 == 0 else ("." if row % 4 == 3 else "#" * 19 + ".")[:20].ljust(20, "#") for row in range(13)
    ]
    rows[0] = "a" + rows[0][1:]
    rows[12] = rows[12][:-1] + "A" if rows[11].startswith(".") else "A" + rows[12][1:]
    instance = drawn("\n".join(rows))
    other = LaCAM(anytime=False).solve(instance, time_limit=math.inf)
    assert cost_of(instance) == other.sum_of_costs > 100


def test_agents_with_the_same_goal_have_no_plan():
    grid = drawn("a...").grid
    instance = Instance(grid, Scenario(np.array([[0, 0], [0, 3]]), np.array([[0, 1], [0, 1]])))
    assert cost_of(instance) is None


@pytest.mark.parametrize(("name", "num_agents"), [("random-32-32-20", 20), ("empty-16-16", 15), ("maze-32-32-4", 6)])
def test_the_tracker_knows_no_lower_cost(benchmark, name, num_agents):
    file = benchmark / "costs" / f"tracker-bounds-{name}.csv"
    instance = load_instance(
        benchmark / "maps" / f"{name}.map", benchmark / "scens" / f"{name}-random-1.scen", num_agents, "cardinal"
    )
    with file.open(encoding="utf-8-sig", newline="") as lines:
        best = {
            int(row["agents"]): int(row["solution_cost"])
            for row in csv.DictReader(lines)
            if (row["scen_type"], row["type_id"]) == ("random", "1") and row["solution_cost"]
        }
    assert cost_of(instance) == best[num_agents]


def test_the_command(tmp_path, capsys):
    plan = tmp_path / "plan.csv"
    words = ["solve", str(plan), "--planner", "cbs", "--map", "empty-8-8", "--num-agents", "6", "--seed", "3"]
    assert main([*words, "--action-model", "cardinal"]) == 0
    cost = capsys.readouterr().out.split("sum of costs ")[1].split(",")[0]
    with plan.open() as file:
        (row,) = csv.DictReader(file)
    assert row["lower_cost"] == row["solution_cost"] == cost
    words = [*words[:5], "random-16-16-20", "--num-agents", "150", "--time-limit", "0"]
    assert main([*words, "--action-model", "cardinal"]) == 1
    message = "mapf-pz solve: cbs found no plan for 150 agents within 0 seconds and 1000 steps"
    assert capsys.readouterr().err.splitlines() == [message]
