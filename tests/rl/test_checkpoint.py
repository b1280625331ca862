import dataclasses
import json
import math
import os
import shutil
import signal
import threading
import time
import zipfile

import pytest
import torch
from torchrl.checkpoint import Checkpoint
from torchrl.envs import Transform

import mapf_pz
from mapf_pz.commands.main import main
from mapf_pz.instances import load_map, write_map
from mapf_pz.rl import load_policy, train
from mapf_pz.rl.algorithms.named import ALGORITHMS
from mapf_pz.rl.config import ModelConfig
from mapf_pz.rl.training.checkpoint import Checkpoints, Position, read_position, restore
from mapf_pz.rl.training.run import RunFolder
from mapf_pz.rl.training.train import resume
from tests.helpers import small_run as tiny
from tests.helpers.small_run import rows

TINY = dataclasses.replace(tiny.TINY, agent_steps=1152, checkpoint_interval=1)
PER_UPDATE = 4 * 16 * 3
SHORT = "train quickstart --agent-steps 40000 --checkpoint-interval 1 --num-envs 4 --steps-per-batch 8 --num-epochs 1"
SMALL = "--num-agents 3 --height 7 --width 7 --evaluate none"


def steps(folder):
    return [int(row["agent_steps"]) for row in rows(folder)]


def train_interrupted(config, folder, updates, **options):
    seen = []

    def interrupt(row):
        seen.append(row)
        if len(seen) == updates:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(config, folder, interrupt, **options)


def make_learner(config=TINY):
    learner = ALGORITHMS[config.algorithm](config).make_learner()
    sum(parameter.square().sum() for parameter in learner.loss.parameters()).backward()
    learner.optimizer.step()
    return learner


@pytest.fixture(scope="module")
def stopped(tmp_path_factory):
    """The folder of a run that was interrupted after three of its six updates, with a checkpoint after each."""
    folder = tmp_path_factory.mktemp("stopped") / "run"
    train_interrupted(TINY, folder, 3)
    return folder


@pytest.fixture
def run(stopped, tmp_path):
    """A copy of that folder."""
    return shutil.copytree(stopped, tmp_path / "run")


def test_a_map_that_was_changed_in_place_is_refused(tmp_path):
    file = tmp_path / "mine.map"
    write_map(load_map("empty-8-8"), file)
    env = dataclasses.replace(TINY.task.env, map=file)
    task = dataclasses.replace(TINY.task, env=env)
    train_interrupted(dataclasses.replace(TINY, task=task), tmp_path / "run", 3)
    before = file.read_text()
    file.write_text(before.replace("map\n.", "map\n@"))
    with pytest.raises(mapf_pz.FormatError, match="expected the inputs to be those of its run"):
        resume(tmp_path / "run")
    assert len(steps(tmp_path / "run")) == 3
    file.write_text(before)
    resume(tmp_path / "run")
    assert len(steps(tmp_path / "run")) == 6


@pytest.mark.parametrize("algorithm", ["mappo", "ippo", "central-ppo"])
@pytest.mark.parametrize("interval", [1, 10**9])
def test_a_stopped_run_continues_to_the_same_end(tmp_path, algorithm, interval):
    config = dataclasses.replace(TINY, algorithm=algorithm, checkpoint_interval=interval)
    train_interrupted(config, tmp_path, 3)
    before = rows(tmp_path)
    assert len(before) == 3
    calls = []
    assert resume(tmp_path, on_progress=calls.append) == tmp_path
    assert steps(tmp_path) == [PER_UPDATE * (i + 1) for i in range(6)]
    assert rows(tmp_path)[:3] == before
    assert [row["agent_steps"] for row in calls] == steps(tmp_path)[3:]
    assert float(rows(tmp_path)[3]["seconds"]) > float(before[-1]["seconds"])
    assert load_policy(tmp_path).act({}) == {}
    assert load_policy(tmp_path).config == config


def test_rows_after_the_checkpoint_are_cut(run):
    checkpoints = sorted((run / "checkpoints").iterdir())
    assert [read_position(file).updates for file in checkpoints][-2:] == [2, 3]
    checkpoints[-1].unlink()
    with (run / "progress.csv").open("a") as file:
        file.write("768,0.1")  # killed while it wrote
    resume(run, agent_steps=4 * PER_UPDATE)
    assert steps(run) == [PER_UPDATE * (i + 1) for i in range(4)]


def test_a_finished_run_can_be_made_longer_and_not_shorter(tmp_path):
    made = []

    class Recording(ALGORITHMS["mappo"]):
        def transforms(self, seed):
            made.append(seed)
            return super().transforms(seed)

    train(dataclasses.replace(TINY, agent_steps=384), tmp_path)
    resume(tmp_path, make_algorithm=Recording)
    assert not made  # no environments
    assert len(rows(tmp_path)) == 2
    with pytest.raises(ValueError, match="has already reached 384"):
        resume(tmp_path, agent_steps=192)
    resume(tmp_path, agent_steps=576)
    assert len(rows(tmp_path)) == 3
    assert load_policy(tmp_path).config.agent_steps == 576


def test_a_new_run_in_the_folder_replaces_the_checkpoints(tmp_path):
    train(TINY, tmp_path)
    train_interrupted(dataclasses.replace(TINY, seed=1), tmp_path, 1, overwrite=True)
    assert [read_position(file).updates for file in (tmp_path / "checkpoints").iterdir()] == [1]


def test_checkpoints_are_an_interval_apart_and_at_the_end(tmp_path):
    saved = []

    def on_progress(_row):
        saved.append(max((read_position(file).updates for file in (tmp_path / "checkpoints").glob("*")), default=0))

    train(
        dataclasses.replace(TINY, agent_steps=7 * PER_UPDATE, checkpoint_interval=2 * PER_UPDATE), tmp_path, on_progress
    )
    assert saved == [0, 2, 2, 4, 4, 6, 6]
    assert read_position(Checkpoints(tmp_path).latest()).updates == 7


@pytest.mark.parametrize("name", ["CSR", "throughput"])
def test_a_checkpoint_is_as_good_as_the_last_hundred_episodes(tmp_path, name):
    run, learner, scores = RunFolder(tmp_path), make_learner(), []
    run.prepare(TINY)
    for update, (episodes, mean) in enumerate([(0, math.nan), (50, 0.5), (40, 1.0), (60, 0.25), (120, 0.75)], 1):
        run.log({"agent_steps": update, "episodes": episodes, name: mean})
        run.save(learner)
        scores.append(read_position(run.checkpoints.latest()).score)
    assert scores == pytest.approx([0, 0.5, (0.5 * 50 + 40) / 90, (40 + 0.25 * 60) / 100, 0.75])


@pytest.mark.parametrize("name", ["CSR", "throughput"])
def test_without_training_episodes_a_checkpoint_is_as_good_as_the_latest_validation(tmp_path, name):
    run, learner, scores = RunFolder(tmp_path), make_learner(), []
    run.prepare(TINY)
    for update, mean in enumerate([math.nan, 0.5, math.nan, 0.25], 1):
        run.log({"agent_steps": update, "loss": 1.0, f"validation_{name}": mean})
        run.save(learner)
        scores.append(read_position(run.checkpoints.latest()).score)
    assert scores == [0, 0.5, 0.5, 0.25]
    kept = sorted(read_position(file).updates for file in run.checkpoints.folder.iterdir())
    assert kept == [3, 4]  # of equal checkpoints, the newest is the best


def test_without_any_score_the_last_two_checkpoints_are_kept(tmp_path):
    run, learner = RunFolder(tmp_path), make_learner()
    run.prepare(TINY)
    for update in range(1, 4):
        run.log({"agent_steps": update, "loss": 1.0})
        run.save(learner)
    assert sorted(read_position(file).updates for file in run.checkpoints.folder.iterdir()) == [2, 3]


class RecordInstances(Transform):
    """Record the first observations and positions of each episode."""

    def __init__(self, instances):
        super().__init__()
        self.instances = instances

    def _reset(self, tensordict, tensordict_reset):
        chosen = tensordict.get("_reset", torch.ones(tensordict_reset.batch_size, dtype=torch.bool)).flatten()
        group = tensordict_reset["agents"][chosen]
        for image, position in zip(group["observation", "image"], group["position"], strict=True):
            self.instances.append(image.numpy().tobytes() + position.numpy().tobytes())
        return tensordict_reset


@pytest.mark.parametrize("algorithm", ["mappo", "central-ppo"])
def test_resumed_runs_train_on_new_instances(tmp_path, algorithm):
    instances = []

    class Recording(ALGORITHMS[algorithm]):
        def transforms(self, seed):
            return [RecordInstances(instances), *super().transforms(seed)]

    def recorded(run):
        instances.clear()
        run()
        assert len(set(instances)) == len(instances) > 4
        return set(instances)

    config = dataclasses.replace(TINY, algorithm=algorithm)
    first = recorded(lambda: train_interrupted(config, tmp_path, 1, make_algorithm=Recording))
    second = recorded(lambda: resume(tmp_path, 576, make_algorithm=Recording))
    third = recorded(lambda: resume(tmp_path, 960, make_algorithm=Recording))
    assert not first & second
    assert not (first | second) & third


def test_a_checkpoint_holds_weights_moments_and_random_numbers(tmp_path):
    learner, other = make_learner(), make_learner(dataclasses.replace(TINY, seed=1))
    parameters = list(other.loss.parameters())
    checkpoints = Checkpoints(tmp_path)
    checkpoints.save(learner, Position(1, 192, 0.5))
    kept = learner.tensors()
    expected = torch.rand(3)
    assert any(not torch.equal(tensor, kept[name]) for name, tensor in other.tensors().items())
    restore(checkpoints.latest(), other)
    assert torch.equal(torch.rand(3), expected)
    torch.set_rng_state(kept["random"])
    torch.testing.assert_close(other.tensors(), kept, rtol=0, atol=0)
    assert all(one is two for one, two in zip(parameters, other.loss.parameters(), strict=True))


def test_the_last_two_and_the_best_are_kept(tmp_path):
    checkpoints, learner = Checkpoints(tmp_path), make_learner()
    for update, csr in enumerate((0.1, 0.7, 0.2, 0.3, 0.4), 1):
        checkpoints.save(learner, Position(update, update * 10, csr))
    assert [read_position(file).updates for file in sorted(checkpoints.folder.iterdir())] == [2, 4, 5]


@pytest.mark.figure
def test_nothing_is_pickled(tmp_path):
    train(TINY, tmp_path)
    names = {name for file in (tmp_path / "checkpoints").iterdir() for name in zipfile.ZipFile(file).namelist()}
    assert {name.rpartition(".")[2] for name in names} == {"json", "safetensors"}
    files = {file for file in tmp_path.rglob("*") if file.is_file() and file.parent.name != "tensorboard"}
    assert {file.suffix for file in files} == {".json", ".csv", ".png", ".safetensors", ".torchrl"}
    content = b"".join(file.read_bytes() for file in (tmp_path / "checkpoints").iterdir())
    assert b"pickle" not in content


def truncated(file):
    file.write_bytes(file.read_bytes()[:-200])


def with_a_flipped_bit(file):
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)


def empty(file):
    file.write_bytes(b"")


def not_an_archive(file):
    file.write_bytes(b"\x80\x05pickle")


def manifest_of_a_list(file):
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("manifest.json", "[]")


def without_its_position(file):
    with zipfile.ZipFile(file) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    manifest = json.loads(members["manifest.json"])
    del manifest["metadata"]["updates"]
    with zipfile.ZipFile(file, "w") as archive:
        for name, content in (members | {"manifest.json": json.dumps(manifest)}).items():
            archive.writestr(name, content)


def of_other_components(file):
    Checkpoint(format="archive", value={"a": 1}).save(file, metadata=dataclasses.asdict(Position(3, 576, 0.0)))


def of_other_networks(file):
    learner = make_learner(dataclasses.replace(TINY, model=ModelConfig(conv_channels=(4,), hidden=8)))
    checkpoints = Checkpoints(file.parent.parent)
    file.unlink()
    checkpoints.save(learner, Position(3, 576, 0.0))


def saved_as(file, tensors):
    learner, checkpoints = make_learner(), Checkpoints(file.parent.parent)
    kept = learner.tensors()
    learner.tensors = lambda: tensors(kept)
    file.unlink()
    checkpoints.save(learner, Position(3, 576, 0.0))


def of_whole_numbers(file):
    saved_as(file, lambda kept: {name: t.to(torch.int8) if "loss/" in name else t for name, t in kept.items()})


def with_moments_of_half_precision(file):
    saved_as(file, lambda kept: {name: t.half() if "optimizer/" in name else t for name, t in kept.items()})


def without_its_optimizer(file):
    saved_as(file, lambda kept: {name: t for name, t in kept.items() if "optimizer/" not in name})


@pytest.mark.parametrize(
    "damage",
    [
        of_whole_numbers,
        with_moments_of_half_precision,
        without_its_optimizer,
        truncated,
        with_a_flipped_bit,
        empty,
        not_an_archive,
        manifest_of_a_list,
        without_its_position,
        of_other_components,
        of_other_networks,
    ],
)
def test_a_damaged_or_foreign_checkpoint_is_one_line(run, damage):
    newest = max((run / "checkpoints").iterdir())
    damage(newest)
    progress = (run / "progress.csv").read_bytes()
    with pytest.raises(mapf_pz.FormatError, match="not a checkpoint of this run; delete it to continue") as caught:
        resume(run)
    assert "\n" not in str(caught.value)
    assert (run / "progress.csv").read_bytes() == progress
    newest.unlink()
    resume(run, agent_steps=3 * PER_UPDATE)
    assert len(rows(run)) == 3


def test_a_checkpoint_of_other_batches_is_one_line(run):
    config = json.loads((run / "config.json").read_text())
    config["optimization"]["num_envs"] = 8
    (run / "config.json").write_text(json.dumps(config))
    with pytest.raises(mapf_pz.FormatError, match=r"not a checkpoint of the run that config\.json describes"):
        resume(run)


def test_damaged_progress_is_one_line(run):
    file = run / "progress.csv"
    lines = file.read_text().splitlines()
    for content in ("", "\n".join(lines[:2]), "\n".join([*lines[:3], "x,1"]), "\n".join([*lines[:3], lines[1]])):
        file.write_text(content)
        with pytest.raises(mapf_pz.FormatError, match=r"progress\.csv: ") as caught:
            resume(run)
        assert "\n" not in str(caught.value)


def test_folders_without_a_run_are_one_line(tmp_path, capsys):
    with pytest.raises(FileNotFoundError, match="no checkpoint in"):
        resume(tmp_path)
    assert main(["train", "resume", str(tmp_path), "--evaluate", "none"]) == 1
    assert capsys.readouterr().err.count("\n") == 1


def command(folder):
    return [*SHORT.split(), *SMALL.split(), "--output", str(folder)]


def wait_for_checkpoints(folder, running):
    while len(list((folder / "checkpoints").glob("checkpoint-*"))) < 2:
        assert running()
        time.sleep(0.01)


def test_a_killed_run_continues_from_its_last_checkpoint(tmp_path):
    """The folder is copied while the run continues, so the copy is what a kill leaves; `tests.faults` sends signals."""
    run, killed = tmp_path / "run", tmp_path / "killed"

    def copy(row):
        if row["agent_steps"] == 3 * PER_UPDATE:
            shutil.copytree(run, killed)

    train(TINY, run, copy)
    assert not (killed / "policy.safetensors").exists()
    (killed / "checkpoints" / ".checkpoint-1.stage-1").mkdir()  # as if killed while it wrote
    assert read_position(Checkpoints(killed).latest()).updates == 3
    assert main(["train", "resume", str(killed), "--agent-steps", str(5 * PER_UPDATE), "--evaluate", "none"]) == 0
    assert steps(killed) == [PER_UPDATE * (i + 1) for i in range(5)]
    assert rows(killed)[:3] == rows(run)[:3]
    assert load_policy(killed).act({}) == {}
    assert not list((killed / "checkpoints").glob(".*"))


def test_sigterm_saves_a_checkpoint(tmp_path, capsys):
    def terminate():
        wait_for_checkpoints(tmp_path, threading.main_thread().is_alive)
        os.kill(os.getpid(), signal.SIGTERM)

    thread = threading.Thread(target=terminate)
    thread.start()
    assert main(command(tmp_path)) == 130
    thread.join()
    assert capsys.readouterr().err.splitlines()[-1] == "mapf-pz train: interrupted"
    done = read_position(Checkpoints(tmp_path).latest())
    assert done.updates in (len(rows(tmp_path)), len(rows(tmp_path)) - 1)
    assert load_policy(tmp_path).act({}) == {}
