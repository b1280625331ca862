import json
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mapf_pz
from mapf_pz.errors import FormatError
from mapf_pz.instances import InstanceList, RandomObstacles
from mapf_pz.instances.instance import Grid, Instance, Scenario
from mapf_pz.planners import (
    CBS,
    PIBT,
    DependencyGraph,
    Execution,
    LaCAM,
    Plan,
    PrioritizedSIPP,
    SwitchableExecution,
    planner_of,
    validate,
)
from mapf_pz.planners.base import Steps, simulator_of
from mapf_pz.planners.plans.dependencies import NONE
from mapf_pz.planners.problem import Path
from mapf_pz.simulator.actions import Action, wait_action
from tests.helpers.episodes import play
from tests.helpers.text_instances import drawn

MODELS = ["cardinal", "rotate"]
STEPS = {"R": (0, 1), "D": (1, 0), "L": (0, -1), "U": (-1, 0), "W": (0, 0)}


def moving(text, words):
    """Return the instance of a drawing, and the plan of cardinal agents with a letter for each step."""
    instance = drawn(text)
    steps = np.array([[STEPS[letter] for letter in word] for word in words]).swapaxes(0, 1)
    starts = instance.scenario.starts
    return instance, Plan(np.concatenate([starts[None], starts + steps.cumsum(axis=0)]))


def graph_of(text, words):
    instance, plan = moving(text, words)
    return DependencyGraph.from_plan(plan, instance)


def delays(*rows):
    """Return who is delayed in each step; a row has an `x` for each delayed agent."""
    return np.array([[mark == "x" for mark in row] for row in rows])


def cols(plan, agent):
    return plan.positions[:, agent, 1].tolist()


def random_plan(seed, model, kind, num_agents=8, size=5, num_steps=15):
    """Return a random instance, and a plan of PIBT or of agents that act at random."""
    rng = np.random.default_rng(seed)
    sample = RandomObstacles(size, size, 0.15, num_agents).sample(rng)
    headings = rng.integers(4, size=num_agents) if model == "rotate" else None
    instance = Instance(sample.grid, sample.scenario, headings)
    if kind == "pibt":
        plan = PIBT(seed=seed).solve(instance, time_limit=1000, max_steps=num_steps, partial=True)
        return instance, plan
    simulator = simulator_of(instance, num_steps + 1, "uniform", 0)
    steps = Steps(simulator)
    steps.add()
    for _ in range(num_steps):
        simulator.step(rng.integers(simulator.num_actions, size=(1, num_agents)))
        steps.add()
    return instance, steps.plan()


def random_delays(seed, num_agents, num_steps=25):
    rng = np.random.default_rng(seed + 1)
    return rng.random((num_steps, num_agents)) < rng.choice([0, 0.05, 0.3, 0.8])


def paths_of(plan):
    """Return the states of each agent without repetitions, (row, col, heading), and the step of each."""
    headings = np.zeros(plan.positions.shape[:2]) if plan.headings is None else plan.headings
    paths = []
    for agent in range(plan.num_agents):
        states = [(*plan.positions[t, agent].tolist(), int(headings[t, agent])) for t in range(plan.num_steps + 1)]
        steps = [t for t in range(len(states)) if t == 0 or states[t] != states[t - 1]]
        paths.append(([states[t] for t in steps], steps))
    return paths


random_plans = given(seed=st.integers(0, 2**31), model=st.sampled_from(MODELS), kind=st.sampled_from(["pibt", "walk"]))


class Reference:
    """The rule of execution in plain Python: cells are visited in the order of the plan."""

    def __init__(self, plan):
        self.paths, visits = [states for states, _ in paths_of(plan)], {}
        for t in range(plan.num_steps + 1):
            for agent, cell in enumerate(map(tuple, plan.positions[t].tolist())):
                if t == 0 or tuple(plan.positions[t - 1, agent].tolist()) != cell:
                    visits.setdefault(cell, []).append(agent)
        self.at = [0] * plan.num_agents
        self.visits = visits  # by cell, the agents that are on it or will be

    def step(self, delayed):
        """Let agents act: take away those that cannot, until none is left to be taken away."""
        acting = {i for i, path in enumerate(self.paths) if self.at[i] + 1 < len(path) and not delayed[i]}
        while wrong := {i for i in acting if not self._can_act(i, acting)}:
            acting -= wrong
        for i in acting:
            here, there = self._cells(i)
            if here != there:
                assert self.visits[here].pop(0) == i
        for i in acting:
            self.at[i] += 1
        for i in acting:
            assert self.visits[self.paths[i][self.at[i]][:2]][0] == i
        return acting

    def leaders(self):
        """Return the last visitor of the next cell before each agent that has an action left, or `NONE`."""
        found = {}
        for i, path in enumerate(self.paths):
            if self.at[i] + 1 < len(path):
                visitors = self.visits[self._cells(i)[1]]
                found[i] = visitors[visitors.index(i) - 1] if visitors[0] != i else NONE
        return found

    def _cells(self, i):
        return self.paths[i][self.at[i]][:2], self.paths[i][self.at[i] + 1][:2]

    def _can_act(self, i, acting):
        here, there = self._cells(i)
        if here == there or self.visits[there][0] == i:
            return True
        first, second = self.visits[there][:2]
        return second == i and first in acting and self._cells(first)[0] == there != self._cells(first)[1]


def test_the_states_and_dependencies_of_two_agents_that_follow():
    graph = graph_of("ba.AB", ["WRRW", "WWRR"])
    # Agents in the order of their letters: a starts in column 1, b in column 0.
    assert graph.first.tolist() == [0, 3, 6]
    assert graph.positions[:, 1].tolist() == [1, 2, 3, 0, 1, 2]
    assert graph.steps.tolist() == [0, 2, 3, 0, 3, 4]
    assert graph.waits_for.tolist() == [NONE, NONE, NONE, NONE, 1, 2]
    assert graph.dependencies.tolist() == [[1, 0, 0, 0], [1, 1, 0, 1]]
    assert graph.headings is None
    assert graph.num_actions.tolist() == [2, 2]


def test_followers_wait_for_a_delayed_leader():
    graph = graph_of("cba.", ["R", "R", "R"])
    plan = Execution(graph).run(delays("x..", "x.."))
    assert [cols(plan, agent) for agent in range(3)] == [[2, 2, 2, 3], [1, 1, 1, 2], [0, 0, 0, 1]]


def test_a_leader_does_not_wait_for_a_delayed_follower():
    graph = graph_of("cba..", ["RR", "RR", "RR"])
    plan = Execution(graph).run(delays(".x.", ".x."))
    assert [cols(plan, agent) for agent in range(3)] == [[2, 3, 4, 4, 4], [1, 1, 1, 2, 3], [0, 0, 0, 1, 2]]


def test_the_order_at_a_crossing_is_kept():
    plan = Execution(graph_of("#b# a.A #B#", ["RRW", "WDD"])).run(delays("x.", "x.", "x."))
    assert plan.positions[:, 0].tolist() == [*[[1, 0]] * 4, [1, 1], [1, 2], [1, 2]]
    assert plan.positions[:, 1].tolist() == [*[[0, 1]] * 5, [1, 1], [2, 1]]  # b enters as a leaves


def test_waits_without_a_reason_are_left_out():
    plan = Execution(graph_of("a..b", ["WRWW", "WWWL"])).run(np.zeros((0, 2), bool))
    assert [cols(plan, agent) for agent in range(2)] == [[0, 1], [3, 2]]


@pytest.mark.parametrize("late", range(4))
def test_a_cycle_moves_as_a_whole(late):
    graph = graph_of("ab dc", ["RD", "DL", "LU", "UR"])
    delayed = np.zeros((1, 4), bool)
    delayed[0, late] = True
    plan = Execution(graph).run(delayed)
    positions = plan.positions.tolist()
    assert positions[0] == positions[1]
    assert positions[2:] == graph.plan().positions.tolist()[1:]


@pytest.mark.parametrize("late", range(10))
def test_a_delayed_agent_stops_all_behind_it(late):
    execution = Execution(graph_of("jihgfedcba.", ["R"] * 10))  # a leads
    assert execution.permitted(np.arange(10) == late).tolist() == [agent < late for agent in range(10)]
    assert execution.permitted().all()


@pytest.mark.parametrize(
    ("late", "leaders"), [("....", ""), ("x...", ".ab."), ("x.x.", ".a.."), (".x..", "..b."), ("..xx", "")]
)
def test_agents_wait_for_the_one_before_them(late, leaders):
    execution = Execution(graph_of("d.cba.", ["R", "R", "R", "W"]))  # a leads, and d has no action
    expected = ["abcd".find(leader) for leader in leaders.ljust(4, ".")]
    assert execution.waiting_for(delays(late)[0]).tolist() == expected


def test_turns_are_actions_and_others_wait_for_a_late_one():
    instance = drawn("ba. .A.", headings=[0, 0])
    positions = [[[0, 1], [0, 0]]] * 2 + [[[1, 1], [0, 0]], [[1, 1], [0, 1]]]
    headings = [[0, 0], [1, 0], [1, 0], [1, 0]]
    graph = DependencyGraph.from_plan(Plan(positions, headings), instance)
    assert graph.steps.tolist() == [0, 1, 2, 0, 3]
    assert graph.headings.tolist() == [0, 1, 1, 0, 0]
    assert graph.dependencies.tolist() == [[1, 0, 0, 1]]
    plan = Execution(graph).run(delays("x.", "x."))
    assert plan.headings[:, 0].tolist() == [0, 0, 0, 1, 1]
    assert plan.positions[:, 1].tolist() == [[0, 0]] * 4 + [[0, 1]]  # enters as the other one leaves


def test_a_return_to_an_own_cell_needs_no_dependency():
    assert graph_of("a.A", ["RLRR"]).dependencies.tolist() == []


def test_only_consecutive_visitors_depend_on_each_other():
    graph = graph_of("cba....", ["RRRR", "WRRR", "WWRR"])
    assert graph.dependencies.tolist() == [[1, 0, 0, 0], [1, 1, 0, 1], [1, 2, 0, 2], *[[2, k, 1, k] for k in range(2)]]


def test_no_agents_and_no_actions():
    empty = Plan(np.zeros((3, 0, 2), int))
    graph = DependencyGraph.from_plan(empty)
    assert Execution(graph).run(np.zeros((2, 0), bool)).num_steps == 0
    assert DependencyGraph.from_json(graph.to_json()) == graph
    still = graph_of("ab", ["WW", "WW"])
    assert Execution(still).is_finished
    assert Execution(still).run(np.ones((9, 2), bool)).num_steps == 0
    assert DependencyGraph.from_json(still.to_json()) == still


@pytest.mark.parametrize(
    ("text", "words", "message"),
    [
        ("a.b", ["R", "L"], "step 1: agent 0 and agent 1 at [row 0, col 1]: two agents on one cell"),
        ("ab", ["R", "L"], "step 1: agent 0 and agent 1 at [row 0, col 1] and [row 0, col 0]: two agents swap cells"),
        ("a.b", ["RR", "WW"], "step 2: agent 0 and agent 1 at [row 0, col 2]: two agents on one cell"),
        ("ba..", ["WR", "RR"], "step 1: agent 0 and agent 1 at [row 0, col 1]: two agents on one cell"),
    ],
)
def test_conflicts_are_named_with_and_without_the_instance(text, words, message):
    instance, plan = moving(text, words)
    for known in (instance, None):
        with pytest.raises(ValueError, match="plan: ") as error:
            DependencyGraph.from_plan(plan, known)
        assert str(error.value) == f"plan: {message}"


def test_other_violations_are_named():
    instance, plan = moving("a#A", ["R"])
    with pytest.raises(ValueError, match=r"plan: step 1: agent 0 at \[row 0, col 1\]: an obstacle, or outside the map"):
        DependencyGraph.from_plan(plan, instance)


def test_a_plan_that_does_not_end_at_the_goals():
    assert graph_of("a..A", ["R"]).num_actions.tolist() == [1]


def test_bad_delays_and_bad_steps():
    graph = graph_of("ba.", ["R", "R"])
    with pytest.raises(ValueError, match=r"delayed: expected the shape \(T', 2\), got \(3, 1\)"):
        Execution(graph).run(np.zeros((3, 1), bool))
    execution = Execution(graph)
    with pytest.raises(ValueError, match="agent 1: expected it to wait in this step"):
        execution.advance(np.array([False, True]))
    execution.advance(np.array([True, False]))
    execution.advance(np.array([False, True]))
    assert execution.is_finished
    with pytest.raises(ValueError, match="agent 0: expected it to wait in this step"):
        execution.advance(np.array([True, False]))


@random_plans
def test_each_step_is_that_of_the_reference(seed, model, kind):
    _, plan = random_plan(seed, model, kind)
    execution, reference = Execution(DependencyGraph.from_plan(plan)), Reference(plan)
    for delayed in [*random_delays(seed, plan.num_agents), *np.zeros((plan.num_steps, plan.num_agents), bool)]:
        permitted, waiting_for, leaders = (
            execution.permitted(delayed),
            execution.waiting_for(delayed),
            reference.leaders(),
        )
        acting = reference.step(delayed)
        assert set(np.flatnonzero(permitted)) == acting
        waiting = leaders.keys() - acting - set(np.flatnonzero(delayed))
        assert waiting_for.tolist() == [leaders[i] if i in waiting else NONE for i in range(plan.num_agents)]
        execution.advance(permitted)
    assert execution.is_finished


@random_plans
def test_executed_plans_are_legal_and_end(seed, model, kind):
    instance, plan = random_plan(seed, model, kind)
    at_the_end = Instance(instance.grid, Scenario(plan.positions[0], plan.positions[-1]), instance.headings)
    delayed = random_delays(seed, plan.num_agents)
    for execute in (Execution, SwitchableExecution):
        executed = execute(DependencyGraph.from_plan(plan, instance)).run(delayed)
        assert validate(at_the_end, executed) is None
        assert [states for states, _ in paths_of(executed)] == [states for states, _ in paths_of(plan)]
        assert executed.num_steps <= plan.num_steps + delayed.any(axis=1).sum() or execute is SwitchableExecution


@random_plans
def test_without_delays_another_order_is_cheaper(seed, model, kind):
    instance, plan = random_plan(seed, model, kind)
    graph, nobody = DependencyGraph.from_plan(plan, instance), np.zeros((0, plan.num_agents), bool)
    kept, switched = (execute(graph).run(nobody) for execute in (Execution, SwitchableExecution))
    assert switched.sum_of_costs <= kept.sum_of_costs


def rows(plan, agent):
    return plan.positions[:, agent, 0].tolist()


def test_an_agent_goes_before_one_that_is_late():
    graph = graph_of("#b# a.A #B#", ["RRW", "WDD"])
    late = delays("x.", "x.", "x.", "x.")
    assert rows(Execution(graph).run(late), 1) == [0, 0, 0, 0, 0, 0, 1, 2]
    plan = SwitchableExecution(graph).run(late)
    assert rows(plan, 1) == [0, 0, 1, 2, 2, 2, 2]  # the order changes after the first step
    assert cols(plan, 0) == [0, 0, 0, 0, 0, 1, 2]


def test_an_agent_that_goes_first_does_so_in_the_whole_corridor():
    graph = graph_of("a###A ..... B###b", ["DRRRRUWWWWW", "WWWWWULLLLD"])
    late = delays("x.", "x.", "x.", "x.")
    assert Execution(graph).run(late).num_steps == 15
    plan = SwitchableExecution(graph).run(late)
    assert cols(plan, 1) == [4, 4, 4, 3, 2, 1, 0, 0, 0, 0, 0, 0, 0]
    assert rows(plan, 0) == [0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 0]


def test_an_agent_does_not_go_before_one_that_waits_for_it_elsewhere():
    # b would have to pass a, which is in the corridor already.
    graph = graph_of("a....A B###b.", ["RRRRRWWWWW", "WWWWULLLLD"])
    late = delays("x.", "x.", "x.")
    assert np.array_equal(SwitchableExecution(graph).run(late).positions, Execution(graph).run(late).positions)


def test_changed_orders_cost_less():
    instance, plan = random_plan(seed=4, model="cardinal", kind="pibt", num_agents=40, size=10, num_steps=60)
    graph, rng = DependencyGraph.from_plan(plan, instance), np.random.default_rng(0)
    costs = {Execution: 0, SwitchableExecution: 0}
    for _ in range(8):
        late = np.repeat(rng.random((12, 40)) < 0.05, 5, axis=0)
        for execute in costs:
            costs[execute] += execute(graph).run(late).sum_of_costs
    assert costs[SwitchableExecution] < 0.98 * costs[Execution]


@random_plans
def test_without_delays_no_action_is_later_than_planned(seed, model, kind):
    instance, plan = random_plan(seed, model, kind)
    executed = Execution(DependencyGraph.from_plan(plan, instance)).run(np.zeros((0, plan.num_agents), bool))
    for (_, earlier), (_, planned) in zip(paths_of(executed), paths_of(plan), strict=True):
        assert (np.array(earlier) <= planned).all()
    assert (executed.costs <= plan.costs).all()


@random_plans
def test_the_plan_is_that_of_the_steps(seed, model, kind):
    _, plan = random_plan(seed, model, kind)
    again = DependencyGraph.from_plan(plan).plan()
    assert np.array_equal(again.positions, plan.positions[: again.num_steps + 1])
    assert (plan.positions[again.num_steps :] == again.positions[-1]).all()
    assert plan.headings is None or np.array_equal(again.headings, plan.headings[: again.num_steps + 1])


@random_plans
def test_the_simulator_stops_those_behind_delayed_agents(seed, model, kind):
    instance, plan = random_plan(seed, model, kind)
    graph = DependencyGraph.from_plan(plan, instance)
    delayed = random_delays(seed, plan.num_agents)
    executed = Execution(graph).run(delayed)
    simulator = simulator_of(instance, 1000, "uniform", 0)
    execution, steps, wait = Execution(graph), Steps(simulator), wait_action(model)
    steps.add()
    for step in range(executed.num_steps):
        commanded = execution.permitted()
        late = delayed[step] if step < len(delayed) else np.zeros(plan.num_agents, bool)
        targets = graph.positions[np.where(commanded, execution.next_states, execution.states)]
        assert len(np.unique(targets, axis=0)) == plan.num_agents  # no two agents are told to enter one cell
        actions = np.full(plan.num_agents, wait)
        for agent in np.flatnonzero(commanded & ~late):
            actions[agent] = action_to(graph, execution.next_states[agent])
        before = simulator.agents[0][["cell", "heading"]].copy()
        simulator.step(actions[None])
        acted = simulator.agents[0][["cell", "heading"]] != before
        assert acted.tolist() == execution.permitted(late).tolist()
        execution.advance(acted)
        steps.add()
    assert execution.is_finished
    assert np.array_equal(steps.plan().positions, executed.positions)
    assert executed.headings is None or np.array_equal(steps.plan().headings, executed.headings)


def action_to(graph, state):
    """Return the action that leads to a state from the one before it."""
    step = graph.positions[state] - graph.positions[state - 1]
    if graph.headings is None:
        return {(-1, 0): 1, (1, 0): 2, (0, -1): 3, (0, 1): 4}[tuple(step.tolist())]
    turn = (graph.headings[state] - graph.headings[state - 1]) % 4
    return {0: Action.FORWARD, 1: Action.ROTATE_RIGHT, 3: Action.ROTATE_LEFT}[int(turn)]


@random_plans
def test_json_round_trip(seed, model, kind):
    instance, plan = random_plan(seed, model, kind)
    graph = DependencyGraph.from_plan(plan, instance)
    assert DependencyGraph.from_json(graph.to_json()) == graph
    members = json.loads(graph.to_json())
    assert members["dependencies"] == graph.dependencies.tolist()
    assert [len(word) for word in members["actions"]] == graph.num_actions.tolist()


def test_json():
    instance = drawn("ab.", headings=[0, 1])
    plan = Plan([[[0, 0], [0, 1]]] * 2 + [[[0, 0], [0, 2]], [[0, 1], [0, 2]]], [[0, 1], [0, 0], [0, 0], [0, 0]])
    members = json.loads(DependencyGraph.from_plan(plan, instance).to_json())
    assert members == {
        "starts": [[0, 0, 0], [0, 1, 1]],
        "actions": ["F", "CF"],
        "steps": [[3], [1, 2]],
        "dependencies": [[0, 0, 1, 1]],
    }


STEPS_OF_1 = "expected the steps of agent 1 to be 1 increasing whole numbers, 1 or more"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"starts": 3}, "expected 'starts' to be a list, got 3"),
        ({"starts": [[0, 1], [0, -1]]}, "expected the start of agent 1 to be [row, col], got [0, -1]"),
        ({"starts": [[0, 1], [0]]}, "expected the start of agent 1 to be [row, col], got [0]"),
        (
            {"starts": [[0, 1, 4], [0, 0, 0]]},
            "expected the start of agent 0 to be [row, col, heading 0 to 3], got [0, 1, 4]",
        ),
        ({"actions": ["R"]}, "expected 2 items in 'actions', got 1"),
        ({"steps": [[1], [1], [1]]}, "expected 2 items in 'actions' and 'steps', as in 'starts'"),
        ({"actions": ["R", "X"]}, "expected the actions of agent 1 to be letters of UDLR, got 'X'"),
        ({"actions": ["R", "W"]}, "expected the actions of agent 1 to be letters of UDLR, got 'W'"),
        ({"actions": ["R", 1]}, "expected the actions of agent 1 to be letters of UDLR, got 1"),
        ({"steps": [[1], [0]]}, f"{STEPS_OF_1}, got [0]"),
        ({"steps": [[1], [1, 2]]}, f"{STEPS_OF_1}, got [1, 2]"),
        ({"steps": [[1], "1"]}, f"{STEPS_OF_1}, got '1'"),
        ({"steps": [[1], [2**30]]}, "expected at most 50000000 steps times agents, got 1073741824 steps of 2 agents"),
        ({"steps": [[2], [1]]}, "plan: step 1: agent 0 and agent 1 at [row 0, col 1]: two agents on one cell"),
        (
            {"actions": ["L", "R"]},
            "plan: step 1: agent 0 and agent 1 at [row 0, col 0] and [row 0, col 1]: two agents swap cells",
        ),
        ({"dependencies": []}, "expected 'dependencies' to be those of the paths and steps"),
        ({"dependencies": None}, "expected 'dependencies' to be those of the paths and steps"),
    ],
)
def test_bad_json(change, message):
    members = json.loads(graph_of("ba.", ["R", "R"]).to_json())
    with pytest.raises(FormatError) as error:
        DependencyGraph.from_json(json.dumps(members | change), "graph.json")
    assert str(error.value) == f"graph.json: {message}"


def test_json_that_is_none():
    with pytest.raises(FormatError, match=r"^dependency graph:1:1: expected JSON"):
        DependencyGraph.from_json("starts")


def steps_with_delays(env, planner, delayed, seed=0):
    """Play an episode in which the actions of delayed agents are replaced by waits; return its number of steps."""
    observations, _ = env.reset(seed=seed)
    wait = wait_action(env.simulator.config.action_model)
    step = 0
    while env.agents:
        actions = planner.act(observations)
        late = delayed[step] if step < len(delayed) else np.zeros(len(env.possible_agents), bool)
        actions = {name: wait if late[env.possible_agents.index(name)] else action for name, action in actions.items()}
        observations = env.step(actions)[0]
        step += 1
    return step


class Counted:
    """A planner that counts how often it plans."""

    plans = 0

    def plan(self, problem, time_limit):
        self.plans += 1
        return super().plan(problem, time_limit)


class CountedLaCAM(Counted, LaCAM):
    pass


class CountedSIPP(Counted, PrioritizedSIPP):
    pass


class CountedCBS(Counted, CBS):
    pass


def played(model, delayed, kind=CountedLaCAM, on_target="nothing", max_steps=150, seed=0, **options):
    """Return the environment, the planner and the number of steps of an episode."""
    env = mapf_pz.parallel_env(
        source=RandomObstacles(7, 7, 0.1, 10), action_model=model, on_target=on_target, max_steps=max_steps
    )
    planner = kind(env, anytime=False, **options)
    planner.compile(model)
    planner.plans = 0
    return env, planner, steps_with_delays(env, planner, delayed, seed)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("kind", [CountedLaCAM, CountedSIPP])
@pytest.mark.parametrize("seed", range(3))
def test_a_planner_follows_the_graph(model, kind, seed):
    delayed = np.random.default_rng(seed).random((20, 10)) < 0.2
    env, planner, steps = played(model, delayed, kind, seed=seed, execution="graph")
    assert env.simulator.terminated[0]
    assert planner.plans == 1
    env.reset(seed=seed)
    instance = Instance(
        Grid(env.grid),
        Scenario(env.positions, env.goals),
        env.headings if model == "rotate" else None,
    )
    plan = kind(anytime=False).solve(instance, time_limit=1000)
    assert plan is not None
    executed = Execution(DependencyGraph.from_plan(plan, instance)).run(delayed)
    # The episode ends as soon as all agents are at their goals.
    at_goals = (executed.positions == instance.scenario.goals).all(axis=(1, 2))
    assert steps == max(int(np.argmax(at_goals)), 1)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("delays", ["0.05:1-4", "0.05:5-20:poisson"])
@pytest.mark.parametrize(("execution", "execute"), [("graph", Execution), ("switch", SwitchableExecution)])
@pytest.mark.parametrize("seed", range(3))
def test_a_plan_is_executed_with_the_delays_of_the_environment(model, delays, execution, execute, seed):
    """One plan suffices, and its costs are those of the execution with these delays."""
    source = RandomObstacles(7, 7, 0.1, 10)
    env = mapf_pz.parallel_env(source=source, action_model=model, delays=delays)
    planner = CountedLaCAM(env, anytime=False, execution=execution)
    planner.compile(model)
    planner.plans = 0
    env.reset(seed=seed)
    starts = Instance(Grid(env.grid), Scenario(env.positions, env.goals), env.headings if model == "rotate" else None)
    delayed = []
    env.reset(seed=seed)
    while env.agents:
        *_, infos = env.step(planner.act(dict.fromkeys(env.agents)))
        delayed.append([info["delayed"] for info in infos.values()])
    assert (env.simulator.terminated[0], planner.plans) == (True, 1)
    assert np.sum(delayed) > 0
    plan = LaCAM(anytime=False).solve(starts, time_limit=1000)
    executed = execute(DependencyGraph.from_plan(plan, starts)).run(np.array(delayed, bool))
    np.testing.assert_array_equal(executed.positions[len(delayed)], env.positions)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("on_target", ["restart", "finish"])
@pytest.mark.parametrize("execution", ["graph", "switch", "both"])
def test_a_planner_follows_the_graph_in_other_modes(model, on_target, execution):
    delayed = np.random.default_rng(0).random((40, 10)) < 0.2
    env, planner, steps = played(model, delayed, on_target=on_target, max_steps=80, execution=execution)
    if on_target == "finish":
        assert env.simulator.terminated[0]
        assert steps < 80
        assert planner.plans == 1 or execution == "both"
    else:
        arrivals = env.simulator.agents[0]["arrivals"].sum()
        assert arrivals > 30
        assert planner.plans <= 1 + arrivals or execution == "both"


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("on_target", ["nothing", "finish"])
@pytest.mark.parametrize("seed", range(5))
def test_without_delays_no_move_is_blocked(model, on_target, seed):
    env = mapf_pz.parallel_env(source=RandomObstacles(6, 6, 0.1, 10), action_model=model, on_target=on_target)
    planner = LaCAM(env, anytime=False, execution="graph")
    assert len(list(play(env, planner, seed))) > 0
    assert env.simulator.terminated[0]


def late_in_a_corridor(kind, **options):
    """Return the steps in which a planner plans, if one of two agents is delayed in steps 2 to 12."""
    simulator = simulator_of(drawn("a......A ######## b......B"), 20, "uniform", 0)
    planner = kind(**options)
    planner.compile("cardinal")
    planner.plans, found = 0, []
    while not simulator.over[0]:
        step, before = simulator.steps[0] + 1, planner.plans
        actions = planner.decide(simulator)
        found += [int(step)] * (planner.plans - before)
        simulator.step(np.where([2 <= step <= 12, False], 0, actions)[None])
    assert simulator.terminated[0]
    assert simulator.steps[0] == 7 + 11
    return found


@pytest.mark.parametrize(
    "kind", [partial(CountedLaCAM, anytime=False), partial(CountedSIPP, anytime=False), CountedCBS]
)
def test_the_executions_replan_at_different_times(kind):
    assert late_in_a_corridor(kind, execution="graph") == [1]
    assert late_in_a_corridor(kind, execution="switch") == [1]
    assert late_in_a_corridor(kind, execution="replan") == [1, *range(3, 14)]
    assert late_in_a_corridor(kind, execution="both", max_lateness=5) == [1, 7, 12]
    assert late_in_a_corridor(kind, execution="both", max_lateness=11) == [1, 13]
    assert late_in_a_corridor(kind, execution="both", max_lateness=12) == [1]


def test_both_goes_on_with_the_graph_if_no_plan_is_found():
    class Once(CountedLaCAM):
        def plan(self, problem, time_limit):
            path = super().plan(problem, time_limit)
            return path if self.plans <= 1 else None

    assert late_in_a_corridor(Once, anytime=False, execution="both", max_lateness=5) == [1, 7, 12]


def test_agents_off_their_paths_need_another_plan():
    instance = drawn("a...A .....")
    simulator = simulator_of(instance, 100, "uniform", 0)
    planner = CountedLaCAM(anytime=False, execution="graph")
    planner.compile("cardinal")
    planner.plans = 0
    for action, plans in [(4, 1), (0, 1), (3, 1), (0, 2)]:
        planner.decide(simulator)
        assert planner.plans == plans
        simulator.step(np.array([[action]]))


def test_agents_out_of_order_need_another_plan():
    class Crossing(CountedLaCAM):
        """Lets agent 0 pass the crossing first."""

        def plan(self, problem, time_limit):
            super().plan(problem, time_limit)
            return Path(np.array([[3, 1], [4, 1], [5, 4], [5, 7]], np.int32), None)

    instance = drawn("#b# a.A #B#")
    for first, plans in ((0, 1), (1, 2)):
        simulator = simulator_of(instance, 100, "uniform", 0)
        planner = Crossing(execution="graph")
        planner.compile("cardinal")
        planner.plans = 0
        assert planner.decide(simulator).tolist() == [4, 0]
        simulator.step(np.array([[4, 0] if first == 0 else [0, 2]]))
        planner.decide(simulator)
        assert planner.plans == plans


@pytest.mark.parametrize("kind", [CountedLaCAM, CountedSIPP])
def test_an_agent_that_disappears_at_its_start_is_on_it_for_a_step(kind):
    env = mapf_pz.parallel_env(
        source=InstanceList([drawn("ba.B")]), action_model="cardinal", on_target="finish", max_steps=20
    )
    assert len(list(play(env, kind(env, anytime=False, execution="graph"), seed=0))) == 4


def test_without_a_plan_all_wait():
    simulator = simulator_of(drawn("aB.bA"), 100, "uniform", 0)
    planner = CountedLaCAM(anytime=False, execution="graph")
    planner.compile("cardinal")
    planner.plans = 0
    for _ in range(3):
        assert planner.decide(simulator).tolist() == [0, 0]
        simulator.step(np.array([[0, 0]]))
    assert planner.plans == 1


def test_options_by_name():
    assert planner_of("lacam:execution=both,max_lateness=3")._max_lateness == 3
    assert planner_of("prioritized:execution=graph")._max_lateness == np.inf
    with pytest.raises(ValueError, match=r"execution='best': expected one of replan, graph, switch, both"):
        planner_of("lacam:execution=best")
    with pytest.raises(ValueError, match="max_lateness=0: expected 1 or more"):
        planner_of("lacam:max_lateness=0")
