import ast
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"

pytestmark = pytest.mark.filterwarnings("default")  # as where a user runs them


@pytest.fixture
def run(monkeypatch, capsys):
    """Return a function that runs an example in this process, where torch is loaded once, and returns its output."""
    monkeypatch.syspath_prepend(str(EXAMPLES))

    def ran(name, *options):
        monkeypatch.setattr(sys, "argv", [str(EXAMPLES / name), *map(str, options)])
        try:
            runpy.run_path(str(EXAMPLES / name), run_name="__main__")
        finally:
            sys.modules.pop(name.removesuffix(".py"), None)  # as an example's own parts are loaded
        return capsys.readouterr().out

    return ran


@pytest.fixture
def run_with_torch(run):
    """Return the same for examples that must set the number of torch's threads themselves."""
    torch = pytest.importorskip("torch")

    def ran(name, *options):
        torch.set_num_threads(2)
        try:
            output = run(name, *options)
            assert torch.get_num_threads() == 1
        finally:
            torch.set_num_threads(1)
        return output

    return ran


def test_random_agents(run):
    metrics = ast.literal_eval(run("random_agents.py"))
    assert metrics["ep_length"] == 100
    assert 0 <= metrics["ISR"] <= 1


def test_evaluate_your_policy(run):
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
        pytest.param("train_centralized_ppo.py", "CSR on 2 scenarios", marks=pytest.mark.slow),
    ],
)
@pytest.mark.usefixtures("without_figures")
def test_training(run_with_torch, tmp_path, name, told):
    pytest.importorskip("torchrl")
    assert told in run_with_torch(name, "--agent-steps", 2000, "--episodes", 2, "--output", tmp_path)
    assert (tmp_path / "policy.safetensors").exists()


def test_own_torchrl_training(run_with_torch):
    pytest.importorskip("torchrl")
    *_, last = run_with_torch("torchrl_ppo.py", "--batches", 3, "--epochs", 1).splitlines()
    assert last.startswith("  24576 agent steps: CSR ")


@pytest.mark.slow
def test_own_torchrl_training_routes(run_with_torch):
    pytest.importorskip("torchrl")
    *_, last = run_with_torch("torchrl_ppo.py", "--batches", 21, "--epochs", 2).splitlines()
    assert float(last.removeprefix(" 172032 agent steps: CSR ")) > 0.5


@pytest.mark.usefixtures("without_figures")
@pytest.mark.parametrize("algorithm", ["mappo", "ippo", "central-ppo"])
def test_custom_parts(run_with_torch, tmp_path, algorithm):
    output = run_with_torch(
        "custom_parts.py", "--algorithm", algorithm, "--agent-steps", 2000, "--output", tmp_path / "run"
    )
    assert output.splitlines()[-1] == "custom_parts:Pooled"


@pytest.mark.slow
@pytest.mark.parametrize("preset", ["report", "report-repaired"])
def test_the_report_with_stable_baselines(run_with_torch, tmp_path, preset):
    pytest.importorskip("torchrl")
    pytest.importorskip("stable_baselines3")
    told = run_with_torch(
        "centralized_sb3.py", "--preset", preset, "--steps", 512, "--episodes", 2, "--output", tmp_path
    )
    assert re.fullmatch(r"after training: CSR .*, ISR .*, reward .*", told.splitlines()[-1])
    assert {"progress.csv", "results.json"} <= {file.name for file in tmp_path.iterdir()}


@pytest.mark.slow
def test_the_report_as_published(run_with_torch, tmp_path):
    """A run goes on from its last evaluation, with the environments and the agents that have finished in them."""
    pytest.importorskip("torchrl")
    pytest.importorskip("stable_baselines3")
    small = ("--num-envs", 1, "--interval", 512, "--episodes", 1, "--output", tmp_path)
    first = run_with_torch("report_published.py", "--steps", 512, *small)
    second = run_with_torch("report_published.py", "--steps", 1024, *small)
    assert re.fullmatch(r"env_steps 512\.0, mean_reward [\d.]+, .* fresh_finished \d+\.0\n", first)
    assert second.startswith("env_steps 1,024.0, ")
    header, *rows = (tmp_path / "curve.csv").read_text().splitlines()
    assert header == "env_steps,mean_reward,min_reward,max_reward,finished,fresh_reward,fresh_finished"
    assert [row.split(",")[0] for row in rows] == ["512", "1024"]


def test_a_shared_policy_of_stable_baselines(run_with_torch):
    pytest.importorskip("sb3_contrib")
    assert "CSR on 2 unseen maps" in run_with_torch("shared_sb3.py", "--steps", 2048, "--episodes", 2)


@pytest.mark.slow
def test_ppo_in_one_file(run_with_torch):
    small = ("--agent-steps", 70_000, "--num-envs", 4, "--minibatch-size", 256, "--episodes", 8)
    *told, last = run_with_torch("cleanrl_ppo.py", *small).splitlines()
    assert len(told) >= 10
    assert last.startswith("CSR on 8 unseen maps: ")
    assert float(last.split()[-1]) >= 0.25


def run_in_a_process(name, *options):
    done = subprocess.run([sys.executable, EXAMPLES / name, *options], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("mode", ["vector_entry_point", "sync", "async"])
def test_gymnasium_vector(run, mode):
    runner = run_in_a_process if mode == "async" else run  # its processes import the example again
    output = runner("gymnasium_vector.py", "--num-envs", "2", "--steps", "202", "--vectorization-mode", mode)
    found = re.fullmatch(r"(\d+) episodes: CSR (.+), ISR (.+), ep_length (.+)\n", output)
    episodes, csr, isr, length = map(float, found.groups())
    assert episodes >= 4
    assert 0 <= csr <= isr <= 1
    assert 1 <= length <= 100


def test_the_environment_for_epymarl(monkeypatch):
    """Gymnasium's environment with tuples, as EPyMARL makes and steps it."""
    monkeypatch.syspath_prepend(str(EXAMPLES))
    gymnasium = pytest.importorskip("gymnasium")
    env = gymnasium.wrappers.TimeLimit(gymnasium.make("epymarl_env:Mapf-EPyMARL-v0", max_steps=8), 8)
    assert env.unwrapped.n_agents == len(env.action_space) == len(env.observation_space) == 4
    env.action_space.seed(0)
    observations, _ = env.reset(seed=0)
    steps = 0
    over = False
    while not over:
        assert observations in env.observation_space
        observations, rewards, terminated, truncated, info = env.step(env.action_space.sample())
        assert len(rewards) == 4
        steps, over = steps + 1, terminated or truncated
        assert ("CSR" in info) == over
    assert steps <= 8


@pytest.mark.parametrize("name", ["skrl", "tianshou", "xuance"])
def test_the_page_names_the_versions_of_other_libraries(name):
    requirements = (EXAMPLES / f"{name}-requirements.txt").read_text()
    [version] = re.findall(rf"^{name}==(.*)$", requirements, re.MULTILINE)
    page = EXAMPLES.parent / "docs" / "how-to" / "other-libraries.md"
    assert f"| {name} {version}," in page.read_text().lower()
    makefile = (EXAMPLES.parent / "Makefile").read_text()
    assert f".venv-{name}/bin/python examples/{name}_" in makefile
