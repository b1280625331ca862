import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"


def run(name, *options):
    done = subprocess.run([sys.executable, EXAMPLES / name, *options], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


RUN_AND_COUNT = """
import runpy, sys, torch
torch.set_num_threads(2)
sys.argv = sys.argv[1:]
runpy.run_path(sys.argv[0], run_name="__main__")
assert torch.get_num_threads() == 1
"""


def run_with_one_thread(name, *options):
    """Run an example, which must set the number of torch's threads itself."""
    command = [sys.executable, "-c", RUN_AND_COUNT, str(EXAMPLES / name), *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_random_agents():
    metrics = ast.literal_eval(run("random_agents.py"))
    assert metrics["ep_length"] == 100
    assert 0 <= metrics["ISR"] <= 1


def test_evaluate_your_policy():
    header, _, *rows = (line.strip("| \n").split(" | ") for line in run("evaluate_your_policy.py").splitlines() if line)
    assert [row[:4] for row in rows] == [
        ["random 12 x 12", agents, policy, "8"] for agents in ("2", "8") for policy in ("greedy", "pibt", "random")
    ]
    solved = [float(row[header.index("CSR")].split()[0]) for row in rows]
    assert solved[1] >= solved[0] > solved[2]


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("train_mappo.py", "CSR on 2 unseen maps"),
        ("train_ippo.py", "32 agents on 20 x 20: ISR"),
        ("train_centralized_ppo.py", "CSR on 2 unseen maps"),
    ],
)
def test_training(tmp_path, name, told):
    pytest.importorskip("torchrl")
    assert told in run(name, "--agent-steps", "20000", "--episodes", "2", "--output", str(tmp_path))
    assert (tmp_path / "policy.safetensors").exists()


def test_own_torchrl_training():
    pytest.importorskip("torchrl")
    *_, last = run_with_one_thread("torchrl_ppo.py", "--batches", "20").splitlines()
    assert float(last.removeprefix(" 163840 agent steps: CSR ")) > 0.5


@pytest.mark.parametrize("algorithm", ["mappo", "ippo", "central-ppo"])
def test_custom_parts(tmp_path, algorithm):
    output = run(
        "custom_parts.py", "--algorithm", algorithm, "--agent-steps", "4000", "--output", str(tmp_path / "run")
    )
    assert output.splitlines()[-1] == "custom_parts:Pooled"


def test_stable_baselines():
    pytest.importorskip("stable_baselines3")
    assert "CSR on 2 unseen maps" in run_with_one_thread("centralized_sb3.py", "--steps", "2048", "--episodes", "2")


def test_the_report_with_stable_baselines(tmp_path):
    pytest.importorskip("torchrl")
    pytest.importorskip("stable_baselines3")
    told = run("report_sb3.py", "--steps", "512", "--episodes", "2", "--output", str(tmp_path))
    assert re.fullmatch(r"after training: CSR .*, ISR .*, reward .*", told.splitlines()[-1])
    assert {"progress.csv", "results.json"} <= {file.name for file in tmp_path.iterdir()}


def test_a_shared_policy_of_stable_baselines():
    pytest.importorskip("stable_baselines3")
    pytest.importorskip("supersuit")
    assert "CSR on 2 unseen maps" in run_with_one_thread("shared_sb3.py", "--steps", "2048", "--episodes", "2")


@pytest.mark.parametrize("mode", ["vector_entry_point", "sync", "async"])
def test_gymnasium_vector(mode):
    options = ["--num-envs", "2", "--steps", "202", "--vectorization-mode", mode]
    found = re.fullmatch(r"(\d+) episodes: CSR (.+), ISR (.+), ep_length (.+)\n", run("gymnasium_vector.py", *options))
    episodes, csr, isr, length = map(float, found.groups())
    assert episodes >= 4
    assert 0 <= csr <= isr <= 1
    assert 1 <= length <= 100
