import ast
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"


def test_random_agents():
    command = [sys.executable, "-W", "error", EXAMPLES / "random_agents.py"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    metrics = ast.literal_eval(done.stdout)
    assert metrics["ep_length"] == 100
    assert 0 <= metrics["ISR"] <= 1


def test_train_mappo(tmp_path):
    pytest.importorskip("torchrl")
    options = ["--agent-steps", "20000", "--episodes", "2", "--output", tmp_path]
    command = [sys.executable, EXAMPLES / "train_mappo.py", *options]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "CSR on 2 unseen maps" in done.stdout
    assert (tmp_path / "policy.safetensors").exists()
