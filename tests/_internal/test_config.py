"""Configurations: what their fields accept, and errors of one line."""

from __future__ import annotations

import dataclasses
import math
import pickle
from dataclasses import dataclass, field
from typing import Annotated, Literal

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from mapf_pz._internal.config import (
    Coefficient,
    Count,
    Items,
    Natural,
    Positive,
    Share,
    checked,
    complaint,
    expecting,
    name_or_part,
)


@checked
@dataclass(frozen=True)
class Part:
    """A part."""

    count: Count = 1
    natural: Natural = 0
    positive: Positive = 1.0
    coefficient: Coefficient = 0.0
    share: Share = 0.5
    flag: bool = False
    kind: Literal["first", "second"] = "first"
    name: Annotated[str, name_or_part(["one", "two"])] = "one"
    several: Items[Count] = ()
    either: Annotated[Count | Literal["auto"], expecting("1 or more, or 'auto'")] = 1


@checked
@dataclass(frozen=True)
class Whole:
    """A configuration with a part."""

    size: Count
    part: Part = field(default_factory=Part)

    def __post_init__(self) -> None:
        """Check fields that depend on each other."""
        if self.size < self.part.count:
            raise OwnError(f"size={self.size}: expected {self.part.count} or more")


class OwnError(ValueError):
    """An error of its own."""


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("count", [1, 10**12, np.int32(3)]),
        ("natural", [0]),
        ("positive", [1e-9, 2, np.float64(0.5)]),
        ("coefficient", [0, 0.0, 1e9]),
        ("share", [0, 1, 0.3]),
        ("flag", [True]),
        ("kind", ["second"]),
        ("name", ["two", "package.module:name"]),
        ("several", [(1, 2), [1, 2], range(1, 3)]),
        ("either", [3, "auto"]),
    ],
)
def test_values_are_kept(name, values):
    for value in values:
        kept = getattr(Part(**{name: value}), name)
        assert kept == (tuple(value) if name == "several" else value)
    assert Part(several=[1]) == Part(several=(1,))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"count": 0}, "count=0: expected a whole number, 1 or more"),
        ({"count": "3"}, "count='3': expected a whole number"),
        ({"count": 2.0}, "count=2.0: expected a whole number"),
        ({"count": True}, "count=True: expected a whole number"),
        ({"count": None}, "count=None: expected a whole number"),
        ({"natural": -1}, "natural=-1: expected a whole number, 0 or more"),
        ({"positive": 0}, "positive=0: expected a number greater than 0"),
        ({"positive": "1"}, "positive='1': expected a number"),
        ({"positive": False}, "positive=False: expected a number"),
        ({"positive": math.inf}, "positive=inf: expected a finite number"),
        ({"coefficient": -0.5}, "coefficient=-0.5: expected a number, 0 or more"),
        ({"coefficient": math.nan}, "coefficient=nan: expected a finite number"),
        ({"share": 1.5}, "share=1.5: expected at most 1"),
        ({"flag": 1}, "flag=1: expected True or False"),
        ({"kind": "third"}, "kind='third': expected one of 'first', 'second'"),
        ({"name": "three"}, "name='three': expected one of 'one', 'two', or package.module:name"),
        ({"name": 3}, "name=3: expected text"),
        ({"several": "12"}, "several='12': expected a tuple or list"),
        ({"several": (1, 0)}, "several[1]=0: expected a whole number, 1 or more"),
        ({"either": 0}, "either=0: expected 1 or more, or 'auto'"),
        ({"either": "many"}, "either='many': expected 1 or more, or 'auto'"),
    ],
)
def test_other_values_are_refused(fields, message):
    for make in (lambda: Part(**fields), lambda: dataclasses.replace(Part(), **fields)):
        with pytest.raises(ValueError) as caught:  # noqa: PT011, the message is compared below
            make()
        assert (type(caught.value), str(caught.value)) == (ValueError, message)


def test_arguments_of_another_type_or_number_are_refused():
    with pytest.raises(TypeError, match=r"^unknown keyword 'counts': did you mean 'count'\?$"):
        Part(counts=1)
    for make in (lambda: Whole(), lambda: Whole(1, Part(), 3)):
        with pytest.raises(TypeError, match="argument"):
            make()
    with pytest.raises(ValueError, match=r"^part=\{'count': 1\}: expected an instance of Part$"):
        Whole(1, {"count": 1})


def test_an_error_of_a_configuration_stays_what_it_is():
    with pytest.raises(OwnError, match=r"^size=1: expected 2 or more$"):
        Whole(1, Part(count=2))


def test_they_remain_dataclasses():
    whole = Whole(3, Part(several=[1]))
    assert pickle.loads(pickle.dumps(whole)) == whole == dataclasses.replace(whole)
    assert len({whole, Whole(3, part=Part(several=(1,)))}) == 1
    with pytest.raises(dataclasses.FrozenInstanceError):
        whole.size = 4


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"size": 2, "part": {"count": 0}}', "part.count=0: expected a whole number, 1 or more"),
        ('{"size": 2, "part": {"count": 2.0}}', "part.count=2.0: expected a whole number"),
        ('{"size": 2, "part": {"several": [1, 0]}}', "part.several[1]=0: expected a whole number, 1 or more"),
        ('{"size": 2, "part": {"counts": 0}}', "part.counts: unknown field, which may be one of another version"),
        ('{"part": {}}', "size: expected a value"),
        ('{"size": 2, "part": {"count": 3}}', "size=2: expected 3 or more"),
    ],
)
def test_files_are_checked_alike(text, message):
    with pytest.raises(ValidationError) as caught:
        TypeAdapter(Whole).validate_json(text)
    assert complaint(caught.value) == message


def test_files_are_read_back():
    adapter, whole = TypeAdapter(Whole), Whole(3, Part(several=[1, 2], share=1))
    assert adapter.validate_json(adapter.dump_json(whole)) == whole
