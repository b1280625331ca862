"""Files are written as a whole or not at all."""

import errno
import re
from pathlib import Path

import numpy as np
import pytest

from mapf_pz._internal.atomic import naming, replacing, write_whole
from mapf_pz._internal.text import read_bytes
from mapf_pz.errors import FormatError
from mapf_pz.instances import Grid, Instance, Scenario, write_map, write_scenario
from mapf_pz.planners import Plan
from mapf_pz.planners.plans.files import write_plan

GRID = Grid(np.ones((1, 2), np.bool_), "tiny")
SCENARIO = Scenario([[0, 0]], [[0, 1]])


def test_a_file_is_replaced_when_it_is_complete(tmp_path):
    file = tmp_path / "table.md"
    write_whole(file, b"old")
    with replacing(file) as beside:
        beside.write_bytes(b"new")
        assert file.read_bytes() == b"old"
        assert beside.suffix == ".md"  # those who save pictures look at it
    assert file.read_bytes() == b"new"
    assert list(tmp_path.iterdir()) == [file]


def test_two_processes_write_a_file_at_the_same_time(tmp_path):
    file = tmp_path / "table.md"
    with replacing(file) as first, replacing(file) as second:
        first.write_bytes(b"first")
        second.write_bytes(b"second")
    assert file.read_bytes() == b"first"
    assert list(tmp_path.iterdir()) == [file]


def _write_map(file):
    write_map(GRID, file)


def _write_scenario(file):
    write_scenario(SCENARIO, GRID, file)


def _write_plan(file):
    write_plan(Plan(np.array([[[0, 0]], [[0, 1]]])), file, Instance(GRID, SCENARIO))


@pytest.mark.parametrize(
    ("name", "write"),
    [("a.map", _write_map), ("a.scen", _write_scenario), ("a.txt", _write_plan), ("a.csv", _write_plan)],
)
def test_a_full_disk_keeps_the_old_file(tmp_path, monkeypatch, name, write):
    file = tmp_path / name
    file.write_bytes(b"old")

    def fill(path, content):
        path.open("wb").close()
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", fill)
    monkeypatch.setattr(Path, "write_text", fill)
    with pytest.raises(OSError, match=rf"^\[Errno 28\] No space left on device: '{re.escape(str(file))}'$"):
        write(file)
    assert file.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [file]


@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "No space left on device"), KeyboardInterrupt()])
def test_failures_change_nothing(tmp_path, error):
    file = tmp_path / "table.md"
    write_whole(file, b"old")

    def write():
        with replacing(file) as beside:
            beside.write_bytes(b"ne")
            raise error

    with pytest.raises(type(error)) as caught:
        write()
    assert file.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [file]
    if isinstance(error, OSError):
        assert str(caught.value) == f"[Errno 28] No space left on device: '{file}'"


def test_no_folder(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"No such file or directory: '.*absent/a.md'"):
        write_whole(tmp_path / "absent" / "a.md", b"")


def test_errors_name_what_they_are_about(tmp_path):
    with pytest.raises(OSError, match=r"^run: encoder error -2$"), naming(tmp_path.relative_to(tmp_path) / "run"):
        raise OSError("encoder error -2")
    with pytest.raises(FileNotFoundError, match="inner"), naming(tmp_path):
        (tmp_path / "inner").read_bytes()


@pytest.mark.skipif(not Path("/proc/version").exists(), reason="there is no /proc")
def test_a_file_that_states_no_size_is_read_to_its_end():
    file = Path("/proc/version")
    assert file.stat().st_size == 0
    assert read_bytes(file) == file.read_bytes() != b""
    with pytest.raises(FormatError, match="expected at most 5 bytes"):
        read_bytes(file, 5)
