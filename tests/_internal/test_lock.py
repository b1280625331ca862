"""Two processes never write to one folder at the same time."""

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import pytest

from mapf_pz._internal.lock import LOCK_FILE, locked
from mapf_pz.commands.main import main
from mapf_pz.evaluation import EvaluationTask, evaluate

HOLD = """
import sys, time
from pathlib import Path
from mapf_pz._internal.lock import locked
with locked(Path(sys.argv[1])):
    print("locked", flush=True)
    sys.stdin.read()
"""
COMMANDS = {
    "evaluate": ["--policy", "random", "--map", "empty-8-8", "--output"],
    "train": ["quickstart", "--overwrite", "--output"],
    "train resume": [],
    "guidance optimize": ["--output"],
    "dataset make": [],
    "maps download": ["--folder"],
    "maps generate": [],
}


@pytest.fixture
def holder(tmp_path):
    """A process that has locked a folder, and the folder."""
    folder = tmp_path / "mine"
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, folder], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    with process:
        assert process.stdout.readline() == "locked\n"
        yield process, folder
        process.kill()


def test_commands_refuse_the_folder_of_another_process(holder, capsys):
    _, folder = holder
    (folder / "config.json").write_text("{}")  # `train resume` reads it first
    for command, options in COMMANDS.items():
        assert main([*command.split(), *options, str(folder)]) == 1, command
        error = capsys.readouterr().err
        assert f"{folder}: another process is writing to this folder" in error, command
        assert error.count("\n") == 1, command
    assert {file.name for file in folder.iterdir()} == {LOCK_FILE, "config.json"}


def test_an_evaluation_of_another_process_keeps_its_rows(holder):
    _, folder = holder
    tasks = [EvaluationTask("empty", 2, {"map": "empty-8-8", "max_steps": 3}, episodes=1)]
    evaluate({"mine": "pibt"}, tasks, folder.with_name("evaluated"))
    for file in folder.with_name("evaluated").iterdir():
        file.rename(folder / file.name)
    before = {file: file.read_bytes() for file in folder.iterdir()}
    with pytest.raises(BlockingIOError, match=str(folder)):
        evaluate({"mine": "random"}, tasks, folder, overwrite=True)  # whose rows would replace them
    assert {file: file.read_bytes() for file in folder.iterdir()} == before


def test_a_lock_ends_with_its_process(holder):
    process, folder = holder
    with pytest.raises(BlockingIOError, match=str(folder)), locked(folder):
        pass
    process.kill()
    process.wait()
    with locked(folder), locked(folder), ThreadPoolExecutor(1) as pool:
        error = pool.submit(lambda: locked(folder).__enter__()).exception()
        assert isinstance(error, BlockingIOError)
    with locked(folder):  # the inner one has not ended the outer one, and the outer one has ended
        assert (folder / LOCK_FILE).exists()
    assert not any(folder.iterdir())


def test_nothing_remains_of_what_was_not_written(tmp_path):
    with pytest.raises(ValueError, match="no"), locked(tmp_path / "a" / "b"):
        raise ValueError("no")
    assert not any(tmp_path.iterdir())
    with locked(tmp_path / "a" / "b"):
        (tmp_path / "a" / "file").touch()
    assert [file.name for file in (tmp_path / "a").iterdir()] == ["file"]
    with locked(None):
        pass
