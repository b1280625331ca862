import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mapf_pz
from mapf_pz import GuidanceGraph
from mapf_pz.instances import RandomObstacles
from mapf_pz.instances.instance import Grid, Instance, Scenario
from mapf_pz.instances.sources import InstanceList
from mapf_pz.planners import Plan, validate, violations

EAST, SOUTH, WEST, NORTH = range(4)


def instance(starts, goals, free=((1, 1, 1), (1, 0, 1)), headings=None):
    return Instance(Grid(np.array(free, bool), "small"), Scenario(np.array(starts), np.array(goals)), headings)


def violation_of(starts, goals, cells, headings=None, **keywords):
    violation = validate(instance(starts, goals, **keywords), Plan(np.array(cells), headings))
    return None if violation is None else str(violation)


def test_a_legal_plan():
    assert violation_of([(0, 0)], [(0, 2)], [[(0, 0)], [(0, 1)], [(0, 2)]]) is None


@pytest.mark.parametrize(
    ("cells", "expected"),
    [
        ([[(0, 1)], [(0, 2)]], "step 0: agent 0 at [row 0, col 1]: not the instance's start"),
        ([[(0, 0)], [(1, 0)], [(1, 1)]], "step 2: agent 0 at [row 1, col 1]: an obstacle, or outside the map"),
        ([[(0, 0)], [(-1, 0)], [(0, 2)]], "step 1: agent 0 at [row -1, col 0]: an obstacle, or outside the map"),
        (
            [[(0, 0)], [(0, 2)]],
            "step 1: agent 0 at [row 0, col 2]: not a move to an adjacent cell, or not straight ahead",
        ),
        ([[(0, 0)], [(0, 1)]], "step 1: agent 0 at [row 0, col 1]: not the agent's goal"),
    ],
)
def test_violations_of_one_agent(cells, expected):
    assert violation_of([(0, 0)], [(0, 2)], cells) == expected


@pytest.mark.parametrize(
    ("cells", "headings", "expected"),
    [
        ([(0, 0), (0, 1)], [EAST, EAST], None),
        ([(0, 0), (0, 0), (0, 1)], [SOUTH, EAST, EAST], None),
        ([(0, 0), (0, 0), (0, 1)], [NORTH, EAST, EAST], None),
        ([(0, 0), (0, 1)], [SOUTH, SOUTH], "step 1: agent 0 at [row 0, col 1]: not a move to an adjacent"),
        ([(0, 0), (0, 0), (0, 1)], [WEST, EAST, EAST], "step 1: agent 0 at [row 0, col 0]: more than a quarter turn"),
        ([(0, 0), (0, 1)], [EAST, SOUTH], "step 1: agent 0 at [row 0, col 1]: more than a quarter turn, or a"),
    ],
)  # fmt: skip
def test_turns(cells, headings, expected):
    violation = violation_of([(0, 0)], [(0, 1)], np.array(cells)[:, None], np.array(headings)[:, None])
    assert (violation is None) if expected is None else violation.startswith(expected)


def test_headings_at_the_start():
    plan = Plan(np.zeros((1, 1, 2)), np.array([[EAST]]))
    assert validate(instance([(0, 0)], [(0, 0)], headings=[EAST]), plan) is None
    assert validate(instance([(0, 0)], [(0, 0)], headings=[WEST]), plan).kind == "start"


def test_two_on_one_cell():
    cells = [[(0, 0), (0, 2)], [(0, 1), (0, 1)]]
    expected = "step 1: agent 0 and agent 1 at [row 0, col 1]: two agents on one cell"
    assert violation_of([(0, 0), (0, 2)], [(0, 1), (0, 2)], cells) == expected


def test_a_swap():
    cells = [[(0, 0), (0, 1)], [(0, 1), (0, 0)]]
    expected = "step 1: agent 0 and agent 1 at [row 0, col 1] and [row 0, col 0]: two agents swap cells"
    assert violation_of([(0, 0), (0, 1)], [(0, 1), (0, 0)], cells) == expected


def test_following_and_cycles_are_allowed():
    square = [(0, 0), (0, 1), (1, 1), (1, 0)]
    turned = square[1:] + square[:1]
    assert violation_of(square, turned, [square, turned], free=((1, 1), (1, 1))) is None


def test_the_first_violation_is_returned():
    cells = [[(0, 0), (1, 2)], [(0, 1), (1, 2)], [(0, 1), (1, 1)], [(0, 2), (0, 2)]]
    assert violation_of([(0, 0), (1, 2)], [(0, 2), (1, 2)], cells).startswith("step 2: agent 1")


def test_costs():
    plan = Plan(np.array([[(0, 0), (0, 2)], [(0, 1), (0, 2)], [(0, 0), (0, 2)], [(0, 1), (0, 2)], [(0, 1), (0, 2)]]))
    assert (plan.num_steps, plan.num_agents) == (4, 2)
    assert plan.costs.tolist() == [3, 1]
    assert (plan.sum_of_costs, plan.makespan) == (4, 3)


def test_weighted_cost():
    move = np.array([2.0, 4, 8, 16])[:, None, None] * np.ones((4, 2, 3))
    graph = GuidanceGraph(move, np.array([[0.25, 0.5, 1], [1, 1, 1]]))
    cells = [[(0, 0), (0, 2)], [(0, 1), (0, 2)], [(0, 1), (0, 2)], [(1, 1), (0, 2)], [(0, 1), (0, 2)]]
    assert Plan(np.array(cells)).weighted_cost(graph) == (2 + 0.5 + 4 + 16) + 1  # the second agent stays
    headings = np.array([[EAST, EAST, SOUTH, SOUTH, WEST]]).T.repeat(2, axis=1)
    waits = [cells[0], cells[1], cells[1], cells[3], cells[3]]
    assert Plan(np.array(waits), headings).weighted_cost(graph) == (2 + 0.5 + 4) + 1  # the last turn is free
    assert Plan(np.array(cells[:1])).weighted_cost(graph) == 0.25 + 1
    move[1] = np.inf
    assert Plan(np.array(cells)).weighted_cost(GuidanceGraph(move, graph.wait)) == np.inf


@pytest.mark.parametrize("cells", [[(0, 2), (0, 3)], [(0, 0), (-1, 0)], [(0, 0), (0, 2)], [(0, 0), (1, 1)]])
def test_the_weighted_cost_of_impossible_moves(cells):
    graph = GuidanceGraph.uniform(np.ones((2, 3), bool))
    with pytest.raises(ValueError, match=r"plan: expected moves between adjacent cells of a map of \(2, 3\) cells"):
        Plan(np.array(cells)[:, None]).weighted_cost(graph)


def test_wrong_shapes_are_rejected():
    with pytest.raises(ValueError, match=r"plan positions: expected the shape \(T \+ 1, N, 2\), got \(2, 2\)"):
        Plan(np.zeros((2, 2)))
    with pytest.raises(ValueError, match=r"plan headings: expected the shape \(3, 1\), got \(3,\)"):
        Plan(np.zeros((3, 1, 2)), np.zeros(3))
    with pytest.raises(ValueError, match="plan: 2 agents, but the instance has 1"):
        validate(instance([(0, 0)], [(0, 1)]), Plan(np.zeros((1, 2, 2))))


@given(st.integers(0, 2**31), st.sampled_from(["rotate", "cardinal"]))
def test_any_episode_is_legal_except_for_the_goals(seed, action_model):
    env = mapf_pz.parallel_env(source=RandomObstacles(6, 6, 0.2, 6), max_steps=12, action_model=action_model)
    env.reset(seed=seed)
    cells, headings = [env.positions], [env.headings]
    instance = Instance(Grid(env.grid), Scenario(env.positions, env.goals), env.headings)
    rng = np.random.default_rng(seed)
    while env.agents:
        env.step({agent: int(rng.integers(env.action_space(agent).n)) for agent in env.agents})
        cells.append(env.positions)
        headings.append(env.headings)
    plan = Plan(np.array(cells), np.array(headings) if action_model == "rotate" else None)
    violation = validate(instance, plan)
    assert violation is None or violation.kind == "goal"


def all_violations(instance, plan):
    """Return all violations (step, kind, agents) by comparing all pairs of agents, in any order."""
    found = []
    cells = [[tuple(cell) for cell in step] for step in plan.positions.tolist()]
    free = {tuple(cell) for cell in np.argwhere(instance.grid.free).tolist()}
    agents = range(plan.num_agents)
    for step, now in enumerate(cells):
        before = cells[step - 1]
        for i in agents:
            if step == 0 and now[i] != tuple(instance.scenario.starts[i]):
                found.append((0, "start", (i,)))
            if step == plan.num_steps and now[i] != tuple(instance.scenario.goals[i]):
                found.append((step, "goal", (i,)))
            if now[i] not in free:
                found.append((step, "map", (i,)))
            if step and abs(now[i][0] - before[i][0]) + abs(now[i][1] - before[i][1]) > 1:
                found.append((step, "move", (i,)))
            first = now.index(now[i])
            if first < i:
                found.append((step, "vertex", (first, i)))
            found += [
                (step, "edge", (i, j))
                for j in agents
                if step and i < j and now[i] == before[j] and now[j] == before[i] and now[i] != before[i]
            ]
    return found


@given(st.integers(0, 2**31))
def test_all_violations_are_those_of_all_pairs_of_agents(seed):
    rng = np.random.default_rng(seed)
    plan = Plan(rng.integers(-1, 3, size=(5, 4, 2)))
    problem = instance([(0, 0), (0, 1), (0, 2), (1, 0)], [(0, 2), (1, 2), (0, 0), (1, 0)])
    found = violations(problem, plan)
    assert sorted((item.step, item.kind, item.agents) for item in found) == sorted(all_violations(problem, plan))
    assert [item.step for item in found] == sorted(item.step for item in found)
    assert found[0] == validate(problem, plan)


def test_all_violations_of_turns():
    headings = np.array([[EAST], [WEST], [EAST], [EAST]])
    problem = instance([(0, 0)], [(0, 1)], headings=[EAST])
    plan = Plan(np.array([[(0, 0)], [(0, 0)], [(0, 0)], [(0, 1)]]), headings)
    assert [(item.step, item.kind) for item in violations(problem, plan)] == [(1, "turn"), (2, "turn")]
    legal = Plan(np.array([[(0, 0)], [(0, 1)]]), np.array([[EAST], [EAST]]))
    assert violations(problem, legal) == []


@given(st.integers(0, 2**31), st.sampled_from(["rotate", "cardinal"]))
def test_the_environment_counts_the_same_weighted_cost(seed, action_model):
    """In an episode whose agents have the cells as goals on which they end."""
    rng, free = np.random.default_rng(seed), np.ones((4, 4), bool)
    graph = GuidanceGraph.random(free, rng)
    keywords = {"edge_weights": graph, "action_model": action_model, "max_steps": 12}
    env = mapf_pz.parallel_env(map=free, num_agents=5, **keywords)
    env.reset(seed=seed)
    cells, headings, actions = [env.positions], [env.headings], []
    while env.agents:
        actions.append({agent: int(rng.integers(env.action_space(agent).n)) for agent in env.agents})
        env.step(actions[-1])
        cells.append(env.positions)
        headings.append(env.headings)
    plan = Plan(np.array(cells), np.array(headings) if action_model == "rotate" else None)
    replayed = Instance(
        Grid(free), Scenario(cells[0], cells[-1]), plan.headings[0] if plan.headings is not None else None
    )
    env = mapf_pz.parallel_env(source=InstanceList([replayed]), **keywords)
    env.reset()
    for action in actions:
        if env.agents:  # they may all be at their ends, for a while, before
            env.step(action)
    if env.step_count == len(actions):
        assert env.metrics()["SoC"] == plan.sum_of_costs
        assert env.metrics()["weighted_cost"] == pytest.approx(plan.weighted_cost(graph))
