import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from mapf_pz.instance import Grid, Instance, Scenario
from mapf_pz.planners import Plan, validate
from mapf_pz.render.violations import find_violations

FREE = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]], bool)


def texts(starts, goals, positions, headings=None):
    instance = Instance(Grid(FREE, "small"), Scenario(np.array(starts), np.array(goals)))
    return [violation.text for violation in find_violations(instance, np.array(positions), headings)]


def test_all_violations_are_found():
    positions = [[(0, 0), (0, 2), (2, 2)], [(0, 1), (0, 1), (2, 0)], [(0, 1), (1, 1), (2, 1)]]
    assert texts([(0, 0), (0, 2), (2, 2)], [(0, 1), (0, 2), (2, 1)], positions) == [
        "step 1: agent 0 and agent 1 at [row 0, col 1]: two agents on one cell",
        "step 1: agent 2 at [row 2, col 0]: not a move to an adjacent cell, or not straight ahead",
        "step 2: agent 1 at [row 1, col 1]: an obstacle, or outside the map",
        "step 2: agent 1 at [row 1, col 1]: not the agent's goal",
    ]


def test_a_swap_is_one_violation():
    positions = [[(0, 0), (0, 1)], [(0, 1), (0, 0)]]
    assert texts(positions[0], positions[1], positions) == [
        "step 1: agent 0 and agent 1 at [row 0, col 1] and [row 0, col 0]: two agents swap cells"
    ]


def test_agents_that_stay_on_one_cell_do_not_swap():
    positions = [[(0, 0), (0, 1)], [(0, 1), (0, 1)], [(0, 1), (0, 1)]]
    assert texts(positions[0], [(0, 1), (0, 2)], positions) == [
        "step 1: agent 0 and agent 1 at [row 0, col 1]: two agents on one cell",
        "step 2: agent 0 and agent 1 at [row 0, col 1]: two agents on one cell",
        "step 2: agent 1 at [row 0, col 1]: not the agent's goal",
    ]


def test_turns():
    positions = np.zeros((3, 1, 2), np.int64)
    assert texts([(0, 0)], [(0, 0)], positions, np.array([[0], [2], [3]])) == [
        "step 1: agent 0 at [row 0, col 0]: more than a quarter turn, or a turn during a move"
    ]


cells = st.tuples(st.integers(-1, 3), st.integers(-1, 3))


@settings(max_examples=300)
@given(
    st.lists(st.tuples(cells, cells, cells), min_size=1, max_size=4), st.booleans(), st.randoms(use_true_random=False)
)
def test_the_first_one_is_that_of_the_validator(positions, rotate, random):
    plan = Plan(
        np.array(positions),
        np.array([[random.randrange(4) for _ in range(3)] for _ in positions]) if rotate else None,
    )
    starts, goals = np.array([[0, 0], [0, 2], [2, 2]]), np.array([[2, 0], [0, 1], [1, 2]])
    instance = Instance(Grid(FREE, "small"), Scenario(starts, goals))
    expected = validate(instance, plan)
    found = find_violations(instance, plan.positions, plan.headings)
    first = [violation.text for violation in found if violation.step == found[0].step]
    assert (not found) if expected is None else str(expected) in first
