"""The costs of steps in the weights of a guidance graph: the metrics, and the reward's term."""

import math

import numpy as np
import pytest

import mapf_pz
from mapf_pz import GuidanceGraph
from mapf_pz.instances.sources import InstanceList
from mapf_pz.simulator import Simulator
from mapf_pz.simulator.actions import Action, CardinalAction
from mapf_pz.simulator.config import EnvConfig, RewardConfig
from tests.helpers.text_instances import drawn

FORWARD, LEFT, RIGHT, WAIT = Action
STAY, UP, DOWN, WEST, EAST = CardinalAction
MOVE = np.array([2.0, 4, 8, 16])
"""The weights of moves to the east, south, west and north."""
TURN = 0.5
PLAIN_REWARD = {"forward": 0, "rotate": 0, "goal": 0}


class OneInstance:
    """A source of one instance, which need not have a solution."""

    def __init__(self, instance):
        self.instance, self.grid, self.shape = instance, instance.grid, instance.grid.shape
        self.num_agents, self.num_goals = instance.num_agents, 1

    def sample(self, rng):
        return self.instance


def sided(shape):
    """Return a graph with another weight for each direction, and for waiting in each column."""
    wait = TURN * np.ones(shape) + np.arange(shape[1])
    return GuidanceGraph(MOVE[:, None, None] * np.ones((4, *shape)), wait)


def started(text, headings=None, **keywords):
    """Return an environment at the start of a drawn instance."""
    instance = drawn(text, headings)
    keywords = {"edge_weights": sided(instance.grid.shape), "max_steps": 20} | keywords
    model = "cardinal" if headings is None else "rotate"
    env = mapf_pz.parallel_env(source=InstanceList([instance]), action_model=model, **keywords)
    env.reset(seed=0)
    return env


def walk(env, *steps):
    """Take steps, each with an action for every agent; return the rewards of each step."""
    found = []
    for actions in steps:
        _, rewards, *_ = env.step(
            {f"agent_{i}": action for i, action in enumerate(actions) if f"agent_{i}" in env.agents}
        )
        found.append(rewards)
    return found


def costs(env):
    metrics = env.metrics()
    return metrics["weighted_cost"], metrics["weighted_cost_ratio"]


def test_moves_cost_their_edge_and_all_else_a_wait():
    env = started("a.A\n###", headings=[0])
    assert costs(env) == (0, 0)
    walk(env, [LEFT], [FORWARD], [RIGHT], [WAIT])  # the second is blocked
    assert costs(env) == (4 * TURN, 4 * TURN / (2 + 2))
    walk(env, [FORWARD], [WAIT], [FORWARD])
    cost = 4 * TURN + 2 + (TURN + 1) + 2
    assert costs(env) == (cost, cost / 4)


def test_each_direction_has_its_weight():
    env = started("a.\n.A")
    walk(env, [EAST], [WEST], [DOWN], [UP], [EAST])
    walk(env, [DOWN])
    assert costs(env) == (2 + 8 + 4 + 16 + 2 + 4, 36 / 6)


def test_moves_that_others_block_cost_a_wait():
    env = started("ab.\n..A\nB..")
    walk(env, [EAST, STAY])
    assert env.metrics()["weighted_cost"] == TURN + (TURN + 1)


def test_rest_at_the_goal_is_free_for_agents_that_stay():
    env = started("aA..\nb..B")
    walk(env, [EAST, EAST], [STAY, STAY], [STAY, STAY])
    assert env.metrics()["weighted_cost"] == 2 + (2 + 2 * (TURN + 1))
    walk(env, [EAST, STAY])  # it leaves its goal, and pays for the rest
    assert env.metrics()["weighted_cost"] == (2 + 2 * (TURN + 1) + 2) + (2 + 3 * (TURN + 1))
    walk(env, [WEST, STAY], [STAY, STAY])
    assert env.metrics()["weighted_cost"] == (2 + 2 * (TURN + 1) + 2 + 8) + (2 + 5 * (TURN + 1))


def test_an_agent_that_stays_at_its_start_costs_one_wait():
    env = started("ab.B")
    walk(env, [STAY, EAST], [STAY, EAST])
    assert costs(env) == (TURN + 4, 1)


def test_agents_that_have_disappeared_cost_nothing():
    env = started("aA..\nb..B", on_target="finish")
    walk(env, [EAST, EAST], [STAY, EAST], [STAY, EAST])
    assert costs(env) == (2 + 6, 1)
    assert env.simulator.agents["step_weight"].tolist() == [[0, 2]]


def test_agents_without_a_path_are_left_out_of_the_bound():
    instance = drawn("aA#b#B")
    env = mapf_pz.parallel_env(source=OneInstance(instance), action_model="cardinal", edge_weights=sided((1, 6)))
    env.reset(seed=0)
    walk(env, [EAST, STAY])
    cost = 2 + (TURN + 3)
    assert costs(env) == (cost, cost / 2)


@pytest.mark.parametrize("on_target", ["nothing", "finish"])
@pytest.mark.parametrize("action_model", ["rotate", "cardinal"])
def test_equal_weights_are_a_factor(action_model, on_target):
    rng = np.random.default_rng(0)
    weight = float(np.float32(0.3))
    graph = GuidanceGraph(np.full((4, 5, 5), weight), np.full((5, 5), weight))
    config = EnvConfig(
        map=np.ones((5, 5), bool), num_agents=6, edge_weights=graph, action_model=action_model, on_target=on_target
    )
    simulator = Simulator(config, num_envs=4)
    simulator.reset(seeds=dict(enumerate(range(4))))
    for _ in range(60):
        simulator.step(rng.integers(simulator.num_actions, size=(4, 6)))
        for b in range(4):
            metrics = simulator.metrics(b)
            assert metrics["weighted_cost"] == weight * metrics["SoC"]
            assert metrics["weighted_cost_ratio"] == pytest.approx(metrics["SoC_ratio"])


def test_an_edge_of_infinite_weight_makes_the_cost_infinite():
    graph = sided((1, 3))
    move = graph.move.copy()
    move[2] = np.inf  # to the west
    env = started("a.A", edge_weights=GuidanceGraph(move, graph.wait))
    walk(env, [EAST])
    assert costs(env) == (2, 0.5)
    assert walk(env, [WEST]) == [{"agent_0": pytest.approx(0.1)}]  # the reward is finite
    walk(env, [EAST], [EAST])
    assert costs(env) == (math.inf, math.inf)
    assert env.metrics()["SoC_ratio"] == 2


@pytest.mark.parametrize(("weights", "on_target"), [("uniform", "nothing"), ("crisscross", "restart")])
def test_where_there_is_no_weighted_cost(weights, on_target):
    env = started("aA", edge_weights=weights, on_target=on_target)
    assert not {"weighted_cost", "weighted_cost_ratio"} & env.metrics().keys()
    assert env.simulator.metric_names == tuple(env.metrics())


def test_metrics_compute_the_cost_to_go_only_with_weights():
    for weights in ("uniform", "crisscross"):
        env = started("aA", edge_weights=weights, view_size=(1, 1), channels=("view",))
        env.metrics()
        assert (env.simulator.tables.arrays.slot >= 0).any() == (weights != "uniform")
        assert env.simulator.metric_names == tuple(env.metrics())


def test_penalties_sum_up_to_the_cost():
    """In mean weights, for an agent that stays at its goal."""
    reward = RewardConfig(**PLAIN_REWARD, weighted_step_cost=3)
    env = started("a..A\nb#..\n#..B", headings=[0, 0], reward=reward)
    rewards = walk(
        env, [LEFT, WAIT], [RIGHT, RIGHT], [FORWARD, FORWARD], [FORWARD, WAIT], [FORWARD, WAIT], [LEFT, LEFT]
    )
    mean = env.simulator.mean_weight(0)
    first = [-3 * weight / mean for weight in (TURN, TURN, 2, 2, 2)]
    assert [step["agent_0"] for step in rewards] == pytest.approx([*first, 0], rel=1e-6)
    assert [step["agent_1"] for step in rewards] == pytest.approx([-3 * TURN / mean] * 6)
    total = -sum(sum(step.values()) for step in rewards)
    assert total == pytest.approx(3 * env.metrics()["weighted_cost"] / mean)


def test_leaving_the_goal_is_penalized():
    env = started("aA..\nb..B", reward=RewardConfig(**PLAIN_REWARD, weighted_step_cost=1))
    rewards = walk(env, [EAST, STAY], [STAY, STAY], [EAST, STAY])
    mean = env.simulator.mean_weight(0)
    assert [step["agent_0"] for step in rewards] == pytest.approx([-2 / mean, 0, -2 / mean])


def test_infinite_weights_cannot_be_penalized():
    graph = sided((2, 2))
    move = graph.move.copy()
    move[1, 0, 1] = np.inf
    reward = RewardConfig(weighted_step_cost=0.1)
    message = r"weighted_step_cost needs finite edge weights, but that of the move south from \[row 0, col 1\]"
    with pytest.raises(ValueError, match=message):
        started("aA\n..", edge_weights=GuidanceGraph(move, graph.wait), reward=reward)
    started("aA\n.#", edge_weights=GuidanceGraph(move, graph.wait), reward=reward)  # the map does not allow it


def test_functions_of_the_reward_read_the_weights():
    env = started("aA..\nb..B", on_target="finish", reward=lambda transition: transition.step_weights)
    rewards = walk(env, [EAST, DOWN], [STAY, EAST])
    assert [list(step.values()) for step in rewards] == [[2, TURN], [2]]
