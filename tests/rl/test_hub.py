"""Policies on the Hugging Face Hub, which is a folder here."""

import shutil
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

from mapf_pz.commands.main import main
from mapf_pz.evaluation import policy_factory
from mapf_pz.rl import load_policy, train
from mapf_pz.rl.policies.folder import bundled, policy_folder
from mapf_pz.rl.policies.hub import is_address
from tests.helpers.small_run import TINY


@pytest.fixture
def hub(tmp_path, monkeypatch):
    """Replace the Hub by a folder, and return it: repositories are `USER/NAME`, revisions `USER/NAME@REVISION`."""
    package = pytest.importorskip("huggingface_hub")
    folder = tmp_path / "hub"

    def snapshot_download(repository, revision=None, allow_patterns=()):
        source = folder / (repository if revision is None else f"{repository}@{revision}")
        if not source.exists():
            raise OSError(f"404: {repository}")
        target = tmp_path / "cache" / source.name
        target.mkdir(parents=True, exist_ok=True)
        for name in allow_patterns:
            if (source / name).exists():
                shutil.copy(source / name, target)
        return str(target)

    class HfApi:
        def create_repo(self, repository, private, exist_ok):
            assert exist_ok
            (folder / repository).mkdir(parents=True, exist_ok=True)
            if private:
                (folder / repository / ".private").touch()

        def upload_folder(self, repo_id, folder_path, revision):
            assert revision is None
            shutil.copytree(folder_path, folder / repo_id, dirs_exist_ok=True)
            return SimpleNamespace(commit_url=f"https://huggingface.co/{repo_id}/commit/1")

    monkeypatch.setattr(package, "snapshot_download", snapshot_download)
    monkeypatch.setattr(package, "HfApi", HfApi)
    return folder


def same_weights(one, other):
    return all(map(torch.equal, one.network.state_dict().values(), other.network.state_dict().values()))


def test_a_policy_is_pushed_and_loaded_from_its_address(hub, tmp_path, capsys):
    run = train(TINY, tmp_path / "run")
    (run / "evaluation.md").write_text("| CSR |\n| --- |\n| 0.5 |\n")
    assert main(["policy", "push", str(run), "hf://me/tiny", "--license", "Apache-2.0", "--private"]) == 0
    assert capsys.readouterr().out.endswith("https://huggingface.co/me/tiny/commit/1\n")
    pushed = {file.name for file in (hub / "me" / "tiny").iterdir()}
    assert pushed == {"config.json", "policy.safetensors", "README.md", ".private"}
    card = (hub / "me" / "tiny" / "README.md").read_text()
    assert card.startswith("---\nlicense: apache-2.0\n")
    assert f"| agent steps | {TINY.agent_steps} |" in card
    assert "| CSR |" in card
    loaded = load_policy("hf://me/tiny")
    assert same_weights(loaded, load_policy(run))
    assert {file.name for file in policy_folder("hf://me/tiny").iterdir()} == {"config.json", "policy.safetensors"}


def test_a_revision(hub):
    shutil.copytree(bundled() / "mappo", hub / "me" / "policy@v1")
    shutil.copytree(bundled() / "ippo", hub / "me" / "policy")
    assert same_weights(load_policy("hf://me/policy@v1"), load_policy("mappo"))
    assert same_weights(load_policy("hf://me/policy"), load_policy("ippo"))


def test_a_policy_is_evaluated_by_its_address(hub, capsys):
    shutil.copytree(bundled() / "mappo", hub / "me" / "policy")
    words = ["--map", "empty-8-8", "--num-agents", "2", "--episodes", "2", "--max-steps", "20"]
    policies = ("hf://me/policy", "hf://me/policy+pibt", "hf://me/policy+pibt:patience=2,temperature=0")
    assert main(["evaluate", *(word for name in policies for word in ("--policy", name)), *words]) == 0
    assert "hf://me/policy" in capsys.readouterr().out
    identity = policy_factory("hf://me/policy").identity
    assert identity == policy_factory("mappo").identity


def test_a_policy_is_pulled(hub, tmp_path, capsys):
    shutil.copytree(bundled() / "mappo", hub / "me" / "policy")
    assert main(["policy", "pull", "hf://me/policy", str(tmp_path / "mine")]) == 0
    assert same_weights(load_policy(tmp_path / "mine"), load_policy("mappo"))
    assert main(["policy", "pull", "hf://me/policy", str(tmp_path / "mine")]) == 1
    assert capsys.readouterr().err == f"mapf-pz policy: '{tmp_path / 'mine'}' exists already\n"


def test_a_repository_that_does_not_exist(hub, capsys):
    assert main(["policy", "export", "hf://me/missing", "out.onnx"]) == 1
    assert capsys.readouterr().err == "mapf-pz policy: 404: me/missing\n"
    assert not Path("out.onnx").exists()


@pytest.mark.parametrize("address", ["hf://me", "hf://me/", "hf:///policy", "hf://me/a/b", "hf://me/a@", "hf://me/a b"])
def test_an_address_that_is_not_valid(address):
    assert not is_address(address)
    with pytest.raises(ValueError, match=f"^'{address}': expected hf://USER/NAME or hf://USER/NAME@REVISION$"):
        load_policy(address)


def test_without_the_package(monkeypatch):
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    with pytest.raises(ImportError, match=r"require huggingface_hub: pip install 'mapf-pz\[hub\]'$"):
        load_policy("hf://me/policy")
