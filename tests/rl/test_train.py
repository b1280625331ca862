import dataclasses
import json
import math
import re
import sys
import time

import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from torchrl.envs import Compose, RewardScaling, TransformedEnv

import mapf_pz
from mapf_pz.evaluation import EvaluationTask, evaluate
from mapf_pz.instances import RandomObstacles, SourceMixture
from mapf_pz.rl import BatchedMapfEnv, load_policy, train
from mapf_pz.rl.algorithms.named import ALGORITHMS
from mapf_pz.rl.algorithms.ppo import MAPPO
from mapf_pz.rl.config import CuriosityConfig, TrackingConfig
from mapf_pz.rl.networks.observation_shape import ObservationShape
from mapf_pz.rl.training.train import Progress, resume
from tests.helpers.small_run import TINY, changed, rows, untimed


@pytest.mark.figure
@pytest.mark.parametrize("algorithm", ["mappo", "ippo", "central-ppo"])
def test_a_run_leaves_its_files_and_a_policy_that_acts(tmp_path, algorithm):
    folder = train(dataclasses.replace(TINY, algorithm=algorithm), tmp_path / "run")
    files = {file.name for file in folder.iterdir()}
    assert files == {
        "config.json",
        "policy.safetensors",
        "progress.csv",
        "learning_curve.png",
        "checkpoints",
        "tensorboard",
    }
    assert [int(row["agent_steps"]) for row in rows(folder)] == [192, 384, 576]
    policy = load_policy(folder)
    env = mapf_pz.parallel_env(
        **policy.env_kwargs, map="empty-16-16", num_agents=3 if algorithm == "central-ppo" else 20
    )
    observations, _ = env.reset(seed=0)
    policy.reset_states()
    actions = policy.act(observations)
    assert actions.keys() == observations.keys()
    env.step(actions)


@pytest.mark.parametrize(("asked", "updates"), [(1, 1), (192, 1), (193, 2), (384, 2)])
def test_a_run_has_at_least_the_given_agent_steps(tmp_path, asked, updates):
    config = dataclasses.replace(TINY, agent_steps=asked)
    assert (config.num_updates, config.steps_per_update) == (updates, 192)
    assert [int(row["agent_steps"]) for row in rows(train(config, tmp_path))] == [192, 384][:updates]


@pytest.mark.parametrize(
    ("part", "name", "values"),
    [
        ("env", "num_agents", [0, -1, 2.5]),
        ("mixture", "height", [0, (), (5,), (5, 4), (0, 4), (5, 6, 7), 2.5, True]),
        ("mixture", "width", [0]),
        ("mixture", "density", [-0.1, 1.0, (0.2, 0.1), (0.2, 1), float("nan")]),
        ("mixture", "corridor", [0]),
        ("mixture", "room_size", [1]),
        ("mixture", "shelf_length", [0]),
        ("mixture", "maps", [(), "random", ("maze", 3)]),
        ("env", "max_steps", [0]),
        ("task", "action_mode", ["best"]),
        ("model", "encoder", ["transformer"]),
        ("model", "conv_channels", [(0,), (4, -1)]),
        ("model", "hidden", [0]),
        ("model", "recurrent", [-1]),
        ("model", "num_blocks", [-1]),
        ("model", "head", [(0,)]),
        ("optimization", "num_envs", [0]),
        ("optimization", "steps_per_batch", [0]),
        ("optimization", "num_epochs", [0]),
        ("optimization", "minibatch_size", [0]),
        ("optimization", "learning_rate", [0, -1.0, float("nan"), float("inf")]),
        ("ppo", "gamma", [-0.1, 1.1, float("nan")]),
        ("ppo", "lmbda", [-0.1, 1.1]),
        ("ppo", "clip_epsilon", [0, -1]),
        ("ppo", "entropy_coeff", [-1, float("inf")]),
        ("ppo", "critic_coeff", [-1]),
        ("optimization", "max_grad_norm", [0]),
        ("ppo", "credit", ["none"]),
        ("curiosity", "kind", ["icm"]),
        ("curiosity", "weight", [-1]),
        ("curiosity", "gamma", [2]),
        ("curiosity", "size", [0]),
        ("curiosity", "learning_rate", [0]),
        ("curiosity", "update_fraction", [0, 1.5]),
        (None, "algorithm", ["dqn"]),
        (None, "agent_steps", [0, -5, 1e6]),
        (None, "seed", [-1]),
        (None, "checkpoint_interval", [0]),
        (None, "validation_interval", [-1]),
        (None, "validation_episodes", [0]),
        (None, "collector", ["threads"]),
        (None, "num_workers", [0]),
        (None, "device", ["gpu"]),
        (None, "num_threads", [0]),
    ],
)
def test_values_that_are_not_allowed_are_refused(part, name, values):
    config = TINY if part is None else getattr(TINY.task if part in ("env", "mixture") else TINY, part)
    for value in values:
        with pytest.raises(ValueError, match=rf"^{name}(={re.escape(repr(value))}|\[\d]=.*): expected "):
            dataclasses.replace(config, **{name: value})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"clip_epsilon": 0.0}, "clip_epsilon=0.0: expected a number greater than 0"),
        ({"gamma": 1.5}, "gamma=1.5: expected at most 1"),
        ({"critic_coeff": -1.0}, "critic_coeff=-1.0: expected a number, 0 or more"),
    ],
)
def test_a_refusal_names_the_bounds(change, message):
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        dataclasses.replace(TINY.ppo, **change)


@pytest.mark.parametrize(
    "config",
    [TINY, TINY.task, TINY.model, TINY.optimization, TINY.ppo, TINY.curiosity, ObservationShape((5, 3, 3), 7, 4)],
)
def test_configurations_do_not_change(config):
    name = dataclasses.fields(config)[0].name
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(config, name, getattr(config, name))
    assert len({config, dataclasses.replace(config)}) == 1


def contents(folder):
    return {file: file.read_bytes() for file in folder.rglob("*") if file.is_file()}


@pytest.fixture(scope="module")
def short_run(tmp_path_factory):
    """The folder of a run of one update."""
    return train(dataclasses.replace(TINY, agent_steps=192), tmp_path_factory.mktemp("short") / "run")


def test_a_run_is_replaced_only_when_asked_to(tmp_path):
    train(TINY, tmp_path)
    before = contents(tmp_path)
    with pytest.raises(FileExistsError) as caught:
        train(TINY, tmp_path)
    for told in (f"{str(tmp_path)!r} holds a run", "--overwrite", f"mapf-pz train resume {tmp_path}", "another output"):
        assert told in str(caught.value)
    assert contents(tmp_path) == before
    train(dataclasses.replace(TINY, seed=1), tmp_path, overwrite=True)
    assert load_policy(tmp_path).config.seed == 1


@pytest.mark.parametrize(
    "change",
    [
        {"map": "absent.map"},
        {"map": "empty-8-8", "num_agents": 65},
        {"maps": ("random", "absent.map")},
        {"maps": ("random", "maze-13-13-1"), "num_agents": 100},
        {"scenario": ("absent.scen", "absent-too.scen")},
        {"scenario": "absent.json"},
        {"num_agents": 500},
        {"source": RandomObstacles(6, 6, 0.1, 3)},  # a run cannot save it
        {"source": SourceMixture([RandomObstacles(6, 6, 0.1, 3)])},
    ],
)
@pytest.mark.parametrize("collector", ["single", "processes"])
def test_a_refused_task_leaves_the_run_as_it_was(short_run, change, collector):
    before = contents(short_run)
    config = dataclasses.replace(TINY, task=changed(TINY.task, **change), collector=collector)
    with pytest.raises((ValueError, FileNotFoundError)) as caught:
        train(config, short_run, overwrite=True)
    assert "\n" not in str(caught.value)
    assert contents(short_run) == before


def test_same_seed_same_run(tmp_path):
    one, two = (untimed(train(TINY, tmp_path / name)) for name in "ab")
    assert one == two


def test_shares_of_time_add_up_to_all_of_it(tmp_path):
    for row in rows(train(TINY, tmp_path)):
        shares = [float(row[f"{name}_share"]) for name in ("collecting", "acting", "learning")]
        assert min(shares) > 0
        assert sum(shares) == pytest.approx(1, abs=1e-4)


def test_seconds_count_from_the_first_update(tmp_path):
    started = []

    def make_algorithm(config):
        started.append(time.perf_counter())
        return ALGORITHMS[config.algorithm](config)

    def on_progress(row):
        assert 0 < row["seconds"] <= time.perf_counter() - started[0]
        assert row["agent_steps_per_second"] == pytest.approx(row["agent_steps"] / row["seconds"])

    train(TINY, tmp_path, on_progress, make_algorithm)
    assert len(started) == 1


def test_validation_plays_the_same_episodes_and_changes_nothing(tmp_path):
    config = dataclasses.replace(TINY, validation_interval=300, validation_episodes=8)
    looked, plain = (untimed(train(config, tmp_path / "looked")), untimed(train(TINY, tmp_path / "plain")))
    looks = [{key: row.pop(f"validation_{key}") for key in ("CSR", "ISR", "return")} for row in looked]
    assert looked == plain
    assert [look["CSR"] == "nan" for look in looks] == [True, False, False]
    again = untimed(train(config, tmp_path / "again"))
    assert [row["validation_return"] for row in again] == [look["return"] for look in looks]


def test_validations_are_an_interval_apart_and_at_the_end(tmp_path):
    config = dataclasses.replace(TINY, agent_steps=5 * 192, validation_interval=2 * 192, validation_episodes=2)
    looked = [row["validation_CSR"] != "nan" for row in rows(train(config, tmp_path))]
    assert looked == [False, True, False, True, True]


def test_a_custom_algorithm(tmp_path):
    class Lazy(MAPPO):
        """Nobody earns anything."""

        def transforms(self, seed):
            return [*super().transforms(seed), RewardScaling(0.0, 0.0, in_keys=[("agents", "reward")])]

    done = rows(train(TINY, tmp_path, make_algorithm=Lazy))
    assert all(abs(float(row["return"])) < 1e-4 for row in done if row["episodes"] != "0")
    load_policy(tmp_path)


def test_a_gpu_is_not_used_for_device_cpu(tmp_path, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    made = []

    def make_algorithm(config):
        made.append(torch.empty(0).device.type)
        raise InterruptedError  # torch itself would look for the GPU later

    with pytest.raises(InterruptedError):
        train(dataclasses.replace(TINY, device="cpu"), tmp_path, make_algorithm=make_algorithm)
    assert made == ["cpu"]


def test_cuda_without_a_gpu_is_refused(tmp_path):
    if torch.cuda.is_available():
        pytest.skip("there is a GPU")
    with pytest.raises(ValueError, match="device='cuda': torch finds no GPU"):
        train(dataclasses.replace(TINY, device="cuda"), tmp_path)


def test_tensorboard_shows_what_the_table_says(tmp_path):
    train(TINY, tmp_path)
    events = EventAccumulator(str(tmp_path / "tensorboard")).Reload()
    for key in ("loss_critic", "ISR"):
        told = [row for row in rows(tmp_path) if row[key] != "nan"]
        shown = events.Scalars(key)
        assert [event.step for event in shown] == [int(row["agent_steps"]) for row in told]
        assert [event.value for event in shown] == pytest.approx([float(row[key]) for row in told], rel=1e-5)


WANDB = """
import json
import math
from pathlib import Path

def init(id, resume, dir, config, **shown):
    assert resume == "allow"
    return Run(Path(dir).parent / f"logged-{id}.jsonl", {**shown, "seed": config["seed"]})

class Run:
    def __init__(self, file, first):
        self.file = file
        self.log(first)

    def define_metric(self, name, step_metric):
        self.log([name, step_metric])

    def log(self, row):
        with self.file.open("a") as stream:
            print(json.dumps(row), file=stream)

    def finish(self):
        self.log("finished")
"""


@pytest.fixture
def packages(tmp_path, monkeypatch):
    """A folder of modules that stand for services' clients, and what they were told."""
    folder = tmp_path / "packages"
    folder.mkdir()
    monkeypatch.syspath_prepend(folder)
    yield folder
    for name in [name for name in sys.modules if name.partition(".")[0] in ("wandb", "mlflow")]:
        del sys.modules[name]


@pytest.mark.parametrize("name", ["wandb", "mlflow"])
def test_a_logger_that_is_not_installed_is_refused(name, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / name).mkdir()  # such a folder is no package
    with pytest.raises(ImportError, match=f"loggers: '{name}' is not installed: pip install {name}"):
        train(dataclasses.replace(TINY, loggers=(name,)), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_weights_and_biases_gets_all_rows_also_of_a_resumed_run(tmp_path, packages):
    config = dataclasses.replace(TINY, loggers=("wandb",))
    (packages / "wandb.py").write_text(WANDB)
    resume(train(config, tmp_path / "run"), agent_steps=768)
    train(config, tmp_path / "run", overwrite=True)
    files = sorted(tmp_path.glob("logged-*.jsonl"), key=lambda file: file.stat().st_mtime)
    first, second = ([json.loads(line) for line in file.read_text().splitlines()] for file in files)
    shown = {"name": "run", "project": None, "group": None, "tags": []}
    start = [shown | {"seed": TINY.seed}, ["*", "agent_steps"]]
    assert [row.get("agent_steps") if isinstance(row, dict) else row for row in first[2:]] == [
        *(192, 384, 576, "finished"),
        *(None, start[1], 768, "finished"),
    ]
    assert (first[:2], second[:2]) == (start, start)
    assert [row["agent_steps"] for row in second[2:-1]] == [192, 384, 576]
    assert all(not math.isnan(value) for row in second[2:-1] for value in row.values())
    assert not (tmp_path / "run" / "tensorboard").exists()


def test_weights_and_biases_shows_a_run_as_it_is_told(tmp_path, packages):
    (packages / "wandb.py").write_text(WANDB)
    tracking = TrackingConfig(project="mapf", group="sweep", run_name="first", tags=("small", "new"))
    train(dataclasses.replace(TINY, loggers=("wandb",), tracking=tracking), tmp_path / "run")
    [file] = tmp_path.glob("logged-*.jsonl")
    assert json.loads(file.read_text().splitlines()[0]) == {
        "project": "mapf",
        "group": "sweep",
        "name": "first",
        "tags": ["small", "new"],
        "seed": TINY.seed,
    }


MLFLOW = """
import json
from pathlib import Path
from types import SimpleNamespace

FILE = Path(__file__).parents[1] / "logged.jsonl"

def tell(*told):
    with FILE.open("a") as stream:
        print(json.dumps(told), file=stream)

class MlflowClient:
    def get_experiment_by_name(self, name):
        return SimpleNamespace(experiment_id="7") if name == "known" else None

    def create_experiment(self, name):
        tell("experiment", name)
        return "8"

    def create_run(self, experiment_id, run_name, tags):
        tell("run", experiment_id, run_name, tags)
        return SimpleNamespace(info=SimpleNamespace(run_id="r1"))

    def log_param(self, run_id, key, value):
        tell("param", run_id, key, value)

    def log_batch(self, run_id, metrics):
        tell("rows", run_id, metrics[0].step, {metric.key: metric.value for metric in metrics})

    def set_terminated(self, run_id):
        tell("end", run_id)
"""
MLFLOW_ENTITIES = """
from dataclasses import dataclass

@dataclass
class Metric:
    key: str
    value: float
    timestamp: int
    step: int
"""


def test_mlflow_gets_all_rows_also_of_a_resumed_run(tmp_path, packages, monkeypatch):
    monkeypatch.delenv("MLFLOW_EXPERIMENT_NAME", raising=False)
    (packages / "mlflow").mkdir()
    (packages / "mlflow" / "__init__.py").write_text(MLFLOW)
    (packages / "mlflow" / "entities.py").write_text(MLFLOW_ENTITIES)
    told = packages / "logged.jsonl"
    config = dataclasses.replace(TINY, loggers=("mlflow",))
    folder = train(config, tmp_path / "run")
    resume(folder, agent_steps=768)
    lines = [json.loads(line) for line in told.read_text().splitlines()]
    assert lines[:2] == [["experiment", "Default"], ["run", "8", "run", {}]]
    parameters = {line[2]: line[3] for line in lines if line[0] == "param"}
    assert (parameters["seed"], parameters["optimization.num_envs"]) == (TINY.seed, TINY.optimization.num_envs)
    rest = [line for line in lines[2:] if line[0] != "param"]
    assert [line[2] if line[0] == "rows" else line[0] for line in rest] == [192, 384, 576, "end", 768, "end"]
    assert {line[1] for line in rest} == {"r1"}
    assert all(not math.isnan(value) for line in rest if line[0] == "rows" for value in line[3].values())
    told.unlink()
    tracking = TrackingConfig(project="known", group="sweep", run_name="first", tags=("small",))
    train(dataclasses.replace(config, tracking=tracking), folder, overwrite=True)
    assert json.loads(told.read_text().splitlines()[0]) == ["run", "7", "first", {"small": "true", "group": "sweep"}]


def test_a_logger_that_fails_keeps_the_run_that_was_to_be_overwritten(tmp_path, packages):
    folder = train(TINY, tmp_path / "run")
    before = {file: file.read_bytes() for file in folder.rglob("*") if file.is_file()}
    (packages / "wandb.py").write_text("def init(**_):\n    raise RuntimeError('no network')\n")
    config = dataclasses.replace(TINY, seed=5, loggers=("wandb",))
    for output, overwrite in ((folder, True), (tmp_path / "other", False)):
        with pytest.raises(RuntimeError, match="no network"):
            train(config, output, overwrite=overwrite)
    after = {file: file.read_bytes() for file in folder.rglob("*") if file.is_file() and "wandb" not in file.parts}
    assert load_policy(folder).act({}) == {}
    assert {file: content for file, content in after.items() if file.name != ".lock"} == {
        file: content for file, content in before.items() if file.name != ".lock"
    }
    assert not (tmp_path / "other" / "config.json").exists()


def test_interrupt_saves_the_policy(tmp_path):
    def interrupt(_row):
        raise KeyboardInterrupt

    on_progress: Progress = interrupt
    with pytest.raises(KeyboardInterrupt):
        train(TINY, tmp_path, on_progress)
    assert load_policy(tmp_path).act({}) == {}


@pytest.mark.parametrize(
    ("name", "credit", "group"),
    [("mappo", "agent", "agents"), ("ippo", "agent", "agents")]
    + [("central-ppo", credit, "team") for credit in ("team", "agent")],
)
def test_truncation_bootstraps_and_termination_does_not(name, credit, group):
    env = BatchedMapfEnv(2, **TINY.task.env_keywords())
    algorithm = ALGORITHMS[name](dataclasses.replace(TINY, ppo=dataclasses.replace(TINY.ppo, credit=credit)))
    loss = algorithm.loss
    batch = TransformedEnv(env, Compose(*algorithm.transforms(0))).rollout(1, algorithm.actor)
    batch["next", algorithm.reward_key] = torch.zeros_like(batch["next", algorithm.reward_key])
    batch["next", "done"] = torch.ones_like(batch["next", "done"])
    batch["next", "terminated"] = torch.tensor([[[True]], [[False]]])
    with torch.no_grad():
        loss.value_estimator(batch, params=loss.critic_network_params)
    value, following = batch[group, "state_value"], batch["next", group, "state_value"]
    torch.testing.assert_close(batch["advantage"][0], -value[0])
    torch.testing.assert_close(batch["advantage"][1], TINY.ppo.gamma * following[1] - value[1])


def test_missing_and_damaged_policies_are_one_line(tmp_path):
    with pytest.raises(FileNotFoundError, match="expected the folder of a training run"):
        load_policy(tmp_path / "nothing")
    folder = train(dataclasses.replace(TINY, agent_steps=192), tmp_path / "run")
    config = json.loads((folder / "config.json").read_text())
    config["model"]["hidden"] = 32
    (folder / "config.json").write_text(json.dumps(config))
    with pytest.raises(mapf_pz.FormatError, match=r"not the weights that config\.json describes") as caught:
        load_policy(folder)
    assert "\n" not in str(caught.value)
    (folder / "policy.safetensors").write_bytes(b"\xff" * 100)
    with pytest.raises(mapf_pz.FormatError, match="not the weights"):
        load_policy(folder)
    (folder / "config.json").write_text('{"algorithm": "dqn"}')
    with pytest.raises(mapf_pz.FormatError, match="algorithm"):
        load_policy(folder)


def test_a_team_policy_says_how_many_agents_it_acts_for(tmp_path):
    policy = load_policy(train(dataclasses.replace(TINY, algorithm="central-ppo", agent_steps=192), tmp_path))
    env = mapf_pz.parallel_env(**policy.env_kwargs, num_agents=4)
    with pytest.raises(ValueError, match="exactly 3 agents, 4 observe"):
        policy.act(env.reset(seed=0)[0])


@pytest.mark.parametrize("algorithm", ["mappo", "ippo", "central-ppo"])
def test_all_ideas_combined(tmp_path, algorithm):
    task = changed(
        TINY.task,
        channels=("view", "cost_to_go", "heuristic"),
        features=("goal_vector", "location", "last_actions"),
        edge_weights="crisscross",
        num_frames=2,
        num_neighbors=1,
    )
    model = dataclasses.replace(TINY.model, encoder="residual", recurrent=8)
    config = dataclasses.replace(
        TINY, task=task, model=model, algorithm=algorithm, curiosity=CuriosityConfig(kind="rnd", size=8)
    )
    assert len(rows(train(config, tmp_path))) == 3
    task = EvaluationTask("empty", 3, {"map": "empty-8-8", "num_agents": 3, "max_steps": 8}, episodes=2)
    assert len(evaluate({"it": load_policy(tmp_path)}, [task])) == 2


@pytest.mark.parametrize("has_instructions", [False, True])
def test_automatic_precision_depends_on_the_instructions_of_the_cpu(monkeypatch, has_instructions):
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: {"avx512_bf16": has_instructions})
    with torch.device("cpu"):
        learner = MAPPO(dataclasses.replace(TINY, precision="auto")).make_learner()
    with learner.autocast():
        product = torch.ones(2, 2) @ torch.ones(2, 2)
    assert product.dtype == (torch.bfloat16 if has_instructions else torch.float32)


def test_training_never_uses_the_seeds_of_evaluations():
    num_envs = TINY.optimization.num_envs
    assert dataclasses.replace(TINY, seed=1_000_000 - num_envs).seed + num_envs == EvaluationTask.seed
    with pytest.raises(ValueError, match="seed=999997: expected at most 999996, since evaluations use the following"):
        dataclasses.replace(TINY, seed=1_000_001 - num_envs)
