import hashlib
import io
import re
import stat
import subprocess
import sys
import threading
import zipfile
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest

from mapf_pz.commands.main import main
from mapf_pz.errors import FormatError
from mapf_pz.instances import format_map, format_scenario, load_map, load_scenario
from mapf_pz.instances.download import PIECE, download
from mapf_pz.instances.files import archive as archives
from mapf_pz.instances.files.archive import ARCHIVES, Archive, unpack
from mapf_pz.instances.instance import Grid, Scenario

GRID = Grid([[True, False, True], [True, True, True]], "tiny")
MAP = format_map(GRID)
SCENARIO = format_scenario(Scenario([[1, 0]], [[0, 2]]), GRID)


def zipped(members, compression=zipfile.ZIP_DEFLATED):
    """Return the bytes of a zip file of these texts, by name or `ZipInfo`."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", compression) as archive:
        for name, text in members.items():
            archive.writestr(name, text)
    return file.getvalue()


NOISE = bytes(np.random.default_rng(0).integers(256, size=100_000, dtype=np.uint8))
CONTENTS = {
    "maps.zip": zipped({"tiny.map": MAP, "__MACOSX/._tiny.map": "no map", "README.txt": NOISE}),
    "random.zip": zipped({"scen-random/": "", "scen-random/tiny-random-1.scen": SCENARIO}),
    "even.zip": zipped({"scen-even/tiny-even-1.scen": SCENARIO}),
}


class Server:
    """Serves `contents` on this machine; what it was asked for is in `requests`, as (name, first byte)."""

    def __init__(self):
        self.contents = dict(CONTENTS)
        self.requests = []
        self.knows_ranges = self.tells_size = True
        self.cut_after = None
        owner = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self):
                owner.answer(self)

            def log_message(self, *_):
                pass

        self.http = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.http.server_port}"
        threading.Thread(target=self.http.serve_forever, args=(0.01,), daemon=True).start()

    def answer(self, handler):
        name = handler.path.strip("/")
        asked = re.fullmatch(r"bytes=(\d+)-", handler.headers.get("Range", "bytes=0-"))
        self.requests.append((name, int(asked[1])))
        content = self.contents.get(name)
        first = int(asked[1]) if self.knows_ranges else 0
        if content is None:
            handler.send_error(404)
            return
        if first and first >= len(content):
            handler.send_error(416)
            return
        rest = content[first:]
        handler.send_response(206 if first else 200)
        if self.tells_size:
            handler.send_header("Content-Length", str(len(rest)))
        handler.end_headers()
        handler.wfile.write(rest[: self.cut_after])

    def archive(self, name):
        return Archive(f"{self.url}/{name}", hashlib.sha256(CONTENTS[name]).hexdigest())

    def close(self):
        self.http.shutdown()
        self.http.server_close()


@pytest.fixture
def server():
    server = Server()
    yield server
    server.close()


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """The folder of downloads, which is not there yet."""
    monkeypatch.delenv("MAPF_PZ_BENCHMARK", raising=False)
    monkeypatch.setenv("MAPF_PZ_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def served(server, monkeypatch):
    """The server, with the archives of the command on it."""
    for name in ARCHIVES:
        monkeypatch.setitem(ARCHIVES, name, server.archive(f"{name}.zip"))
    return server


def fetch(server, folder, name="maps.zip"):
    """Download one archive; return how many files it brought, and what was shown of it."""
    shown = []
    return download([server.archive(name)], folder, lambda *row: shown.append(row)), shown


def run(capsys, *words):
    status = main(["maps", "download", *map(str, words)])
    out, err = capsys.readouterr()
    return status, out.splitlines(), err.splitlines()


def files(folder):
    return sorted(str(file.relative_to(folder)) for file in folder.rglob("*") if file.is_file())


# The command.


def test_download(capsys, served, cache):
    assert run(capsys) == (0, [f"3 files written to {cache}"], [])
    unpacked = ["maps/tiny.map", "scens/tiny-even-1.scen", "scens/tiny-random-1.scen"]
    assert files(cache) == sorted([*CONTENTS, *unpacked])
    grid = load_map("tiny")
    assert grid.free.tolist() == GRID.free.tolist()
    assert load_scenario("tiny-random-1", grid).goals.tolist() == [[0, 2]]


def test_a_second_run_does_nothing(capsys, served, cache):
    run(capsys)
    before = {name: (cache / name).stat().st_mtime_ns for name in files(cache)}
    served.requests.clear()
    assert run(capsys) == (0, [f"all files are in {cache} already"], [])
    assert served.requests == []
    assert before == {name: (cache / name).stat().st_mtime_ns for name in files(cache)}


def test_a_deleted_file_is_written_again(capsys, served, cache):
    run(capsys)
    (cache / "maps" / "tiny.map").unlink()
    assert run(capsys)[1] == [f"1 files written to {cache}"]
    assert load_map("tiny").shape == (2, 3)


@pytest.mark.parametrize("kind", ["random", "even"])
def test_some_scenarios_into_a_folder(capsys, served, cache, tmp_path, monkeypatch, kind):
    folder = tmp_path / "new" / "folder"
    status, _, err = run(capsys, "--scenarios", kind, "--folder", folder)
    assert (status, err) == (0, [])
    assert files(folder) == sorted(["maps.zip", f"{kind}.zip", "maps/tiny.map", f"scens/tiny-{kind}-1.scen"])
    with pytest.raises(ValueError, match="mapf-pz maps download"):
        load_map("tiny")
    monkeypatch.setenv("MAPF_PZ_BENCHMARK", str(folder))
    assert load_scenario(f"tiny-{kind}-1", load_map("tiny")).starts.tolist() == [[1, 0]]


def test_errors_of_the_command_take_one_line(capsys, served, cache):
    served.contents["maps.zip"] += b"x"
    status, out, err = run(capsys)
    assert (status, out, len(err)) == (1, [], 1)
    assert f"expected {ARCHIVES['maps'].sha256} but got " in err[0]


def test_the_archives_are_those_of_movingai():
    for archive in ARCHIVES.values():
        assert urlsplit(archive.url)[:2] == ("https", "movingai.com")
        assert re.fullmatch("[0-9a-f]{64}", archive.sha256)


# The network.


def test_what_is_shown(server, tmp_path):
    size = len(CONTENTS["maps.zip"])
    written, shown = fetch(server, tmp_path)
    assert (written, shown[-1]) == (1, ("maps.zip", size, size))
    assert [here for _, here, _ in shown] == [PIECE, size]


@pytest.mark.parametrize("knows_ranges", [True, False])
def test_an_interrupted_download_resumes(server, tmp_path, knows_ranges):
    server.knows_ranges = knows_ranges
    server.cut_after = 90_000  # what is less than a piece is lost
    with pytest.raises(ConnectionError, match=f"cut after {PIECE:,} bytes; run the same command again to resume"):
        fetch(server, tmp_path)
    assert files(tmp_path) == ["maps.zip.part"]
    server.cut_after = None
    size = len(CONTENTS["maps.zip"])
    written, shown = fetch(server, tmp_path)
    assert written == 1
    assert [here for _, here, _ in shown] == ([size] if knows_ranges else [PIECE, size])
    assert {total for _, _, total in shown} == {size}
    assert server.requests == [("maps.zip", 0), ("maps.zip", PIECE)]
    assert files(tmp_path) == ["maps.zip", "maps/tiny.map"]


@pytest.mark.parametrize("tells_size", [True, False])
def test_a_download_that_is_too_large_is_cut(server, tmp_path, monkeypatch, tells_size):
    monkeypatch.setattr("mapf_pz.instances.download.MAX_BYTES", PIECE + 1)
    server.tells_size = tells_size
    with pytest.raises(OSError, match=r"maps.zip: expected at most 65,537 bytes, the server sends more$"):
        fetch(server, tmp_path)
    assert files(tmp_path) == []


def test_a_part_with_nothing_missing(server, tmp_path):
    (tmp_path / "maps.zip.part").write_bytes(CONTENTS["maps.zip"])
    assert fetch(server, tmp_path)[0] == 1
    assert files(tmp_path) == ["maps.zip", "maps/tiny.map"]


def test_a_wrong_checksum(server, tmp_path):
    server.contents["maps.zip"] = wrong = CONTENTS["even.zip"]
    expected = [hashlib.sha256(content).hexdigest() for content in (CONTENTS["maps.zip"], wrong)]
    with pytest.raises(ValueError, match="expected {} but got {}".format(*expected)):
        fetch(server, tmp_path)
    assert files(tmp_path) == []


def test_the_rest_of_another_file(server, tmp_path):
    (tmp_path / "maps.zip.part").write_bytes(b"something else")
    with pytest.raises(ValueError, match="does not match"):
        fetch(server, tmp_path)
    assert fetch(server, tmp_path)[0] == 1


def test_offline(server, tmp_path):
    server.close()
    with pytest.raises(ConnectionError, match=r"^http://.*/maps\.zip: no answer .*is this machine online\?$") as caught:
        fetch(server, tmp_path)
    assert "\n" not in str(caught.value)
    assert files(tmp_path) == []


def test_files_that_the_server_lacks(server, tmp_path):
    del server.contents["maps.zip"]
    with pytest.raises(OSError, match=r"maps\.zip: the server answers 404 Not Found$"):
        fetch(server, tmp_path)


# Unpacking.


def link(name):
    info = zipfile.ZipInfo(name)
    info.external_attr = (stat.S_IFLNK | 0o777) << 16
    return info


def lying(text, size, compression):
    """Return a zip file whose member holds `text`, and says that it has `size` bytes."""
    true, said = (number.to_bytes(4, "little") for number in (len(text), size))
    return zipped({"a.map": text}, compression).replace(true, said)


def spoilt(name):
    """Return a zip file whose member's bytes are no longer compressed ones."""
    content = zipped({name: MAP})
    begin = 30 + len(name)
    return content[:begin] + b"\xff" * 8 + content[begin + 8 :]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (zipped({"../a.map": MAP}), "expected paths inside the archive's folder, got '../a.map'"),
        (zipped({"maps/../../a.map": MAP}), "expected paths inside"),
        (zipped({"..\\a.map": MAP}), "expected paths inside"),
        (zipped({"/tmp/a.map": MAP}), "expected paths inside"),
        (zipped({"C:\\a.map": MAP}), "expected paths inside"),
        (zipped({link("a.map"): "/etc/passwd"}), "expected files, got the link 'a.map'"),
        (b"hello", "expected a valid zip file: "),
        (CONTENTS["maps.zip"][:-30], "expected a valid zip file: "),
        (spoilt("a.map"), "expected a valid zip file: Error -3 while decompressing"),
        (lying("." * 70_000, 60_000, zipfile.ZIP_DEFLATED), "expected a valid zip file: Bad CRC"),
        (lying("." * 70_000, 80_000, zipfile.ZIP_STORED), "expected a valid zip file: "),
    ],
    ids=[
        "up",
        "up inside",
        "backslashes",
        "absolute",
        "drive",
        "link",
        "text",
        "cut",
        "spoilt",
        "too little",
        "too much",
    ],
)
def test_malformed_archives_are_refused(tmp_path, content, message):
    file = tmp_path / "folder" / "a.zip"
    file.parent.mkdir()
    file.write_bytes(content)
    with pytest.raises(FormatError, match=re.escape(f"{file}: {message}")) as caught:
        unpack(file, file.parent)
    assert "\n" not in str(caught.value)
    assert files(tmp_path) == ["folder/a.zip"]


def test_archives_with_too_much_content_are_refused(tmp_path, monkeypatch):
    file = tmp_path / "a.zip"
    file.write_bytes(zipped({f"{i}.map": bytes(1000) for i in range(11)}))
    assert file.stat().st_size < 3000
    monkeypatch.setattr(archives, "MAX_BYTES", 10_999)
    with pytest.raises(FormatError, match="expected at most 10,999 bytes when unpacked, got 11,000"):
        unpack(file, tmp_path)
    monkeypatch.setattr(archives, "MAX_BYTES", 11_000)
    monkeypatch.setattr(archives, "MAX_MEMBERS", 10)
    with pytest.raises(FormatError, match="expected at most 10 files in the archive, got 11"):
        unpack(file, tmp_path)
    assert files(tmp_path) == ["a.zip"]
    monkeypatch.setattr(archives, "MAX_MEMBERS", 11)
    assert unpack(file, tmp_path) == 11


# Where names are sought.


def test_folders_of_the_variable_come_first(cache, tmp_path, monkeypatch):
    for folder, text in ((cache, MAP), (tmp_path / "mine", MAP.replace("@", "."))):
        (folder / "maps").mkdir(parents=True)
        (folder / "maps" / "tiny.map").write_text(text)
    assert load_map("tiny").free.sum() == 5
    monkeypatch.setenv("MAPF_PZ_BENCHMARK", str(tmp_path / "mine"))
    assert load_map("tiny").free.sum() == 6


def test_the_cache_is_the_users(tmp_path):
    code = "from mapf_pz.instances.download import cache_folder; print(cache_folder())"
    for variable, folder in (("XDG_CACHE_HOME", tmp_path / "mapf-pz"), ("MAPF_PZ_CACHE", tmp_path)):
        if variable == "XDG_CACHE_HOME" and not sys.platform.startswith("linux"):
            continue
        environment = {"PATH": "", variable: str(tmp_path)}
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment)
        assert Path(done.stdout.strip()) == folder


def test_bundled_names_load_nothing_of_the_network():
    code = """
import sys
from mapf_pz.instances import load_map
load_map("empty-8-8")
print({"pooch", "requests"} & {*sys.modules})
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"
