"""Planners decide as recorded. Opt-in, since any better heuristic decides otherwise: set MAPF_PZ_DECISIONS=1.

Published results of a planner are valid for the recorded decisions: see `tests/helpers/decisions.py`.
"""

import os

import numpy as np
import pytest

from tests.helpers.decisions import RECORDING, cases, decided, difference

CASES = cases()
pytestmark = pytest.mark.skipif(
    not os.environ.get("MAPF_PZ_DECISIONS"), reason="a regression of decisions: set MAPF_PZ_DECISIONS=1 to compare them"
)


@pytest.fixture(scope="module")
def recorded():
    with np.load(RECORDING) as arrays:
        return dict(arrays)


def test_every_case_is_recorded(recorded):
    assert recorded.keys() == CASES.keys()


@pytest.mark.parametrize("name", list(CASES))
def test_it_decides_as_recorded(name, recorded):
    changed = difference(recorded[name], decided(CASES[name]))
    assert changed is None, f"{name}: {changed}"
