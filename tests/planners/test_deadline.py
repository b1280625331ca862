import numpy as np
import pytest

from mapf_pz.instances import RandomObstacles
from mapf_pz.planners import EPIBT, LaCAM, PrioritizedSIPP, WindowedLNS
from mapf_pz.planners.base import Planner
from mapf_pz.planners.deadline import Deadline
from tests.helpers.hand_clock import HandClock
from tests.helpers.text_instances import drawn


def test_the_clock_decides():
    clock = HandClock()
    deadline = Deadline(5, clock)
    assert not deadline.has_passed
    assert deadline.seconds_left == 5
    clock.now = 105
    assert deadline.has_passed
    assert deadline.seconds_left == 0


def test_no_time_limit():
    assert not Deadline(np.inf).has_passed


def test_no_time():
    assert Deadline(0).has_passed


def test_the_earlier_of_two_deadlines():
    clock = HandClock()
    deadline = Deadline(5, clock)
    clock.now = 101
    assert deadline.earlier(3).seconds_left == 3
    assert deadline.earlier(30).seconds_left == 4
    clock.now = 104.5
    assert deadline.earlier(3).seconds_left == 0.5


@pytest.mark.parametrize("planner", [LaCAM, PrioritizedSIPP])
@pytest.mark.parametrize("headings", [None, [0, 0]])
def test_a_clock_of_work_gives_the_same_plans_on_any_machine(planner, headings, monkeypatch):
    instance = drawn("aB..... .#.#.#. .....bA", headings)
    plans = []
    for pace in (0.0, 50.0):  # a machine that is not slow, and one that is
        monkeypatch.setattr(Planner, "clock", HandClock(pace))
        plans.append(planner(clock="work").solve(instance, time_limit=0.02))
    np.testing.assert_array_equal(plans[0].positions, plans[1].positions)
    assert planner(clock="work").solve(instance, time_limit=0) is None


def test_more_work_does_not_lengthen_paths():
    instance = RandomObstacles(16, 16, 0.2, 40).sample(np.random.default_rng(0))
    costs = [LaCAM(clock="work").solve(instance, time_limit=limit).sum_of_costs for limit in (0.01, 0.1, 0.4)]
    assert costs == sorted(costs, reverse=True)
    assert costs[0] > costs[2]


@pytest.mark.parametrize("planner", [LaCAM, PrioritizedSIPP])
def test_an_unknown_clock(planner):
    with pytest.raises(ValueError, match=r"^clock='cpu': expected one of wall, work$"):
        planner(clock="cpu")


@pytest.mark.parametrize("planner", [LaCAM(), PrioritizedSIPP(), EPIBT(), WindowedLNS(time_limit=1)])
def test_planners_use_their_clock(planner):
    planner.clock = HandClock(pace=50)
    assert planner.solve(drawn("a....A"), time_limit=20) is None
    assert planner.solve(drawn("a....A"), time_limit=2000) is not None
