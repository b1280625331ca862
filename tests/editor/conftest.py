import pytest

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")

from tests.helpers.editor_server import EditorServer


@pytest.fixture
def server(tmp_path):
    """A server that reads and writes in `tmp_path / "files"`."""
    folder = tmp_path / "files"
    folder.mkdir()
    running = EditorServer(folder)
    yield running
    running.close()


@pytest.fixture
def forked_solvers(_fork_server):
    """Fork the processes of solvers from one that has loaded the package: otherwise each takes seconds to load it."""
