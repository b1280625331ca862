"""Files that name code run it only if the user trusts them."""

import io
import json
import shutil
import sys

import pytest

from mapf_pz.commands.main import main
from mapf_pz.evaluation import evaluate, load_suite
from mapf_pz.rl import load_policy
from mapf_pz.rl.policies.folder import bundled, policy_names
from mapf_pz.rl.progress import PROGRESS

IMPORTED = "it was imported"
REFUSED = "names code that would run; if you trust it, pass trust_remote_code=True, or --trust-remote-code"
NAME = "stranger:thing"
FIELDS = {
    "channels": lambda config, name: config["task"]["env"].update(channels=["view", name]),
    "features": lambda config, name: config["task"]["env"].update(features=[name]),
    "reward": lambda config, name: config["task"]["env"].update(reward=name),
    "source": lambda config, name: config["task"]["env"].update(source=name, map=None, num_agents=None),
    "algorithm": lambda config, name: config.update(algorithm=name),
    "encoder": lambda config, name: config["model"].update(encoder=name),
    "expert": lambda config, name: config.update(imitation={"expert": name}),
}


@pytest.fixture(autouse=True)
def stranger(tmp_path, monkeypatch):
    """A module that says when it is imported."""
    (tmp_path / "stranger.py").write_text(f"raise ImportError({IMPORTED!r})")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)


def copied(folder, field, name=NAME):
    """Copy a policy of the package, and name code in a field of its configuration."""
    shutil.copytree(bundled() / "mappo", folder)
    config = json.loads((folder / "config.json").read_text())
    FIELDS[field](config, name)
    (folder / "config.json").write_text(json.dumps(config))
    return folder


def suite_file(folder, field="reward"):
    value = {"reward": NAME, "channels": [NAME], "features": [NAME]}[field]
    task = {"map": "empty-8-8", "num_agents": 2, "env": {field: value}}
    (folder / "suite.json").write_text(json.dumps({"tasks": [task]}))
    return folder / "suite.json"


@pytest.mark.parametrize("field", FIELDS)
def test_a_policy_that_names_code_is_refused(tmp_path, field):
    folder = copied(tmp_path / "run", field)
    for use in (load_policy, lambda folder, **trust: evaluate([str(folder)], "quickstart", **trust)):
        with pytest.raises(ValueError, match=f"config.json: {field}='{NAME}' {REFUSED}") as caught:
            use(folder)
        assert "\n" not in str(caught.value)
        with pytest.raises(ValueError, match=IMPORTED):
            use(folder, trust_remote_code=True)


def test_code_of_the_package_may_be_named(tmp_path):
    folder = copied(tmp_path / "run", "algorithm", "mapf_pz.rl.algorithms.ppo:MAPPO")
    assert load_policy(folder).config.algorithm == "mapf_pz.rl.algorithms.ppo:MAPPO"
    with pytest.raises(ValueError, match="names code"):
        load_policy(copied(tmp_path / "other", "algorithm", "mapf_pz_more.rl.ppo:MAPPO"))


def test_policies_of_the_package_need_no_trust():
    for name in policy_names():
        load_policy(name)


@pytest.mark.parametrize("field", ["reward", "channels", "features"])
def test_a_suite_that_names_code_is_refused(tmp_path, field):
    file = suite_file(tmp_path, field)
    with pytest.raises(ValueError, match=f"suite.json: task 0: {field}='{NAME}' {REFUSED}"):
        load_suite(file)
    with pytest.raises(ValueError, match=IMPORTED):
        load_suite(file, trust_remote_code=True)


EPISODE = ["--map", "empty-8-8", "--num-agents", "2"]
COMMANDS = {
    "evaluate": ["evaluate", "--policy", "run", *EPISODE, "--episodes", "1"],
    "evaluate a suite": ["evaluate", "--policy", "random", "--suite", "suite.json"],
    "guidance": ["guidance", "evaluate", "--planner", "run", "--num-seeds", "1"],
    "policy export": ["policy", "export", "run", "run.onnx"],
    "play": ["play", "--policy", "run", *EPISODE],
    "render": ["render", "episode.svg", "--policy", "run", *EPISODE],
    "resume": ["train", "resume", "run"],
    "train from a file": ["train", "run/config.json", "--output", "new"],
    "train from a policy": ["train", "mappo", "--initial-policy", "run", "--output", "new", "--evaluate", "none"],
    "train from states": [
        *("train", "oneshot-cardinal", "--replay", "states", "--dataset", "run"),
        *("--output", "new", "--evaluate", "none"),
    ],
    "train for a suite": ["train", "mappo", "--output", "new", "--evaluate", "suite.json"],
}


@pytest.mark.parametrize("command", COMMANDS)
def test_commands_refuse_and_trust(tmp_path, capsys, command):
    suite_file(tmp_path)
    (copied(tmp_path / "run", "reward") / PROGRESS).write_text("agent_steps\r\n1\r\n")
    for trust, message in (([], REFUSED), (["--trust-remote-code"], IMPORTED)):
        assert main([*COMMANDS[command], *trust]) == 1
        error = capsys.readouterr().err
        assert message in error
        assert error.count("\n") == 1
    assert not (tmp_path / "new").exists()


def test_progress_is_drawn_without_trust(tmp_path):
    pytest.importorskip("matplotlib")
    (copied(tmp_path / "run", "reward") / PROGRESS).write_text("agent_steps,CSR\r\n1,0.5\r\n2,0.6\r\n")
    assert main(["plot", "run", "--output", "curves.svg"]) == 0
    assert (tmp_path / "curves.svg").exists()


def test_a_served_policy_is_refused_and_trusted(tmp_path, capsys, monkeypatch):
    copied(tmp_path / "run", "reward")
    words = ["serve", "run", "--collision-system", "soft", "--on-target", "nothing", "--max-steps", "3"]
    for trust, message in (([], REFUSED), (["--trust-remote-code"], IMPORTED)):
        request = {"map": ["..", ".."], "positions": [[0, 0]], "goals": [[1, 1]]}
        monkeypatch.setattr(sys, "stdin", io.StringIO(json.dumps(request) + "\n"))
        assert main([*words, *trust]) == 0
        assert message in json.loads(capsys.readouterr().out)["error"]
