import csv

import pytest

from tests.helpers.decisions import RECORDING, cases, decided

CASES = cases()


def recorded():
    with RECORDING.open(newline="", encoding="utf-8") as file:
        return {row["case"]: (row["arrivals_or_cost"], row["digest"]) for row in csv.DictReader(file)}


def test_every_case_is_recorded():
    assert recorded().keys() == CASES.keys()


@pytest.mark.parametrize("name", list(CASES))
def test_it_decides_as_recorded(name):
    assert decided(CASES[name]) == recorded()[name]
