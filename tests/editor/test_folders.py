"""Files: only inside the folders."""

import os

import pytest

from mapf_pz.editor.folders import Folders


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "files"


def test_entries_are_sorted(server, folder):
    (folder / "b.map").write_text("12345")
    (folder / "a").mkdir()
    os.mkfifo(folder / "pipe")
    entries = [{"name": "a", "folder": True, "size": 0}, {"name": "b.map", "folder": False, "size": 5}]
    assert server.call("list", path=str(folder)) == {"path": str(folder), "entries": entries}
    assert server.call("list", path=str(folder / "a" / ".."))["path"] == str(folder)
    assert server.call("names")["folders"] == [str(folder)]


def test_a_file_is_saved_and_opened(server, folder):
    path, text = str(folder / "a.map"), "line ä\r\nline\n"
    assert server.call("save", path=path, text=text) == {"path": path}
    assert (folder / "a.map").read_bytes() == text.encode()
    assert server.call("open", path=path) == {"name": "a.map", "text": text}
    assert [file.name for file in folder.iterdir()] == ["a.map"]


def test_a_file_is_overwritten_only_if_that_is_wanted(server, folder):
    file = folder / "a.map"
    file.write_text("old")
    status, answer = server.post("save", f'{{"path": "{file}", "text": "new"}}')
    assert (status, answer) == (409, {"error": f"{file}: the file exists", "exists": True})
    assert file.read_text() == "old"
    server.call("save", path=str(file), text="new", overwrite=True)
    assert file.read_text() == "new"


def outside(folder):
    """Return paths outside the folder by how they lead there, below one of which is `secret.txt`."""
    secret = folder.parent / "elsewhere"
    secret.mkdir()
    (secret / "secret.txt").write_text("secret")
    (folder / "link").symlink_to(secret)
    (folder / "linked.txt").symlink_to(secret / "secret.txt")
    (folder.parent / "files2").mkdir()
    return {
        "absolute": secret / "secret.txt",
        "up": folder / ".." / "elsewhere" / "secret.txt",
        "link to a folder": folder / "link" / "secret.txt",
        "link to a file": folder / "linked.txt",
        "the same start": folder.parent / "files2" / "new.txt",
        "up through a link": folder / "link" / ".." / "new.txt",
        "relative": os.path.relpath(secret / "secret.txt"),
    }


def test_nothing_outside_is_read_or_written(server, folder):
    for how, path in outside(folder).items():
        for function, members in (("open", {}), ("list", {}), ("save", {"text": "x", "overwrite": True})):
            status, error = server.refused(function, path=str(path), **members)
            assert (status, error) == (403, f"{path}: expected a path inside {folder}"), how
        assert server.refused("open", problem=f"{path}")[0] == 403, how
    assert (folder.parent / "elsewhere" / "secret.txt").read_text() == "secret"
    assert not (folder.parent / "new.txt").exists()
    assert server.call("list", path=str(folder))["entries"] == []


def test_a_link_inside_is_followed(server, folder):
    (folder / "a.map").write_text("text")
    (folder / "b.map").symlink_to(folder / "a.map")
    assert server.call("open", path=str(folder / "b.map"))["text"] == "text"
    server.call("save", path=str(folder / "b.map"), text="new", overwrite=True)
    assert (folder / "a.map").read_text() == "new"


def test_what_cannot_be_saved(server, folder):
    (folder / "folder.map").mkdir()
    os.mkfifo(folder / "pipe.txt")
    for name, error in {
        "a.py": "expected a file name that ends in .map, .scen, .json, .svg, .txt, .csv",
        ".map": "expected a file name that ends in",
        "no/a.map": "no such folder",
        "folder.map": "expected a file, got a folder or device",
        "pipe.txt": "expected a file, got a folder or device",
        "a\0.map": "expected a path without null characters, got",
        "a" * 300 + ".map": "File name too long",
    }.items():
        status, message = server.refused("save", path=str(folder / name), text="x", overwrite=True)
        assert status == 400
        assert error in message
    assert server.refused("save", path=str(folder / "a.map"), text="\ud800")[0] == 400
    assert {file.name for file in folder.iterdir()} == {"folder.map", "pipe.txt"}


def test_what_cannot_be_opened(server, folder):
    (folder / "a.map").write_bytes(b"\xff")
    os.mkfifo(folder / "pipe.txt")
    for name, error in {
        "a.map": "expected UTF-8 text, got the byte 0xff",
        "b.map": "no such file",
        "": "expected a file, got a folder or device",
        "pipe.txt": "expected a file, got a folder or device",
    }.items():
        status, message = server.refused("open", path=str(folder / name))
        assert status == 400
        assert error in message
    assert server.refused("list", path=str(folder / "none"))[0] == 400


def test_a_folder_must_exist(tmp_path):
    with pytest.raises(NotADirectoryError, match="none: expected a folder"):
        Folders([tmp_path / "none"])
