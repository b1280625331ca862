from math import inf, log1p, sqrt

import pytest

from mapf_pz.instances.heading import Heading
from mapf_pz.simulator.actions import Action, CardinalAction
from mapf_pz.simulator.config import RewardConfig
from tests.helpers.cases import CASES
from tests.helpers.reference import Reference

EAST, SOUTH, WEST, NORTH = Heading
FORWARD, LEFT, RIGHT, WAIT = Action
SYSTEMS = ("soft", "priority", "block_both")


def open_map(height, width, obstacles=()):
    return [[(row, col) not in obstacles for col in range(width)] for row in range(height)]


def one_agent(free, start, heading, goal, **options):
    return Reference(free, [start], [heading], [[goal]], **options)


# Conflicts.


@pytest.mark.parametrize("system", SYSTEMS)
@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.action_model} {case.name}")
def test_hand_drawn_cases(case, system):
    starts = case.start_cells
    goals = [[cell] for cell in reversed(starts)]
    game = Reference(
        case.free, starts, case.start_headings, goals, action_model=case.action_model, collision_system=system
    )
    game.step(case.action_numbers)
    ends = case.end_cells(system)
    assert game.positions == ends
    assert game.headings == case.end_headings
    assert game.moved == [start != end for start, end in zip(starts, ends, strict=True)]


# Cost to go and action masks.


def test_cost_to_go_counts_turns():
    game = one_agent(open_map(3, 3), (0, 0), EAST, (2, 2))
    assert game.cost_to_go((2, 2), (0, 0), EAST) == 5  # two forward, one turn, two forward
    assert game.cost_to_go((2, 2), (0, 0), WEST) == 6
    assert game.cost_to_go((2, 2), (2, 2), NORTH) == 0
    assert game.cost_to_go((2, 2), (2, 0), WEST) == 4


def test_cost_to_go_uses_weights_and_walls():
    free = open_map(2, 3, obstacles=[(0, 1)])
    move = [[[inf if not cell else 1.0 for cell in row] for row in free] for _ in range(4)]
    move[EAST][1][0] = 3.0
    wait = [[0.5, 1.0, 1.0], [0.25, 1.0, 2.0]]
    game = one_agent(free, (0, 0), SOUTH, (0, 2), move=move, wait=wait)
    assert game.cost_to_go((0, 2), (0, 0), SOUTH) == 1 + 0.25 + 3 + 1 + 2 + 1
    assert game.cost_to_go((0, 2), (0, 1)) == inf


def test_cardinal_cost_to_go_ignores_headings():
    game = one_agent(open_map(3, 3), (0, 0), EAST, (2, 2), action_model="cardinal")
    assert {game.cost_to_go((2, 2), (0, 0), heading) for heading in Heading} == {4}
    assert game.headings == [NORTH]


def test_action_mask_knows_the_map_only():
    game = Reference(open_map(2, 2), [(0, 0), (0, 1)], [EAST, EAST], [[(1, 1)], [(1, 0)]])
    assert game.action_mask(0) == [1, 1, 1, 1]
    assert game.action_mask(1) == [0, 1, 1, 1]
    cardinal = one_agent(open_map(2, 2), (0, 1), 0, (1, 0), action_model="cardinal")
    assert cardinal.action_mask(0) == [1, 0, 1, 1, 0]  # wait, up, down, left, right


# What happens at goals.


def test_all_on_their_goals_terminates():
    game = Reference(open_map(1, 4), [(0, 0), (0, 3)], [EAST, EAST], [[(0, 1)], [(0, 3)]], max_steps=2)
    game.step([WAIT, WAIT])
    assert (game.terminated, game.truncated, game.rewards) == ([False, False], False, [0, 20])
    game.step([FORWARD, WAIT])
    assert (game.terminated, game.truncated, game.rewards) == ([True, True], False, [20, 0])
    assert game.metrics() == {"CSR": 1, "ISR": 1, "SoC": 3, "makespan": 2, "ep_length": 2, "SoC_ratio": 1.5}


def test_time_limit_truncates():
    game = one_agent(open_map(1, 3), (0, 0), EAST, (0, 2), max_steps=1)
    game.step([FORWARD])
    assert (game.terminated, game.truncated) == ([False], True)
    assert game.metrics() == {"CSR": 0, "ISR": 0, "SoC": 1, "makespan": 1, "ep_length": 1, "SoC_ratio": 0.5}


def test_leaving_the_goal_starts_the_count_again_but_pays_once():
    game = Reference(open_map(1, 4), [(0, 0), (0, 3)], [EAST, WEST], [[(0, 1)], [(0, 3)]])
    rewards = []
    for action in (FORWARD, FORWARD, RIGHT, RIGHT, FORWARD):
        game.step([action, RIGHT if game.step_count == 4 else WAIT])
        rewards.append(game.rewards[0])
    assert rewards == [20, 0.1, 0.01, 0.01, 0.1]
    assert game.metrics()["SoC"] == 5 + 1


def test_finish_disappears_and_lets_others_pass():
    game = Reference(
        open_map(1, 4), [(0, 0), (0, 1)], [EAST, EAST], [[(0, 3)], [(0, 2)]], on_target="finish", view_size=(1, 1)
    )
    game.step([WAIT, FORWARD])
    assert (game.active, game.terminated, game.truncated) == ([True, False], [False, True], False)
    assert game.observe(1)["goal"] == [[[1.0]]]
    game.step([FORWARD, WAIT])
    game.step([FORWARD, FORWARD])
    assert game.positions == [(0, 2), (0, 2)]
    assert game.rewards == [0.1, 0]
    assert game.observe(1) == {"view": [[[0]]], "goal": [[[0]]], "orientation": [[[0]]], "edge_weights": [[[0]]] * 4}
    assert game.action_mask(1) == [0, 0, 0, 1]
    game.step([FORWARD, WAIT])
    assert game.terminated == [True, True]
    assert game.metrics() == {"CSR": 1, "ISR": 1, "SoC": 5, "makespan": 4, "ep_length": 2.5, "SoC_ratio": 1.25}


def test_restart_gives_the_next_goal_and_wraps_round():
    game = Reference(
        open_map(1, 2), [(0, 0)], [EAST], [[(0, 1), (0, 0)]], on_target="restart", action_model="cardinal", max_steps=4
    )
    goals, rewards = [], []
    for action in (CardinalAction.RIGHT, CardinalAction.LEFT, CardinalAction.WAIT, CardinalAction.RIGHT):
        game.step([action])
        goals.append(game.goals[0])
        rewards.append(game.rewards[0])
    assert goals == [(0, 0), (0, 1), (0, 1), (0, 0)]
    assert rewards == [20, 20, 0, 20]
    assert (game.terminated, game.truncated) == ([False], True)
    assert game.metrics() == {"avg_throughput": 0.75, "ep_length": 4, "exhausted_agents": 1}


# Rewards.


@pytest.mark.parametrize(("pays", "reward"), [(False, 0), (True, 0.1)])
def test_blocked_forward(pays, reward):
    config = RewardConfig(pay_blocked_forward=pays)
    game = one_agent(open_map(1, 2), (0, 0), NORTH, (0, 1), rewards=config)
    game.step([FORWARD])
    assert (game.rewards, game.blocked, game.moved) == ([reward], [True], [False])


def test_progress_step_cost_blocked_and_team_goal():
    config = RewardConfig(forward=0, rotate=0, goal=0, progress=0.5, step_cost=0.25, blocked=0.125, team_goal=2)
    game = one_agent(open_map(1, 3), (0, 0), EAST, (0, 2), rewards=config)
    rewards = []
    for action in (LEFT, FORWARD, RIGHT, FORWARD, FORWARD):
        game.step([action])
        rewards.append(game.rewards[0])
    assert rewards == [-0.75, -0.375, 0.25, 0.25, 2.5]


def test_sharing_is_the_mean_of_the_near():
    config = RewardConfig(forward=1, rotate=4, wait=0, share=0.5, share_radius=1)
    free = open_map(2, 4)
    goals = [[(1, 3)], [(1, 2)], [(0, 2)], [(1, 0)]]
    game = Reference(free, [(0, 0), (0, 1), (1, 1), (0, 3)], [SOUTH, EAST, EAST, EAST], goals, rewards=config)
    game.step([FORWARD, LEFT, WAIT, RIGHT])
    assert game.rewards == [1 + 0.5 * 2, 4 + 0.5 * 0.5, 0.5 * 2.5, 4]


# Observations.


def test_default_channels_look_forward():
    free = open_map(3, 3, obstacles=[(0, 1)])
    game = Reference(free, [(1, 1), (1, 2)], [EAST, NORTH], [[(0, 2)], [(2, 0)]], view_size=(2, 3))
    seen = game.observe(0)
    assert seen["view"] == [[[0, 0.5, 0], [1, 0, 0]]]  # ahead: column 2 from north to south
    assert seen["goal"] == [[[1, 0, 0], [0, 0, 0]]]
    assert seen["orientation"] == [[[0, 1, 0], [0, 0.25, 0]]]  # the other looks to the left
    forward, right, back, left = seen["edge_weights"]
    assert forward == [[-1, -1, -1], [-1, 1, 1]]
    assert right == [[1, 1, -1], [-1, 1, -1]]
    assert back == [[-1, 1, 1], [-1, 1, 1]]
    assert left == [[-1, 1, 1], [-1, -1, 1]]


def test_outside_is_obstacle_with_weight_zero():
    game = one_agent(open_map(1, 1), (0, 0), NORTH, (0, 0), view_size=(2, 2), view="centered", frame="map")
    assert game.observe(0)["view"] == [[[1, 1], [1, 0]]]
    assert game.observe(0)["edge_weights"] == [[[0, 0], [0, -1]]] * 4


def test_map_frame_keeps_north_up():
    game = Reference(
        open_map(3, 3), [(1, 1), (0, 2)], [SOUTH, WEST], [[(2, 0)], [(0, 1)]], view_size=(3, 3), view="centered",
        frame="map", channels=("view", "goal", "orientation", "other_goals", "others_next", "others_at_goal"),
    )  # fmt: skip
    seen = game.observe(0)
    assert seen["view"] == [[[0, 0, 0.5], [0, 0, 0], [0, 0, 0]]]
    assert seen["goal"] == [[[0, 0, 0], [0, 0, 0], [1, 0, 0]]]
    assert seen["orientation"] == [[[0, 0, 0.75], [0, 0.5, 0], [0, 0, 0]]]
    assert seen["other_goals"] == [[[0, 1, 0], [0, 0, 0], [0, 0, 0]]]
    assert seen["others_next"] == [[[0, 1, 0], [0, 0, 0], [0, 0, 0]]]
    assert seen["others_at_goal"] == [[[0, 0, -1], [0, 0, 0], [0, 0, 0]]]


def test_others_heuristic_shows_where_others_come_closer_to_their_goals():
    game = Reference(
        open_map(2, 3), [(0, 0), (0, 1)], [EAST, NORTH], [[(0, 2)], [(1, 2)]], view_size=(3, 3), view="centered",
        frame="map", channels=("others_heuristic",),
    )  # fmt: skip
    none, there = [[0, 0, 0]] * 3, [[0, 0, 0], [0, 0, 1], [0, 0, 0]]
    assert game.observe(0)["others_heuristic"] == [there, there, none, none]  # east, south


def test_cost_to_go_and_heuristic():
    game = one_agent(
        open_map(1, 4, obstacles=[(0, 0)]), (0, 2), WEST, (0, 3), view_size=(1, 3), view="centered", frame="map",
        channels=("cost_to_go", "heuristic"),
    )  # fmt: skip
    seen = game.observe(0)
    assert seen["cost_to_go"] == [[[(3 - 2) / 4, (3 - 1) / 4, 3 / 4]]]  # two turns and a move from here
    assert seen["heuristic"] == [[[1, 1, 0]], [[0, 0, 0]], [[0, 0, 0]], [[0, 0, 0]]]


def test_walls_hide_what_is_behind_them():
    free = open_map(3, 5, obstacles=[(1, 2)])
    game = Reference(
        free, [(1, 1), (1, 3), (0, 2)], [EAST, EAST, WEST], [[(1, 3)], [(1, 3)], [(2, 2)]], view_size=(3, 5),
        view="centered", frame="map", see_through_walls=False, channels=("view", "goal", "orientation", "other_goals"),
    )  # fmt: skip
    seen = game.observe(0)
    # The line to (0, 3) passes (0, 2), which is free: rounding leads half steps away from the observer.
    assert seen["view"] == [[[1, 0, 0, 0.5, 0], [1, 0, 0, 1, -1], [1, 0, 0, 0, 0]]]
    assert seen["goal"] == [[[0, 0, 0, 0, 0], [0, 0, 0, 0, 1], [0, 0, 0, 0, 0]]]
    assert seen["orientation"] == [[[0, 0, 0, 0.75, 0], [0, 0, 0.25, 0, 0], [0, 0, 0, 0, 0]]]
    assert seen["other_goals"] == [[[0, 0, 0, 0, 0], [0, 0, 0, 0, 0], [0, 0, 0, 1, 0]]]


def test_next_cell_prefers_straight_then_right():
    game = one_agent(open_map(3, 3), (1, 1), EAST, (1, 0))
    assert game.next_cell(0) == (1, 0)
    game = one_agent(open_map(3, 3), (1, 1), EAST, (2, 2))
    assert game.next_cell(0) == (1, 2)
    game = one_agent(open_map(3, 3, obstacles=[(1, 0), (0, 1)]), (1, 1), EAST, (0, 0))
    assert game.next_cell(0) is None
    cardinal = one_agent(open_map(3, 3), (1, 1), 0, (2, 2), action_model="cardinal")
    assert cardinal.next_cell(0) == (1, 2)


def test_features():
    names = ("goal_vector", "location", "action_advantage", "last_actions", "time")
    game = one_agent(open_map(4, 4), (3, 0), EAST, (0, 3), features=names, num_last_actions=2, max_steps=8)
    half = 1 / sqrt(2)
    assert game.feature(0)["goal_vector"] == pytest.approx([half, -half, log1p(sqrt(18)) / log1p(8), 0])
    assert game.feature(0)["action_advantage"] == [0, -0.5, -1, -0.5]  # forward, left (one turn more), right, wait
    assert game.feature(0)["last_actions"] == [0] * 10
    game.step([FORWARD])
    game.step([LEFT])
    seen = game.feature(0)
    assert seen["location"] == [0.75, 0.25, 0, 0, 0, 1]
    assert seen["last_actions"] == [0, 1, 0, 0, 0] + [1, 0, 0, 0, 1]
    assert seen["time"] == [0.25]


def test_features_at_the_goal():
    names = ("goal_vector", "action_advantage")
    game = one_agent(open_map(1, 2), (0, 1), EAST, (0, 1), features=names)
    assert game.feature(0) == {"goal_vector": [0, 0, 0, 1], "action_advantage": [-1, -0.5, -0.5, 0]}
