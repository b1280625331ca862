import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mapf_pz
from mapf_pz.instances import RandomObstacles, Scenario
from mapf_pz.planners import PIBT, WindowedLNS
from mapf_pz.planners.deadline import Deadline
from mapf_pz.planners.problem import problem_of
from mapf_pz.planners.windowed.improve import allocate_neighborhood, improve
from mapf_pz.planners.windowed.paths import allocate_paths, continue_paths, release
from mapf_pz.planners.windowed.search import LATE, allocate_search, find_path
from mapf_pz.planners.windowed.walk import walk
from mapf_pz.simulator import Simulator
from mapf_pz.simulator.config import EnvConfig
from mapf_pz.simulator.kernels.cost_lookup import cost_at, num_headings
from mapf_pz.simulator.source import sample_instance
from tests.helpers.episodes import play

WAIT = 4
WEIGHTS = ["uniform", "random", "crisscross"]


def simulator_of(model, weights, seed, num_agents=8, num_at_goals=0):
    """Return a simulator in which the first agents start on their goals."""
    config = EnvConfig(
        source=RandomObstacles(6, 6, 0.2, num_agents), action_model=model, edge_weights=weights, on_target="restart"
    )
    simulator = Simulator(config)
    instance = sample_instance(config, seed)
    goals = instance.scenario.goals.copy()
    goals[:num_at_goals] = instance.scenario.starts[:num_at_goals]
    instance = replace(instance, scenario=Scenario(instance.scenario.starts, goals))
    simulator.reset(seeds={0: seed}, instances={0: instance})
    return simulator


def moves(view, cell, heading):
    """Yield the price, cell and heading after each action; agents without headings have the heading 0."""
    for direction in range(4) if num_headings(view.to_go) == 1 else (heading,):
        if view.leads_to[direction, cell] != cell:
            yield view.weight[direction, cell], view.leads_to[direction, cell], heading
    for turn in (0,) if num_headings(view.to_go) == 1 else (0, 1, 3):
        yield view.weight[WAIT, cell], cell, (heading + turn) % 4


def collisions(used, t, here, there):
    """Return the agents that are on `there` after step t, or move from there to `here`."""
    swaps = here != there and used[t - 1, there] >= 0 and used[t, here] == used[t - 1, there]
    return [int(used[t, there])] * int(used[t, there] >= 0) + [int(used[t - 1, there])] * int(swaps)


def cost_of(view, i, passing, path):
    """Return the cost of a path of cells and headings, and the number of steps until it counts."""
    goal, cost = view.agents[i]["goal"], 0.0
    for t, ((here, heading), (there, after)) in enumerate(itertools.pairwise(path)):
        if here == goal and passing and t > 0:
            return cost
        if (here, heading) == (there, after) and here == goal and not passing:
            continue
        cost += next(price for price, *state in moves(view, here, heading) if state == [there, after])
    here, heading = path[-1]
    return cost + (0 if here == goal and passing else cost_at(view.to_go, view.slot[goal], here, heading))


def cheapest(view, i, passing, price, paths):
    """Return the lowest cost of a path of agent i, by dynamic programming over steps."""
    goal, headings = view.agents[i]["goal"], num_headings(view.to_go)
    start = view.agents[i]["cell"], view.agents[i]["heading"] % headings
    costs = {(*start, False): 0.0}
    for t in range(1, paths.cell.shape[1]):
        following = {}
        for (here, heading, passed), cost in costs.items():
            for step_cost, there, after in moves(view, here, heading):
                others = collisions(paths.used, t, here, there)
                if any(paths.fixed[other] for other in others):
                    continue
                rests = here == goal and (here, heading) == (there, after) and not passing
                total = cost + (0 if passed or rests else step_cost) + price * len(others)
                state = there, after, bool(passed or (passing and there == goal))
                following[state] = min(total, following.get(state, np.inf))
        costs = following
    return min(
        (
            cost + (0 if passed else cost_at(view.to_go, view.slot[goal], cell, heading))
            for (cell, heading, passed), cost in costs.items()
        ),
        default=np.inf,
    )


@pytest.mark.parametrize("model", ["cardinal", "rotate"])
@settings(max_examples=25)
@given(
    seed=st.integers(0, 2**31),
    weights=st.sampled_from(WEIGHTS),
    passing=st.booleans(),
    price=st.sampled_from([0.5, 2.0]),
    window=st.integers(1, 7),
    num_at_goals=st.sampled_from([0, 4]),
)
def test_paths_are_cheapest(model, seed, weights, passing, price, window, num_at_goals):
    view = simulator_of(model, weights, seed, num_at_goals=num_at_goals).planning_view()
    paths, scratch = allocate_paths(view, window), allocate_search(window, num_headings(view.to_go))
    neighborhood = allocate_neighborhood(window, 1 + seed)
    continue_paths(view, passing, paths)
    improve(view, passing, 1.0, 30, paths, scratch, neighborhood)
    rng = np.random.default_rng(seed)
    for i in range(len(view.agents)):
        release(paths, i)
        paths.fixed[:] = rng.random(len(view.agents)) < 0.5
        expected = cheapest(view, i, passing, price, paths)
        found = find_path(view, i, passing, np.inf, price, 0, paths, scratch)
        assert found == (expected < np.inf)
        if found:
            path = list(zip(scratch.cell.tolist(), scratch.heading.tolist(), strict=True))
            cost = cost_of(view, i, passing, path)
            for t, ((here, _), (there, _)) in enumerate(itertools.pairwise(path), 1):
                others = collisions(paths.used, t, here, there)
                assert not any(paths.fixed[other] for other in others)
                cost += price * len(others)
            assert cost == pytest.approx(expected, abs=LATE * window)
            assert not find_path(view, i, passing, expected - 0.05, price, 0, paths, scratch)
        for t in range(window + 1):
            paths.used[t, paths.cell[i, t]] = i


@pytest.mark.parametrize("model", ["cardinal", "rotate"])
@settings(max_examples=15)
@given(seed=st.integers(0, 2**31), weights=st.sampled_from(WEIGHTS), num_at_goals=st.sampled_from([0, 5]))
def test_improvement_lowers_the_sum_of_costs_and_keeps_paths_apart(model, seed, weights, num_at_goals):
    view = simulator_of(model, weights, seed, num_agents=14, num_at_goals=num_at_goals).planning_view()
    paths, scratch = allocate_paths(view, 8), allocate_search(8, num_headings(view.to_go))
    neighborhood = allocate_neighborhood(8, 1 + seed)
    continue_paths(view, True, paths)
    for _ in range(10):
        before = paths.cost.sum()
        improve(view, True, 1.0, 20, paths, scratch, neighborhood)
        assert paths.cost.sum() <= before + 1e-3
        for i in range(14):
            path = list(zip(paths.cell[i].tolist(), paths.heading[i].tolist(), strict=True))
            assert paths.cost[i] == pytest.approx(cost_of(view, i, True, path), abs=1e-3)
            assert paths.least[i] <= paths.cost[i] + 1e-3
        used = np.full_like(paths.used, -1)
        for t, cells in enumerate(paths.cell.T):
            assert len(np.unique(cells)) == 14
            used[t, cells] = np.arange(14)
            for i in range(14 * (t > 0)):
                assert collisions(used, t, paths.cell[i, t - 1], cells[i]) == [i]
        assert np.array_equal(used, paths.used)
    assert not paths.fixed.any()


@pytest.mark.parametrize("model", ["cardinal", "rotate"])
@settings(max_examples=10)
@given(
    seed=st.integers(0, 2**31),
    weights=st.sampled_from(WEIGHTS),
    on_target=st.sampled_from(["nothing", "restart", "finish"]),
    num_agents=st.sampled_from([2, 14, 24]),
    time_limit=st.sampled_from([0.0, 0.002]),
)
def test_no_move_is_blocked(model, seed, weights, on_target, num_agents, time_limit):
    env = mapf_pz.parallel_env(
        source=RandomObstacles(8, 8, 0.2, num_agents),
        action_model=model,
        edge_weights=weights,
        on_target=on_target,
        max_steps=40,
    )
    planner = WindowedLNS(env, seed, window=1 + seed % 15, rounds=2, time_limit=time_limit)
    assert len(list(play(env, planner, seed))) > 0


LANE = np.ones((1, 8), np.bool_)


@pytest.mark.parametrize("model", ["cardinal", "rotate"])
@pytest.mark.parametrize("weights", ["uniform", "crisscross"])
@pytest.mark.parametrize("start", [0, 2])
def test_an_agent_waits_where_it_must_arrive_again(model, weights, start):
    goals = np.array([[[0, 2], [0, 2]]])
    env = mapf_pz.parallel_env(
        map=LANE,
        scenario=Scenario(np.array([[0, start]]), goals),
        initial_heading="east",
        action_model=model,
        edge_weights=weights,
        on_target="restart",
        max_steps=30,
    )
    assert len(list(play(env, WindowedLNS(env), seed=0))) == 30
    assert env.simulator.agents[0]["arrivals"].tolist() == [30 if start == 2 else 29]


@pytest.mark.parametrize("model", ["cardinal", "rotate"])
@settings(max_examples=15)
@given(seed=st.integers(0, 2**31), weights=st.sampled_from(WEIGHTS))
def test_walks_are_free_of_collisions(model, seed, weights):
    problem = problem_of(simulator_of(model, weights, seed, num_agents=12))
    path = walk(problem, np.random.default_rng(seed), Deadline(np.inf))
    simulator = simulator_of(model, weights, seed, num_agents=12)
    for actions in path.actions(simulator.leads_to(0)):
        simulator.step(actions[None])
        assert not simulator.agents["blocked"].any()
    assert np.array_equal(simulator.agents["cell"][0], path.cells[-1])
    if path.headings is not None:
        assert np.array_equal(simulator.agents["heading"][0], path.headings[-1])


@pytest.mark.parametrize("model", ["cardinal", "rotate"])
def test_most_agents_arrive_on_a_walk(model):
    arrived = 0
    for seed in range(20):  # in single crowded instances, most may not
        problem = problem_of(simulator_of(model, "uniform", seed, num_agents=12))
        path = walk(problem, np.random.default_rng(seed), Deadline(np.inf))
        arrived += (path.cells[-1] == problem.goals).sum()
    assert arrived > 0.75 * 20 * 12


def test_a_walk_ends_at_the_deadline():
    problem = problem_of(simulator_of("cardinal", "uniform", 0))
    assert np.array_equal(walk(problem, np.random.default_rng(0), Deadline(0)).cells, problem.starts[None])


def arrivals(planner_in, model, num_agents, max_steps=256, side=18, **options):
    env = mapf_pz.parallel_env(
        source=RandomObstacles(side, side, 0.2, num_agents),
        action_model=model,
        on_target="restart",
        max_steps=max_steps,
        view_size=(1, 1),
        channels=("view",),
    )
    assert len(list(play(env, planner_in(env, **options), seed=4))) == max_steps
    return env.simulator.agents[0]["arrivals"]


@pytest.mark.parametrize("model", ["cardinal", "rotate"])
def test_more_goals_than_pibt_and_no_agent_starves(model):
    ours, pibt = (arrivals(planner, model, 60) for planner in (WindowedLNS, PIBT))
    assert ours.sum() > 1.3 * pibt.sum()
    assert ours.min() >= 3


def test_crowds_keep_moving():
    assert arrivals(WindowedLNS, "cardinal", 58, 128, side=12).min() >= 1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"window": 0}, "window=0: expected a number of steps from 1 to 100"),
        ({"rounds": -1}, "rounds=-1: expected a number of attempts, 0 or more"),
    ],
)
def test_invalid_options(options, message):
    with pytest.raises(ValueError, match=message):
        WindowedLNS(**options)
