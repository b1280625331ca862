"""Usage of edges and the rules that turn it into weights: by hand on drawn maps, and their symmetries."""

import numpy as np
import pytest

from mapf_pz.guidance import open_edges
from mapf_pz.guidance.edges import opposite_edges
from mapf_pz.instances.instance import Scenario
from mapf_pz.optimization.rule import FeedbackRule
from mapf_pz.optimization.usage import Usage
from mapf_pz.simulator import Simulator
from mapf_pz.simulator.config import EnvConfig

FREE = np.array([[True, True, True], [True, False, True], [True, True, True]])


@pytest.mark.parametrize("shape", [(3, 4), (4, 1), (1, 4)])
def test_usage_counts_moves_by_direction_and_waits(shape):
    """Two agents: one moves to a neighbor and back, the other waits on its cell."""
    last = (shape[0] - 1, shape[1] - 1)
    goal = (0, 1) if shape[1] > 1 else (1, 0)
    scenario = Scenario(np.array([[0, 0], last]), np.array([goal, (0, 0)]))
    env = EnvConfig(map=np.ones(shape, np.bool_), scenario=scenario, action_model="cardinal", view_size=(1, 1))
    simulator, usage = Simulator(env), Usage.empty(shape)
    simulator.reset(seeds={0: 0})
    there, back, wait = (4, 3, 0) if shape[1] > 1 else (2, 1, 0)  # right and left, or down and up
    for action in (there, wait, back):
        simulator.step(np.array([[action, wait]]))
        usage.add(simulator.agents[0])
    expected = Usage.empty(shape)
    ahead, behind = (0, 2) if shape[1] > 1 else (1, 3)
    expected.moves[ahead, 0, 0] = expected.moves[(behind, *goal)] = 1
    expected.waits[last] = 3  # away from its goal; the first agent waits on its goal, which does not count
    assert np.array_equal(usage.moves, expected.moves)
    assert np.array_equal(usage.waits, expected.waits)


def test_opposite_edges():
    edges = np.arange(4 * 9, dtype=np.float64).reshape(4, 3, 3)
    back = opposite_edges(edges)
    assert back[0, 1, 1] == edges[2, 1, 2]
    assert back[1, 1, 1] == edges[3, 2, 1]
    assert back[2, 1, 1] == edges[0, 1, 0]
    assert back[3, 1, 1] == edges[1, 0, 1]
    assert back[0, 0, 2] == back[3, 0, 0] == 0  # outside
    inside = open_edges(np.ones((3, 3), np.bool_))
    assert np.array_equal(np.where(inside, opposite_edges(back), 0), np.where(inside, edges, 0))


def test_the_used_direction_becomes_cheaper():
    rule = FeedbackRule(direction_gain=2.0, rate=0.5, prior=2.0, waiting_gain=0, flow_gain=0, wait_weight=0.7)
    rule = FeedbackRule.from_vector(rule.vector() * [1, 1, 1, 1, 1, 1, 0])  # no crisscross
    usage = Usage.empty(FREE.shape)
    usage.moves[0, 0, 0] = 8  # eight moves east, none back
    usage.waits[FREE] = 1
    traffic = rule.update(rule.start(FREE), usage, FREE)
    assert traffic.direction[0, 0, 0] == pytest.approx(0.5 * 8 / 10)
    graph = rule.graph(traffic, FREE)
    assert graph.move[0, 0, 0] == pytest.approx(np.exp(-0.4))
    assert graph.move[2, 0, 1] == pytest.approx(np.exp(0.4))
    assert graph.move[1, 0, 0] == 1
    assert np.array_equal(np.isfinite(graph.move), open_edges(FREE))
    assert np.allclose(graph.wait, 0.7)


def test_crowded_cells_become_more_expensive_to_leave():
    rule = FeedbackRule(direction_gain=1.0, rate=1 - 1e-9, waiting_gain=0.5, flow_gain=0.25, crisscross=0)
    usage = Usage.empty(FREE.shape)
    usage.waits[0, 0] = 8  # the mean of 8 free cells is 1
    usage.moves[:2, 2, 0] = usage.moves[2:, 2, 0] = 2
    graph = rule.graph(rule.update(rule.start(FREE), usage, FREE), FREE)
    assert graph.move[0, 0, 0] == pytest.approx(np.exp(0.5 * 8 - 0.25), rel=1e-5)
    assert graph.move[0, 2, 0] == pytest.approx(np.exp(0.25 * 7 - 0.5 * 2 / 8), rel=1e-5)


def test_the_vector_holds_all_parameters():
    rule = FeedbackRule(direction_gain=0.3, rate=0.2, prior=9, waiting_gain=-0.1, flow_gain=0.4, wait_weight=2)
    again = FeedbackRule.from_vector(rule.vector())
    assert vars(again) == pytest.approx(vars(rule))
    assert not np.array_equal(rule.vector(), FeedbackRule().vector())
