"""CBS finds the lowest sum of costs: that of a search over the states of all agents together."""

import csv
import heapq
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapf_pz.cli import main
from mapf_pz.instance import Instance, Scenario
from mapf_pz.instances import RandomObstacles, load_instance
from mapf_pz.planners import CBS, LaCAM, validate
from tests.helpers.text_instances import drawn

STEPS = [(0, 1), (1, 0), (0, -1), (-1, 0)]
MODELS = ["cardinal", "rotate"]


def lowest_cost(instance):
    """Return the lowest sum of costs, or None if there is no solution.

    It is the least cost of a path in the graph of the states of all agents together, by Dijkstra's algorithm. An agent
    at its goal may end, and then stays there without cost; each other agent costs 1 in each step.
    """
    free = {tuple(cell) for cell in np.argwhere(instance.grid.free).tolist()}
    goals = [tuple(goal) for goal in instance.scenario.goals.tolist()]
    headings = [None] * len(goals) if instance.headings is None else instance.headings.tolist()
    starts = [tuple(start) for start in instance.scenario.starts.tolist()]

    def options(agent, state):
        """Yield the states of an agent after a step."""
        cell, heading, ended = state
        yield state
        if ended:
            return
        for turn in (1, 3) if heading is not None else ():
            yield cell, (heading + turn) % 4, False
        for direction in range(4) if heading is None else (heading,):
            after = cell[0] + STEPS[direction][0], cell[1] + STEPS[direction][1]
            if after in free:
                yield after, heading, False

    def endings(states):
        """Yield the states with any of the agents at their goals ended."""
        choices = [
            [state, (*state[:2], True)] if state[0] == goal and not state[2] else [state]
            for state, goal in zip(states, goals, strict=True)
        ]
        yield from product(*choices)

    first = [(start, heading, False) for start, heading in zip(starts, headings, strict=True)]
    queue = [(0, number, states) for number, states in enumerate(endings(first))]
    count, done = len(queue), set()
    while queue:
        cost, _, states = heapq.heappop(queue)
        if all(ended for *_, ended in states):
            return cost
        if states in done:
            continue
        done.add(states)
        cost += sum(not ended for *_, ended in states)
        for after in product(*(options(agent, state) for agent, state in enumerate(states))):
            moves = [(state[0], then[0]) for state, then in zip(states, after, strict=True)]
            cells = {end for _, end in moves}
            if len(cells) == len(moves) and not any((b, a) in moves for a, b in moves if a != b):
                for ended in endings(after):
                    count += 1
                    heapq.heappush(queue, (cost, count, ended))
    return None


def cost_of(instance, **keywords):
    """Return the cost of the plan, which must be legal, or None if there is no plan."""
    plan = CBS().solve(instance, **keywords)
    assert plan is None or validate(instance, plan) is None
    return None if plan is None else plan.sum_of_costs


@pytest.mark.parametrize(
    ("model", "size", "num_agents"),
    [("cardinal", (3, 3), 3), ("cardinal", (2, 4), 3), ("cardinal", (4, 4), 2), ("rotate", (3, 3), 2)],
)
@settings(max_examples=40)
@given(seed=st.integers(0, 2**31))
def test_the_cost_is_the_lowest(model, size, num_agents, seed):
    rng = np.random.default_rng(seed)
    sample = RandomObstacles(*size, 0.2, num_agents).sample(rng)
    headings = rng.integers(4, size=num_agents) if model == "rotate" else None
    instance = Instance(sample.grid, sample.scenario, headings)
    expected = lowest_cost(instance)
    assert cost_of(instance, time_limit=30.0 if expected is not None else 0.05) == expected


@pytest.mark.parametrize(
    ("text", "cost"),
    [
        ("a", 0),
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
    assert cost_of(drawn(text), time_limit=0.1) is None


@pytest.mark.parametrize("model", MODELS)
@settings(max_examples=15)
@given(seed=st.integers(0, 2**31))
def test_no_planner_is_better(model, seed):
    rng = np.random.default_rng(seed)
    sample = RandomObstacles(8, 8, 0.1, 5).sample(rng)
    instance = Instance(sample.grid, sample.scenario, rng.integers(4, size=5) if model == "rotate" else None)
    cost, other = cost_of(instance, time_limit=1.0), LaCAM().solve(instance, time_limit=0.05)
    if cost is not None and other is not None:
        assert cost <= other.sum_of_costs


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
    other = LaCAM().solve(instance, time_limit=0.5)
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
    assert cost_of(instance, time_limit=60.0) == best[num_agents]


def test_the_command(tmp_path, capsys):
    plan = tmp_path / "plan.csv"
    words = ["solve", str(plan), "--planner", "cbs", "--map", "empty-8-8", "--num-agents", "6", "--seed", "3"]
    assert main([*words, "--action-model", "cardinal"]) == 0
    cost = capsys.readouterr().out.split("sum of costs ")[1].split(",")[0]
    with plan.open() as file:
        (row,) = csv.DictReader(file)
    assert row["lower_cost"] == row["solution_cost"] == cost
    words = [*words[:5], "random-16-16-20", "--num-agents", "150", "--time-limit", "0.2"]
    assert main([*words, "--action-model", "cardinal"]) == 1
    message = "mapf-pz solve: cbs found no plan for 150 agents within 0.2 seconds and 1000 steps"
    assert capsys.readouterr().err.splitlines() == [message]
