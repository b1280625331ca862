import ast
import subprocess
import sys
from pathlib import Path

EXAMPLES = Path(__file__).parents[1] / "examples"


def test_random_agents():
    command = [sys.executable, "-W", "error", EXAMPLES / "random_agents.py"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    metrics = ast.literal_eval(done.stdout)
    assert metrics["ep_length"] == 100
    assert 0 <= metrics["ISR"] <= 1
