"""The command `mapf-pz edit`: the files that the page opens, and the server."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from http.client import HTTPConnection
from urllib.parse import urlsplit

import pytest

from mapf_pz.commands.main import main
from mapf_pz.instances import Scenario, load_map, load_scenario, write_map, write_scenario


@pytest.fixture
def served(monkeypatch):
    """What `mapf-pz edit` serves: files, folders, port, and whether it opens the browser."""
    calls = []
    monkeypatch.setattr("mapf_pz.commands.edit._serve", lambda *given: calls.append(given))
    return calls


@pytest.fixture
def files(tmp_path):
    grid = load_map("empty-8-8")
    for folder in ("maps", "scens"):
        (tmp_path / folder).mkdir()
    write_map(grid, tmp_path / "maps" / "a.map")
    write_scenario(Scenario([[0, 0]], [[3, 3]]), grid, tmp_path / "scens" / "b.scen")
    return tmp_path / "maps" / "a.map", tmp_path / "scens" / "b.scen"


def test_files_are_opened(served, files):
    map, scenario = files
    assert main(["edit", str(map), "--scenario", str(scenario), "--no-browser", "--port", "8123"]) == 0
    [(start, folders, options)] = served
    assert start == {
        "map": {"name": "a.map", "text": map.read_text()},
        "scenario": {"name": "b.scen", "text": scenario.read_text()},
    }
    assert [folder.resolve() for folder in folders] == [map.parents[2].cwd(), map.parent, scenario.parent]
    assert (options.port, options.browser) == (8123, False)


def test_the_map_beside_a_scenario_is_opened(served, files):
    map, scenario = files
    beside = map.replace(scenario.with_name("empty-8-8.map"))  # the name in the scenario
    beside.write_text(beside.read_text().replace("........", ".......@", 1))
    assert main(["edit", "--scenario", str(scenario)]) == 0
    [(start, *_)] = served
    assert start["map"] == {"name": "empty-8-8.map", "text": beside.read_text()}


def test_names_are_opened(served, tmp_path):
    assert main(["edit", "random-32-32-20", "--scenario", "random-2", "--folder", str(tmp_path)]) == 0
    assert main(["edit", "--scenario", "random-32-32-20-random-2"]) == 0
    assert main(["edit"]) == 0
    [(start, folders, options), (same, _, _), (nothing, _, _)] = served
    assert start == same
    assert start["map"]["name"] == "random-32-32-20.map"
    assert start["scenario"]["name"] == "random-32-32-20-random-2.scen"
    assert start["scenario"]["text"].startswith("version 1\n")
    assert (list(folders), options.port, options.browser) == ([tmp_path], 0, True)
    assert nothing == {"map": None, "scenario": None}


@pytest.mark.parametrize(
    ("words", "error"),
    [
        (["nowhere"], "no .map file is named 'nowhere'"),
        (["--solver", "pibt"], "--solver pibt: expected package.module:Class"),
        (["--solver", "mine:Own+pibt"], "--solver mine:Own+pibt: expected package.module:Class"),
        (["--solver", "mapf_pz.planners.named:PLANNERS"], "PLANNERS: expected package.module:Class"),
        (["--output", "page.svg"], "--output: expected an .html file"),
        (["--output", "page.html", "--port", "8123"], "--output: expected an .html file, and neither"),
        (["nowhere.map"], "nowhere.map: no such file"),
        (["empty-8-8", "--scenario", "nowhere"], "no .scen file is named 'nowhere'"),
        (["ggo.json"], "ggo.json: expected a name, or a .map file"),
        (["random-32-32-20", "--scenario", "{scenario}"], "expected the size of map 'random-32-32-20'"),
    ],
)
def test_errors(capsys, served, files, tmp_path, monkeypatch, words, error):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "ggo.json").write_text('{"layout": ["..", ".."]}')
    assert main(["edit", *(word.format(scenario=files[1]) for word in words)]) == 1
    [line] = capsys.readouterr().err.splitlines()
    assert line.startswith("mapf-pz edit: ")
    assert error in line
    assert served == []


def test_the_page_is_saved(capsys, served, new_page, tmp_path):
    output = tmp_path / "pages" / "editor.html"
    assert main(["edit", "empty-8-8", "--scenario", "random-1", "--output", str(output)]) == 0
    assert capsys.readouterr().out.startswith(f"{output}: ")
    page = new_page(output.as_uri())
    page.wait_for_selector("body[data-ready]")
    drawn = page.evaluate("[editor.drawing.name, editor.drawing.agents.map(({ start }) => start)]")
    assert drawn == ["empty-8-8", load_scenario("random-1", load_map("empty-8-8")).starts.tolist()]
    assert served == []


def test_starlette_is_needed(capsys, monkeypatch):
    monkeypatch.delitem(sys.modules, "mapf_pz.editor.server", raising=False)
    monkeypatch.setitem(sys.modules, "starlette.applications", None)
    assert main(["edit", "--no-browser"]) == 1
    [line] = capsys.readouterr().err.splitlines()
    assert line.endswith("pip install 'mapf-pz[edit]'")


def test_the_help_needs_no_starlette():
    code = "try: main(['edit', '-h'])\nfinally: print({'starlette', 'uvicorn'} & {*sys.modules})"
    words = [sys.executable, "-c", f"import sys; from mapf_pz.commands.main import main\n{code}"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.stdout.splitlines()[-1] == "set()"


@contextmanager
def running(folder, *words):
    """Start the command in a folder; yield the process, and the parts of the address that it prints."""
    command = [sys.executable, "-m", "mapf_pz", "edit", "--no-browser", *words]
    with (folder / "errors").open("w") as errors:
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, text=True, cwd=folder)
        try:
            address = process.stdout.readline().strip()
            assert re.fullmatch(r"http://127\.0\.0\.1:\d+/\?token=[\w-]{40,}", address), (folder / "errors").read_text()
            yield process, urlsplit(address)
        finally:
            process.kill()
            process.wait()  # not for the end of its output, which the process that loads modules holds open
            process.stdout.close()


def request(address, method, path, body=None):
    connection = HTTPConnection(address.netloc)
    connection.request(method, path, body, {"X-Token": address.query.partition("=")[2]})
    response = connection.getresponse()
    status, text = response.status, response.read().decode()
    connection.close()
    return status, text


def children(parent, word):
    """Return the processes that a process has started whose command line contains a word."""
    words = ["ps", "-ww", "-o", "pid=,args=", "--ppid", str(parent)]
    lines = subprocess.run(words, capture_output=True, text=True, check=False).stdout.splitlines()
    return [int(line.split()[0]) for line in lines if word in line]


def solvers(process):
    """Return the processes of solvers, which are forked from another one that a server has started."""
    [forking] = children(process.pid, "multiprocessing.forkserver")
    return children(forking, "multiprocessing.forkserver")


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_server_runs_until_it_is_interrupted(tmp_path, number):
    pytest.importorskip("starlette")
    instance = {"name": "a", "map": "type octile\nheight 1\nwidth 3\nmap\n...\n", "starts": [[0, 0]]}
    given = {"instance": instance | {"goals": [[[0, 2], [0, 0]]]}, "solvers": ["pibt"], "lifelong": True}
    limits = {"max_steps": 100_000, "time_limit": 80_000}
    with running(tmp_path, "empty-8-8") as (process, address):
        status, text = request(address, "GET", f"/?{address.query}")
        assert (status, "type octile" in text) == (200, True)
        status, answer = request(address, "POST", "/api/solve", json.dumps(given | limits))
        assert status == 200, answer
        run, step = json.loads(answer), 0
        while not step:  # until the solver works
            [solver] = json.loads(request(address, "POST", "/api/progress", json.dumps(run))[1])["solvers"]
            assert solver["state"] == "running", solver
            step = solver["step"]
            time.sleep(0.05)
        [child] = solvers(process)
        process.send_signal(number)
        assert process.wait() == 0
        assert process.stdout.read() == ""
        with pytest.raises(ProcessLookupError):
            os.kill(child, 0)
    errors = (tmp_path / "errors").read_text().splitlines()
    assert all(line.startswith("compiling kernels") for line in errors), errors


@pytest.mark.slow
def test_a_port_in_use(tmp_path):
    pytest.importorskip("starlette")
    with running(tmp_path) as (_, address):
        command = [sys.executable, "-m", "mapf_pz", "edit", "--no-browser", "--port", str(address.port)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, len(done.stderr.splitlines())) == (1, "", 1)
    assert "Address already in use" in done.stderr
