import numpy as np

from mapf_pz.render.ansi import draw

FREE = np.array([[True, True, True, False], [True, True, True, True]])


def test_headings_goals_and_obstacles():
    positions = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])
    goals = np.array([[1, 2], [1, 3], [0, 2], [0, 0]])
    assert draw(FREE, positions, np.arange(4), goals) == ">vx@\n<^xx\n"


def test_agents_on_their_goals_are_letters():
    positions = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])
    assert draw(FREE, positions, np.arange(4), positions) == "ES.@\nWN..\n"


def test_agent_on_the_goal_of_another_is_an_arrow():
    assert draw(FREE, np.array([[0, 0], [0, 1]]), np.array([0, 0]), np.array([[0, 1], [1, 3]])) == ">>.@\n...x\n"


def test_agents_without_headings():
    assert draw(FREE, np.array([[0, 0], [1, 1]]), None, np.array([[0, 0], [1, 2]])) == "O..@\n.ox.\n"


def test_inactive_agent_is_omitted_with_its_goal():
    positions, goals = np.array([[0, 0], [1, 1]]), np.array([[0, 2], [1, 2]])
    assert draw(FREE, positions, np.array([0, 1]), goals, np.array([False, True])) == "...@\n.vx.\n"


def test_delayed_agents_are_another_letter():
    positions = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])
    goals = np.array([[0, 0], [0, 1], [1, 2], [1, 3]])
    delayed = np.array([True, False, True, False])
    for headings, expected in ((np.arange(4), "ZS.@\nz^xx\n"), (None, "ZO.@\nzoxx\n")):
        assert draw(FREE, positions, headings, goals, delayed=delayed) == expected
