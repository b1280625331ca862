"""Files that are spoilt: what must come of reading them, and how they are changed."""

import json
import re
import tracemalloc
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

from mapf_pz.errors import FormatError

MEGABYTE = 2**20
DEEPEST = 400
"""Opening brackets in a JSON file that is still changed as JSON."""
REFUSALS = (FormatError, ValueError, FileNotFoundError)


def outcome(read):
    """Return what is read, or None where it is refused in one line by an error that a reader may raise."""
    try:
        return read()
    except REFUSALS as caught:
        error = caught
    message = str(error)
    assert type(error) in REFUSALS, repr(error)
    assert len(message.splitlines()) == 1, repr(message)
    assert len(message) < 1500, message
    return None


def refused(read, pattern=None):
    """Check that a file is refused in one line, which `pattern` is found in."""
    with pytest.raises(REFUSALS, match=pattern):
        read()
    assert outcome(read) is None


def near_misses(text, separators="\n,09#[{"):
    """Texts that differ from `text` in one replaced part, often by a single separator."""
    inserted = st.text(max_size=6) | st.sampled_from(separators)
    cut = st.tuples(st.integers(0, len(text)), st.integers(0, 12), inserted)
    return cut.map(lambda c: text[: c[0]] + c[2] + text[c[0] + c[1] :])


@contextmanager
def bounded(megabytes=200):
    """Check that what is done inside takes little memory."""
    tracemalloc.start()
    try:
        yield
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < megabytes * MEGABYTE, f"{peak / MEGABYTE:.0f} MB"


@dataclass(frozen=True)
class Case:
    """Files by name, those of them that are changed, and how they are read."""

    files: dict
    read: object
    changed: tuple = ()

    def written(self, folder, changes=()):
        """Write the files, with others in place of some, and return a call that reads them."""
        for name, content in (self.files | dict(changes)).items():
            (folder / name).write_bytes(content)
        return partial(self.read, folder)


def as_json(value):
    return json.dumps(value).encode()


# Changes of bytes.

NUMBER = re.compile(rb"-?\d+(?:\.\d+)?")
NUMBERS = [b"", b"0", b"-1", b"1.5", b"nan", b"-inf", b"1e999", b"%d" % 2**31, b"%d" % 2**63, b"9" * 9, b"9" * 10_000]
TOKENS = [
    *NUMBERS,
    *(b"\0", b"\n", b"\r", b"\r\n", b"\t", b" ", b",", b'"', b"[", b"{", b"}", b"\\", b"\xef\xbb\xbf", b"\xff"),
    *("\ud800".encode("utf-8", "surrogatepass"), "\u2028".encode(), "\u0663".encode(), "Straße".encode()),
    *(b"[" * 100_000, b'{"a":' * 500, b"x" * 5000, b"../", b"/", b"null", b"true", b"NaN"),
]
LEAVES = st.sampled_from(
    [
        None,
        True,
        False,
        0,
        -1,
        1.5,
        2,
        2**31,
        2**64,
        10**400,
        float("nan"),
        float("inf"),
        "",
        "x",
        "a\nb",
        "\0",
        "\ud800",
    ]
    + ["../tiny.map", "/etc/passwd", "x" * 5000, "x" * 5000 + ".map", ".", "tiny.map", [], {}]
)
VALUES = st.recursive(
    LEAVES, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=2), inner), max_leaves=4
)


@st.composite
def changed_json(draw, content):
    """Put another value in some place of a JSON file, or a key in some object, or a deep nest in one."""
    # Whether deeper JSON can be parsed depends on how deep the caller's stack is, and a strategy must not.
    if content.count(b"[") + content.count(b"{") > DEEPEST:
        return content
    try:
        root = json.loads(content)
    except ValueError:
        return content
    box = [root]
    places = [(box, 0)]
    for holder, key in places:
        held = holder[key]
        inside = held if isinstance(held, dict) else range(len(held)) if isinstance(held, list) else ()
        places.extend((held, part) for part in inside)
    holder, key = draw(st.sampled_from(places))
    change = draw(st.sampled_from(["replace", "nest", "remove", "add"]))
    if change == "remove" and holder is not box:
        del holder[key]
    elif change == "add" and isinstance(holder, dict):
        holder[draw(st.sampled_from(["x", "a\nb", "y" * 3000]) | st.text(max_size=3))] = draw(VALUES)
    elif change == "nest":
        for _ in range(draw(st.sampled_from([1, 30, 150]))):
            holder[key] = [holder[key]]
    else:
        holder[key] = draw(VALUES)
    return json.dumps(box[0]).encode()


@st.composite
def changed_bytes(draw, content):
    """Cut, splice, repeat or replace some bytes."""
    change = draw(st.sampled_from(["splice", "cut", "repeat", "number", "truncate"]))
    if change == "number" and (numbers := list(NUMBER.finditer(content))):
        number = draw(st.sampled_from(numbers))
        return content[: number.start()] + draw(st.sampled_from(NUMBERS)) + content[number.end() :]
    if change == "repeat":
        lines = content.splitlines(keepends=True) or [b""]
        line = draw(st.integers(0, len(lines) - 1))
        return b"".join(lines[: line + 1] * draw(st.integers(1, 2)) + lines[line:])
    first, second = sorted(draw(st.tuples(*[st.integers(0, len(content))] * 2)))
    if change == "truncate":
        return content[:first]
    new = b"" if change == "cut" else draw(st.sampled_from(TOKENS) | st.binary(max_size=4))
    return content[:first] + new + content[draw(st.sampled_from([first, first, second])) :]


@st.composite
def changed(draw, content, others=()):
    """Change a file one to three times, or have any bytes or another file in its place."""
    if draw(st.integers(0, 19)) == 0:
        return draw(st.binary(max_size=40) | st.sampled_from([content, *others]))
    for _ in range(draw(st.integers(1, 3))):
        content = draw(changed_bytes(content) | changed_json(content))
    return content


# The same examples in every run, as a test that fails once in twenty runs would stop changes that have no part in it.
fuzzed = settings(max_examples=100, derandomize=True, suppress_health_check=list(HealthCheck))
