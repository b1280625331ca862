import numpy as np
import pytest

from mapf_pz.planners import EPIBT, LaCAM, PrioritizedSIPP, WindowedLNS
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


@pytest.mark.parametrize("planner", [LaCAM(), PrioritizedSIPP(), EPIBT(), WindowedLNS(time_limit=1)])
def test_planners_use_their_clock(planner):
    planner.clock = HandClock(pace=50)
    assert planner.solve(drawn("a....A"), time_limit=20) is None
    assert planner.solve(drawn("a....A"), time_limit=2000) is not None
