import gc
import multiprocessing
import os
import shutil
import signal
from collections.abc import Generator
from multiprocessing import forkserver
from pathlib import Path

import pytest
from hypothesis import settings

from mapf_pz._internal import parallel
from mapf_pz.optimization.search import Search
from mapf_pz.planners import Planner
from tests.helpers.hand_clock import HandClock

# The first call of a kernel compiles it.
settings.register_profile("random", deadline=None)  # new examples in every run: `make -f tests/Makefile soak`
settings.register_profile("mapf_pz", deadline=None, derandomize=True)
settings.register_profile("quick", deadline=None, derandomize=True, max_examples=10)  # for kernels not compiled
settings.load_profile("mapf_pz")

# What a shell starts in the background ignores Ctrl-C, and so would all that the tests start.
signal.signal(signal.SIGINT, signal.default_int_handler)

# Several threads take longer for networks this small, and wait for each other at the expense of all other processes.
os.environ["OMP_NUM_THREADS"] = "1"

# Kernels on several threads: those that wait for others sleep.
os.environ["OMP_WAIT_POLICY"] = "passive"

# Tables have the width of a pipe, whatever the width of the terminal that the tests are run in.
os.environ.pop("COLUMNS", None)

# Windows open where nobody sees them.
os.environ["SDL_VIDEODRIVER"] = "dummy"

BROWSER_FLAGS = (
    *("--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync"),
    *("--disable-background-networking", "--disable-component-update"),
)


def pytest_collection_finish() -> None:
    """Let the garbage collector pass over what has been imported: otherwise it takes a quarter of the time."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def _time_limits_count_work() -> Generator[None]:
    """Let time limits count how often the time is looked at, whatever the load is."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Planner, "clock", HandClock(pace=0.004))
        patch.setattr(Search, "clock", HandClock(pace=0.1))  # simulations of episodes
        yield


@pytest.fixture(scope="session", autouse=True)
def _no_downloads(tmp_path_factory: pytest.TempPathFactory) -> Generator[None]:
    """Hide what the user has downloaded."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MAPF_PZ_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture
def without_figures(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Omit the learning curves of training runs, which take longer to draw than a small run; not if marked `figure`."""
    if request.node.get_closest_marker("figure") is None:
        run = pytest.importorskip("mapf_pz.rl.training.run")
        monkeypatch.setattr(run, "draw_curves", lambda *_: None)


@pytest.fixture(scope="session")
def _fork_server() -> Generator[None]:
    """A process that has loaded torch, from which others are forked; it is waited for at the end."""
    multiprocessing.set_forkserver_preload(["mapf_pz.rl.training.train", "tests.helpers.preloaded"])
    yield
    forkserver._forkserver._stop()


@pytest.fixture
def forked_processes(_fork_server: None, monkeypatch: pytest.MonkeyPatch) -> Generator[None]:
    """Fork learners and workers from a process that has loaded torch: otherwise each takes seconds to load it."""
    launch = pytest.importorskip("mapf_pz.rl.training.launch")
    for module in (launch, parallel):
        monkeypatch.setattr(module, "get_context", lambda _: multiprocessing.get_context("forkserver"))
    before = multiprocessing.get_start_method(allow_none=True)
    multiprocessing.set_start_method("forkserver", force=True)  # TorchRL's workers
    yield
    multiprocessing.set_start_method(before, force=True)


@pytest.fixture(scope="session")
def benchmark() -> Path:
    """The folder of benchmark data, which stands beside the repository."""
    folder = Path(__file__).parents[2] / "shared" / "mapf-benchmark"
    if not folder.is_dir():
        pytest.skip(f"{folder} is absent: the benchmark's data is not part of the repository")
    return folder


@pytest.fixture(scope="session")
def pogema_benchmark() -> Path:
    """The folder of POGEMA's benchmark, which stands beside the repository."""
    folder = Path(__file__).parents[2] / "shared" / "pogema-benchmark"
    if not folder.is_dir():
        pytest.skip(f"{folder} is absent: the benchmark's data is not part of the repository")
    return folder


@pytest.fixture(scope="module")
def browser():
    """Chromium, for the tests of pages."""
    api = pytest.importorskip("playwright.sync_api")
    found = shutil.which("chromium")
    if found is None:
        pytest.skip("no chromium: apt-get install chromium")
    with api.sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=found, args=list(BROWSER_FLAGS))
        yield chromium
        chromium.close()


def is_complaint(message):
    """Return whether a console message is an error, other than that a server refused a request."""
    return message.type == "error" and "the server responded with a status of 4" not in message.text


@pytest.fixture
def new_page(browser):
    """Return a function that opens a file, or a page of this machine; checks for errors and requests at the end."""
    pages, complaints, requests = [], [], []

    def opened(url, **options):
        page = browser.new_page(**options)
        page.set_default_timeout(600_000)  # ms, so that a page that waits in vain fails in the end
        page.on("console", lambda message: complaints.append(message.text) if is_complaint(message) else None)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("request", lambda request: requests.append(request.url))
        page.goto(url)
        pages.append(page)
        return page

    yield opened
    for page in pages:
        page.close()
    assert complaints == []
    assert all(url.startswith(("file:", "blob:", "data:", "about:", "http://127.0.0.1:")) for url in requests)
