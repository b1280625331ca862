"""Whatever the bytes in a checkpoint or a policy, as `tests/test_fuzz.py` has it for other files."""

import json
import pickle
import random
import struct
import zipfile
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from safetensors.torch import load_file, save_file

from mapf_pz.rl import load_policy
from mapf_pz.rl.algorithms.named import ALGORITHMS
from mapf_pz.rl.config_file import config_files
from mapf_pz.rl.policies.folder import WEIGHTS
from mapf_pz.rl.policies.load import save_weights
from mapf_pz.rl.training.checkpoint import Checkpoints, Position, read_position, restore
from tests.helpers.corrupt_files import TOKENS, Case, as_json, bounded, changed, fuzzed, outcome, refused
from tests.helpers.small_run import TINY


@pytest.fixture(scope="session")
def trained(tmp_path_factory):
    """A policy's two files, a checkpoint's files by their names, and a call that reads those from a file."""
    folder = tmp_path_factory.mktemp("trained")
    algorithm = ALGORITHMS[TINY.algorithm](TINY)
    learner, checkpoints = algorithm.make_learner(), Checkpoints(folder)
    learner.step(sum(parameter.sum() for parameter in algorithm.network.parameters()), 1.0)  # has a state from now on
    save_weights(folder, algorithm.network)
    checkpoints.save(learner, Position(1, 192, 0.5))
    with zipfile.ZipFile(checkpoints.latest()) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}

    def read_checkpoint(file):
        restore(file, learner)
        return read_position(file)

    return config_files(TINY) | {WEIGHTS: (folder / WEIGHTS).read_bytes()}, members, read_checkpoint


def as_archive(file, members, compression=zipfile.ZIP_STORED):
    with zipfile.ZipFile(file, "w", compression) as archive:
        for name, content in members.items():
            archive.writestr(zipfile.ZipInfo(name), content, compression)
    return file


def as_safetensors(header, data=b"", length=None):
    header = header if isinstance(header, bytes) else as_json(header)
    return struct.pack("<Q", len(header) if length is None else length) + header + data


def changed_head(content):
    """Change the header of safetensors; its length tells the truth or not."""
    end = 8 + struct.unpack("<Q", content[:8])[0]
    lengths = st.sampled_from([None, None, None, 0, 2**31, 2**60, 2**64 - 1])
    return st.builds(as_safetensors, changed(content[8:end]), st.just(content[end:]), lengths)


def changed_file(name, content):
    return changed_head(content) | changed(content) if name.endswith("safetensors") else changed(content)


@fuzzed
@given(st.data())
def test_a_changed_policy_is_read_or_refused_in_one_line(trained, data):
    files = trained[0]
    name = data.draw(st.sampled_from(sorted(files)))
    content = data.draw(changed_file(name, files[name]))
    with TemporaryDirectory() as folder:
        outcome(Case(files, load_policy).written(Path(folder), {name: content}))


@fuzzed
@given(st.data())
def test_a_changed_checkpoint_is_read_or_refused_in_one_line(trained, data):
    _, members, read = trained
    name = data.draw(st.sampled_from(sorted(members)))
    content = data.draw(changed_file(name, members[name]))
    with TemporaryDirectory() as folder:
        outcome(partial(read, as_archive(Path(folder) / "c.torchrl", members | {name: content})))


@pytest.mark.parametrize("seed", range(100))
def test_changed_bytes_of_a_checkpoint_are_read_or_refused_in_one_line(trained, tmp_path, seed):
    _, members, read = trained
    file = as_archive(tmp_path / "c.torchrl", members)
    content, draw = file.read_bytes(), random.Random(seed)
    for _ in range(draw.randint(1, 3)):
        first, second = sorted(draw.choices(range(len(content)), k=2))
        new = draw.choice([b"", draw.randbytes(draw.randint(1, 4)), content[first:second], draw.choice(TOKENS)])
        content = content[:first] + new + content[draw.choice([first + len(new), first, second]) :]
    file.write_bytes(content[: draw.choice([None, None, second])])
    outcome(partial(read, file))


LIES = {
    "length": as_safetensors({}, length=2**60),
    "length beyond the file": as_safetensors({}, length=100),
    "offsets": as_safetensors({"a": {"dtype": "F32", "shape": [2], "data_offsets": [0, 2**40]}}, bytes(8)),
    "backwards": as_safetensors({"a": {"dtype": "F32", "shape": [2], "data_offsets": [8, 0]}}, bytes(8)),
    "shape": as_safetensors({"a": {"dtype": "F32", "shape": [2**40, 2**40], "data_offsets": [0, 8]}}, bytes(8)),
    "shape of nothing": as_safetensors({"a": {"dtype": "F32", "shape": [0, 2**63], "data_offsets": [0, 0]}}),
    "dtype": as_safetensors({"a": {"dtype": "X", "shape": [2], "data_offsets": [0, 8]}}, bytes(8)),
    "complex": as_safetensors({"a": {"dtype": "C64", "shape": [1], "data_offsets": [0, 8]}}, bytes(8)),
    "deep": as_safetensors(b"[" * 100_000),
    "empty": b"",
    "pickle": pickle.dumps({"weights": [1.0]}),
}


def test_the_weights_file_stands_for_its_folder_and_has_numbers_of_16_or_32_bits(trained, tmp_path):
    Case(trained[0], load_policy).written(tmp_path)()
    assert load_policy(tmp_path / WEIGHTS).config == TINY
    weights = load_file(tmp_path / WEIGHTS)
    save_file({name: weight.half() for name, weight in weights.items()}, tmp_path / WEIGHTS)
    assert all(weight.dtype == torch.float32 for weight in load_policy(tmp_path).network.parameters())
    save_file({name: weight.double() for name, weight in weights.items()}, tmp_path / WEIGHTS)
    refused(partial(load_policy, tmp_path), "expected numbers of 16 or 32 bits")


@pytest.mark.parametrize("lie", LIES.values(), ids=list(LIES))
def test_weights_with_false_sizes(trained, tmp_path, lie):
    files, members, read_checkpoint = trained
    with bounded():
        refused(
            Case(files, load_policy).written(tmp_path, {"policy.safetensors": lie}), r"policy\.safetensors: not the"
        )
    (name,) = (name for name in members if name.endswith("safetensors"))
    with bounded():
        refused(lambda: read_checkpoint(as_archive(tmp_path / "c", members | {name: lie})), "not a checkpoint")


@pytest.mark.parametrize(
    "model",
    [
        {"hidden": 10**9},
        {"hidden": 10**30},
        {"hidden": -1},
        {"hidden": 0},
        {"recurrent": 10**9},
        {"head": [10**9, 10**9]},
        {"head": [1] * 100_000},
        {"conv_channels": []},
        {"conv_channels": [10**12]},
        {"encoder": "residual", "num_blocks": 10**9},
        {"encoder": "report"},
    ],
    ids=lambda model: str(model)[:40],
)
def test_configurations_of_huge_networks(trained, tmp_path, model):
    config = json.loads(trained[0]["config.json"])
    config["model"] |= model
    with bounded():
        refused(Case(trained[0], load_policy).written(tmp_path, {"config.json": as_json(config)}))


def test_checkpoints_that_are_bombs_pickles_or_folders(trained, tmp_path):
    _, members, read = trained
    assert read(as_archive(tmp_path / "c", members)).updates == 1
    bomb = as_archive(tmp_path / "bomb", members | {"x": bytes(10_000_000)}, zipfile.ZIP_DEFLATED)
    (tmp_path / "pickle").write_bytes(pickle.dumps({"weights": [1.0]}))
    for file in (bomb, tmp_path / "pickle", tmp_path):
        with bounded():
            refused(partial(read, file), "not a checkpoint of this run")
