"""Commands take planners and policies of users by name, and import their module."""

import sys

import pytest

from mapf_pz.commands.main import main

CODE = """
from mapf_pz.planners import PIBT


class Own(PIBT):
    pass


class Right:
    def act(self, observations):
        return dict.fromkeys(observations, 1)

    def reset_states(self):
        pass
"""
MODULE = "code_of_a_user"
EPISODE = ["--map", "empty-8-8", "--num-agents", "2", "--max-steps", "40"]
COMMANDS = {
    "evaluate": ["evaluate", "--policy", f"{MODULE}:Own", "--policy", f"{MODULE}:Right", *EPISODE, "--episodes", "1"],
    "solve": ["solve", "plan.txt", "--planner", f"{MODULE}:Own", *EPISODE],
    "schedule": ["schedule", "warehouse_small_10", "--planner", f"{MODULE}:Own", "--num-steps", "3"],
    "render": ["render", "episode.svg", "--policy", f"{MODULE}:Right", *EPISODE],
    "dataset": ["dataset", "make", "data", "--planner", f"{MODULE}:Own", *EPISODE, "--episodes", "2", "--jobs", "2"],
    "guidance": [
        *["guidance", "evaluate", "--planner", f"{MODULE}:Own", "--map", "empty-8-8", "--num-agents", "2"],
        *["--max-steps", "9", "--num-seeds", "2", "--jobs", "2"],
    ],
}


@pytest.fixture
def module(tmp_path, monkeypatch):
    (tmp_path / f"{MODULE}.py").write_text(CODE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)  # processes of `--jobs` search the folder where this process began
    yield
    sys.modules.pop(MODULE, None)


@pytest.mark.parametrize(
    "command",
    [pytest.param(name, marks=[pytest.mark.slow] if "--jobs" in words else []) for name, words in COMMANDS.items()],
)
def test_own_code(module, command, capsys):
    assert main(COMMANDS[command]) == 0, capsys.readouterr().err


@pytest.mark.parametrize("name", [f"{MODULE}:Missing", "no_such_module:Own"])
def test_code_that_is_missing_is_one_line(module, name, capsys):
    assert main(["evaluate", "--policy", name, *EPISODE]) == 1
    error = capsys.readouterr().err
    assert error.startswith(f"mapf-pz evaluate: policy={name!r}: ")
    assert error.count("\n") == 1
