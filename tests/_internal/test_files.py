"""Files are written as a whole or not at all."""

import errno

import pytest

from mapf_pz._internal.atomic import naming, replacing, write_whole


def test_a_file_is_replaced_when_it_is_complete(tmp_path):
    file = tmp_path / "table.md"
    write_whole(file, b"old")
    with replacing(file) as beside:
        beside.write_bytes(b"new")
        assert file.read_bytes() == b"old"
        assert beside.suffix == ".md"  # those who save pictures look at it
    assert file.read_bytes() == b"new"
    assert list(tmp_path.iterdir()) == [file]


def test_a_link_in_the_place_of_the_temporary_file_is_not_followed(tmp_path):
    (other := tmp_path / "other").write_bytes(b"kept")
    with replacing(tmp_path / "table.md") as beside:
        pass
    beside.symlink_to(other)
    write_whole(tmp_path / "table.md", b"new")
    assert (other.read_bytes(), (tmp_path / "table.md").read_bytes()) == (b"kept", b"new")
    assert not (tmp_path / "table.md").is_symlink()


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
