"""Cost to go: against networkx on the explicit graph, its own equation, and the bound on its memory."""

import networkx as nx
import numpy as np
import pytest

from mapf_pz._internal import machine
from mapf_pz._internal.machine import usable_memory
from mapf_pz.guidance import GuidanceGraph, open_edges
from mapf_pz.guidance.library import guidance_graph
from mapf_pz.instances import RandomObstacles
from mapf_pz.instances.heading import HEADING_STEPS
from mapf_pz.instances.instance import Grid, Instance, Scenario
from mapf_pz.simulator import Simulator
from mapf_pz.simulator.config import EnvConfig, RewardConfig
from mapf_pz.simulator.kernels import cost_tables as tables
from mapf_pz.simulator.kernels import world
from mapf_pz.simulator.kernels.cost_lookup import costs_at, least_costs
from mapf_pz.simulator.kernels.cost_sweeps import FEWEST_GOALS, LANES
from mapf_pz.simulator.kernels.observation.features import Feature
from mapf_pz.simulator.kernels.state import CostToGo

MODELS = ("rotate", "cardinal")


def one_way_graph(free, rng):
    """Random weights, a fifth of the passages closed in one direction."""
    weights = GuidanceGraph.random(free, rng)
    return GuidanceGraph(np.where(rng.random(weights.move.shape) < 0.2, np.inf, weights.move), weights.wait)


GRAPHS = {
    "by name": lambda free, rng: "uniform",
    "uniform": lambda free, rng: GuidanceGraph.uniform(free),
    "equal": lambda free, rng: GuidanceGraph(GuidanceGraph.uniform(free).move * 0.7, np.full(free.shape, 0.7)),
    "random": GuidanceGraph.random,
    "uneven": lambda free, rng: GuidanceGraph(
        np.where(open_edges(free), rng.choice([0.01, 1, 5], (4, *free.shape)), np.inf),
        rng.choice([0.01, 1, 5], free.shape),
    ),
    "crisscross": lambda free, rng: GuidanceGraph.crisscross(free),
    "one-way": one_way_graph,
    "uniform one-way": lambda free, rng: GuidanceGraph(
        np.where(rng.random((4, *free.shape)) < 0.2, np.inf, GuidanceGraph.uniform(free).move), np.ones(free.shape)
    ),
}


def explicit_graph(free, weights, action_model):
    """The graph of (cell, heading) and actions; cardinal agents have no heading."""
    weights = guidance_graph(weights, Grid(free))
    graph = nx.DiGraph()
    headings = range(4) if action_model == "rotate" else [0]
    for row, col in np.argwhere(free).tolist():
        for heading in headings:
            graph.add_node(((row, col), heading))
            for turn in (-1, 1) if action_model == "rotate" else ():
                turned = ((row, col), (heading + turn) % 4)
                graph.add_edge(((row, col), heading), turned, weight=float(weights.wait[row, col]))
        for direction in np.flatnonzero(open_edges(free)[:, row, col]).tolist():
            ahead = (row + int(HEADING_STEPS[direction, 0]), col + int(HEADING_STEPS[direction, 1]))
            heading = direction if action_model == "rotate" else 0
            if np.isfinite(weights.move[direction, row, col]):
                price = float(weights.move[direction, row, col])
                graph.add_edge(((row, col), heading), (ahead, heading), weight=price)
    return graph


def cost_to_go(free, weights, goals, action_model):
    """The tables (G, H, W, D) that the simulator computes for agents with these goals."""
    cells = np.argwhere(free)[: len(goals)]
    config = EnvConfig(
        map=free,
        scenario=Scenario(cells, goals),
        num_agents=len(goals),
        edge_weights=weights,
        action_model=action_model,
        view_size=(1, 1),
        channels=("cost_to_go",),
    )
    simulator = Simulator(config)
    simulator.reset(seeds={0: 0})
    tables = simulator.tables.arrays
    slots = tables.slot[0, goals @ np.array([free.shape[1], 1])]
    tables = CostToGo(*tables[1:])
    headings, cells = tables.exact.shape[2], np.arange(free.size + 1)
    to_go = np.stack(
        [
            [costs_at(tables, np.full_like(cells, slot), cells, np.full_like(cells, h)) for slot in slots]
            for h in range(headings)
        ],
        axis=-1,
    )
    assert np.array_equal(least_costs(tables, slots), to_go.min(axis=2))
    assert np.isinf(to_go[:, -1]).all()  # outside the map
    return to_go[:, :-1].reshape(len(goals), *free.shape, headings)


@pytest.mark.parametrize("num_goals", [3, FEWEST_GOALS, LANES + FEWEST_GOALS])
@pytest.mark.parametrize("action_model", MODELS)
@pytest.mark.parametrize("name", GRAPHS)
def test_equals_dijkstra_on_the_explicit_graph(name, action_model, num_goals):
    rng = np.random.default_rng(1)
    for shape in ((1, 7), (6, 5), (9, 8), (15, 16)):
        free = connected_map(rng, shape)
        weights = GRAPHS[name](free, rng)
        goals = np.argwhere(free)[rng.permutation(free.sum())[:num_goals]]
        graph = explicit_graph(free, weights, action_model).reverse()
        for to_go, goal in zip(cost_to_go(free, weights, goals, action_model), goals.tolist(), strict=True):
            ends = [(tuple(goal), heading) for heading in range(to_go.shape[2])]
            expected = np.full(to_go.shape, np.inf)
            for (cell, heading), cost in nx.multi_source_dijkstra_path_length(graph, ends).items():
                expected[(*cell, heading)] = cost
            np.testing.assert_allclose(to_go, expected, rtol=1e-5)


def connected_map(rng, shape):
    """Draw a map whose free cells hang together, so that every goal can be reached."""
    while True:
        free = rng.random(shape) < 0.75
        free |= shape[0] == 1
        graph = explicit_graph(free, GuidanceGraph.uniform(free), "cardinal")
        if free.sum() >= 4 and nx.is_strongly_connected(graph):
            return free


@pytest.mark.parametrize("action_model", MODELS)
@pytest.mark.parametrize("name", GRAPHS)
def test_bellman_equation(name, action_model):
    rng = np.random.default_rng(2)
    free = connected_map(rng, (7, 6))
    weights = GRAPHS[name](free, rng)
    goal = np.argwhere(free)[[5]]
    (to_go,) = cost_to_go(free, weights, goal, action_model)
    for (cell, heading), edges in explicit_graph(free, weights, action_model).adjacency():
        if list(cell) == goal[0].tolist():
            assert to_go[(*cell, heading)] == 0
        else:
            best = min((edge["weight"] + to_go[(*end, h)] for (end, h), edge in edges.items()), default=np.inf)
            assert to_go[(*cell, heading)] == pytest.approx(best, rel=1e-5)


@pytest.mark.parametrize("source", ["one map", "many maps"])
@pytest.mark.parametrize("on_target", ["nothing", "restart"])
def test_a_small_memory_changes_nothing(on_target, source):
    """Tables are dropped and computed again, and the episodes stay the same."""
    table_bytes = 4 * (36 + 1)
    episodes, in_use = [], []
    for distance_bytes in (2**30, 8 * table_bytes):
        config = EnvConfig(
            **{"map": np.ones((6, 6), np.bool_)} if source == "one map" else {"source": RandomObstacles(6, 6, 0.2, 4)},
            num_agents=4,
            max_steps=60,
            on_target=on_target,
            distance_bytes=distance_bytes,
            reward="progress",
            channels=("cost_to_go", "heuristic", "others_next"),
            features=("action_advantage",),
        )
        simulator = Simulator(config, num_envs=2)
        episodes.append(play(simulator, 150))
        in_use.append(int((simulator.tables.arrays.slot >= 0).sum()))
    for one, other in zip(*episodes, strict=True):
        for left, right in zip(one, other, strict=True):
            np.testing.assert_array_equal(left, right)
    assert in_use[1] <= 8  # one for each agent
    if source == "one map":
        assert in_use[0] > 8  # so many were computed, and some of them had to be dropped


def play(simulator, num_steps):
    """Return what happened in some episodes."""
    rng = np.random.default_rng(3)
    simulator.reset(seeds={b: b for b in range(simulator.num_envs)})
    log = []
    for _ in range(num_steps):
        simulator.step(rng.choice(4, (simulator.num_envs, simulator.num_agents), p=(0.7, 0.1, 0.1, 0.1)))
        agents = simulator.agents
        log.append((agents["cell"].copy(), agents["goal"].copy(), agents["reward"].copy(), *simulator.observe()))
        over = np.flatnonzero((agents["truncated"] | agents["terminated"]).any(axis=1)).tolist()
        if over:
            simulator.reset(over)
    return log


def test_too_little_memory_is_one_line():
    config = EnvConfig(num_agents=6, channels=("cost_to_go",), distance_bytes=5 * 4 * 65)
    simulator = Simulator(config)
    with pytest.raises(
        MemoryError, match=r"^distance_bytes=1300: .* takes 1560 bytes; pass distance_bytes=1560 or more "
    ):
        simulator.reset(seeds={0: 0})


def test_by_default_the_bound_grows_with_the_agents(monkeypatch):
    """All agents' goals fit, unless they take more than half of the memory; without a need nothing is reserved."""
    monkeypatch.setattr(tables, "CACHE_BYTES", 1)
    one_table = 4 * 65
    for num_agents in (2, 6):
        simulator = Simulator(EnvConfig(num_agents=num_agents, channels=("cost_to_go",)))
        simulator.reset(seeds={0: 0})
        assert len(simulator.tables.arrays.packed) == num_agents
    monkeypatch.setattr(tables, "usable_memory", lambda: 2 * 5 * one_table)
    simulator = Simulator(EnvConfig(num_agents=6, channels=("cost_to_go",)))
    with pytest.raises(MemoryError, match=rf"^distance_bytes={5 * one_table}: .* pass distance_bytes={6 * one_table} "):
        simulator.reset(seeds={0: 0})
    Simulator(EnvConfig(num_agents=6, channels=("cost_to_go",), distance_bytes=6 * one_table)).reset(seeds={0: 0})
    monkeypatch.setattr(tables, "usable_memory", lambda: None)
    assert tables.default_bytes(10**9) == tables.CACHE_BYTES


def test_the_memory_of_a_container(monkeypatch, tmp_path):
    total = usable_memory()
    assert total is not None
    assert total >= 2**28
    (tmp_path / "max").write_text("max\n")
    (tmp_path / "limit").write_text("100000000\n")
    monkeypatch.setattr(machine, "CGROUP_LIMITS", (tmp_path / "max", tmp_path / "absent"))
    assert usable_memory() >= total
    monkeypatch.setattr(machine, "CGROUP_LIMITS", (tmp_path / "max", tmp_path / "limit"))
    assert usable_memory() == 100_000_000


def test_tables_that_are_in_use_count_where_memory_is_too_little():
    grid, starts = Grid(np.ones((8, 8), np.bool_)), [(0, 0), (0, 1)]
    one_goal, two_goals = (Instance(grid, Scenario(starts, goals)) for goals in ([(0, 2)] * 2, [(5, 5), (6, 6)]))
    config = EnvConfig(map=grid, num_agents=2, channels=("cost_to_go",), distance_bytes=2 * 4 * 65)
    simulator = Simulator(config, num_envs=2)
    simulator.reset(instances={0: one_goal, 1: one_goal})
    with pytest.raises(MemoryError, match=r" takes 780 bytes; pass distance_bytes=780 or more "):
        simulator.reset([1], instances={1: two_goals})


def test_there_is_room_for_all_goals_of_all_maps():
    source = RandomObstacles(2, 2, density=0, num_agents=4)
    simulator = Simulator(EnvConfig(source=source, channels=("cost_to_go",), view_size=(1, 1)), num_envs=3)
    simulator.reset(seeds={b: b for b in range(3)})
    assert len(simulator.tables.arrays.packed) == (simulator.tables.arrays.slot >= 0).sum() == 3 * 4


def test_memory_for_no_table_still_holds_one():
    simulator = Simulator(EnvConfig(num_agents=1, channels=("cost_to_go",), distance_bytes=1))
    for seed in range(5):
        simulator.reset(seeds={0: seed})
    goal = simulator.goals(0)[0]
    assert simulator.tables.arrays.slot[0, goal @ (8, 1)] == 0
    assert len(simulator.tables.arrays.packed) == 1


@pytest.mark.parametrize("num_agents", [1, 2])
@pytest.mark.parametrize("action_model", MODELS)
def test_shortest_steps_ignore_weights(action_model, num_agents):
    """`SoC_ratio` counts steps, whatever the guidance graph."""
    free = np.ones((3, 3), np.bool_)
    grid = Grid(free)
    config = EnvConfig(
        map=grid,
        num_agents=num_agents,
        edge_weights=GuidanceGraph.random(free, np.random.default_rng(4)),
        action_model=action_model,
        view_size=(1, 1),
        max_steps=9,
    )
    simulator = Simulator(config)
    starts, goals = [(2, 2), (0, 0)][:num_agents], [(2, 1), (0, 2)][:num_agents]
    simulator.reset(instances={0: Instance(grid, Scenario(starts, goals), [0, 0][:num_agents])})
    wait = {"rotate": 3, "cardinal": 0}[action_model]
    simulator.step(np.full((1, num_agents), wait))
    shortest = sum({"rotate": (3, 2), "cardinal": (1, 2)}[action_model][:num_agents])  # two turns and a move; two moves
    assert simulator.metrics(0)["SoC_ratio"] == pytest.approx(num_agents / shortest)


def two_components(rng):
    free = rng.random((20, 23)) < 0.7
    free[:, 11] = False
    return free


def serpentine(_rng):
    """One corridor of 287 cells, back and forth: paths of more than 255 steps for agents that turn, and for others."""
    free = np.ones((31, 17), np.bool_)
    free[1::4, 1:] = free[3::4, :-1] = False
    return free


@pytest.mark.parametrize("num_threads", [1, 2])
@pytest.mark.parametrize("action_model", MODELS)
@pytest.mark.parametrize("draw", [two_components, serpentine])
@pytest.mark.parametrize("unit_weights", [True, False])
def test_many_goals_at_once_equal_one_after_another(unit_weights, draw, action_model, num_threads):
    """Searches of several goals at once give the tables of searches of one goal to the bit."""
    rng = np.random.default_rng(3)
    free = draw(rng)
    graph = GuidanceGraph.uniform(free) if unit_weights else one_way_graph(free, rng)
    cells = np.flatnonzero(free)
    maps = np.zeros(1, np.int32)
    one_by_one, together = (new_tables(free, graph, action_model, num_threads, unit_weights) for _ in range(2))
    for k in range(cells.size):
        one_by_one.require(maps, cells[None, k : k + 1])
    together.require(maps, cells[None])
    expected = contents(one_by_one, cells)
    assert np.array_equal(contents(together, cells), expected)
    assert sorted(together.arrays.slot[0, cells]) == list(range(cells.size))


def contents(tables, cells):
    slots = tables.arrays.slot[0, cells]
    return (tables.arrays.packed if tables.counts_steps else tables.arrays.exact)[slots]


def new_tables(free, graph, action_model, num_threads, unit_weights):
    arrays = world.allocate(1, free.shape)
    world.set_map(arrays, 0, free, graph)
    headings = 4 if action_model == "rotate" else 1
    return tables.CostTables(arrays, headings, int(free.sum()), unit_weights, num_threads=num_threads)


@pytest.mark.parametrize("steps", [10, pytest.param(80, marks=pytest.mark.slow)])
@pytest.mark.parametrize("action_model", MODELS)
@pytest.mark.parametrize("name", [*GRAPHS, "sampled"])
def test_around_agents_at_goals_equals_dijkstra_without_their_cells(name, action_model, steps):
    rng = np.random.default_rng(5)
    grids = [Grid(connected_map(rng, (5, 6))) for _ in range(2)]
    shown = []

    def remember(inputs, values, at):
        shown.append(inputs.cost_to_go)
        values[:, :, at] = 0

    config = EnvConfig(
        **around(grids[0], 5),
        action_model=action_model,
        edge_weights="random" if name == "sampled" else GRAPHS[name](grids[0].free, rng),
        channels=("cost_to_go",),
        features=("action_advantage", Feature(remember, needs_cost_to_go=True)),
    )
    simulators = [Simulator(config, num_envs=2, num_threads=num_threads) for num_threads in (1, 2)]
    for simulator in simulators:
        simulator.reset(seeds={0: 0, 1: 1})
    rerouted = 0
    for _ in range(steps):
        expected = [costs_without_others(simulators[0], b) for b in range(2)]
        rerouted += sum(costs["rerouted"] for costs in expected)
        for simulator in simulators:
            advantage = simulator.observe().features[:, :, : simulator.num_actions]
            for b, costs in enumerate(expected):
                np.testing.assert_allclose(simulator.cost_to_go()[b], costs["own"], rtol=1e-5)
                np.testing.assert_allclose(shown[-1][b, :, :-1], costs["least"], rtol=1e-5)
        followed = rng.random(advantage.shape[:2]) < 0.8
        actions = np.where(followed, advantage.argmax(-1), rng.integers(0, advantage.shape[2], followed.shape))
        for simulator in simulators:
            simulator.step(actions)
            over = np.flatnonzero(simulator.over).tolist()
            if over:
                simulator.reset(over)
    assert rerouted > steps / 4


def around(grid, num_agents):
    """Keywords of an environment whose cost to go leads around agents at their goals."""
    return {"map": grid, "num_agents": num_agents, "max_steps": 25, "view_size": (1, 1), "around_agents_at_goals": True}


def costs_without_others(simulator, b):
    """The cost to go of environment `b` if other agents at their goals are obstacles, by networkx.

    `own` (N,) from where the agents are, `least` (N, H * W) from all cells.
    """
    agents, (height, width) = simulator.agents[b], simulator.shape
    free, guidance = simulator.grid(b).free, simulator.guidance(b)
    own, least, rerouted = [], [], 0
    for agent in agents:
        for removed in (agents["cell"][(agents["cell"] == agents["goal"]) & (agents["cell"] != agent["goal"])], []):
            graph = explicit_graph(free, guidance, simulator.config.action_model)
            cells = {divmod(int(cell), width) for cell in removed}
            graph.remove_nodes_from([node for node in graph if node[0] in cells])
            heading = int(agent["heading"]) if simulator.config.action_model == "rotate" else 0
            start, goal = (divmod(int(agent[name]), width) for name in ("cell", "goal"))
            ends = [node for node in graph if node[0] == goal]
            found = nx.multi_source_dijkstra_path_length(graph.reverse(), ends)
            if (start, heading) in found:
                break  # otherwise it has no path around them
        rerouted += len(cells) > 0
        own.append(found.get((start, heading), np.inf))
        least.append(np.full((height, width), np.inf))
        for (cell, _), cost in found.items():
            least[-1][cell] = min(least[-1][cell], cost)
    return {"own": own, "least": np.reshape(least, (len(agents), -1)), "rerouted": rerouted}


def test_an_agent_walks_around_one_that_rests():
    free = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]], np.bool_)
    scenario = Scenario([(0, 1), (0, 0)], [(0, 1), (0, 2)])
    costs = {}
    for flag in (False, True):
        config = EnvConfig(
            map=free, scenario=scenario, action_model="cardinal", channels=("cost_to_go",), around_agents_at_goals=flag
        )
        simulator = Simulator(config)
        simulator.reset(seeds={0: 0})
        costs[flag] = simulator.cost_to_go()[0].tolist()
    assert costs == {False: [0, 2], True: [0, 6]}


def test_progress_counts_the_way_around():
    free = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]], np.bool_)
    config = EnvConfig(
        map=free,
        scenario=Scenario([(0, 1), (0, 0)], [(0, 1), (0, 2)]),
        action_model="cardinal",
        reward=RewardConfig(forward=0, rotate=0, goal=0, progress=1),
        around_agents_at_goals=True,
    )
    simulator = Simulator(config)
    simulator.reset(seeds={0: 0})
    rewards = []
    # The second agent goes down; the first one moves away, which opens the short way again; the second one goes back.
    for actions in ([0, 2], [4, 0], [0, 1]):
        simulator.step(np.array([actions]))
        rewards.append((simulator.agents["reward"][0].tolist(), simulator.cost_to_go()[0].tolist()))
    assert rewards == [([0, 1], [0, 5]), ([-1, 0], [1, 3]), ([0, 1], [1, 2])]


@pytest.mark.parametrize("on_target", ["finish", "restart"])
def test_no_agent_is_avoided_where_none_stays_at_its_goal(on_target):
    grid = Grid(np.ones((5, 5), np.bool_))
    episodes = []
    for flag in (False, True):
        keywords = around(grid, 4) | {"around_agents_at_goals": flag, "on_target": on_target}
        episodes.append(play(Simulator(EnvConfig(**keywords, reward="progress", channels=("cost_to_go",))), 60))
    for one, other in zip(*episodes, strict=True):
        for left, right in zip(one, other, strict=True):
            np.testing.assert_array_equal(left, right)
