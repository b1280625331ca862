"""Ways to imitate planners: the settings, the results of runs, which are not repeated, and their table."""

import shutil
from dataclasses import replace

import pytest

pytest.importorskip("torchrl")

from experiments.policies import imitation
from mapf_pz.rl.policies.folder import policy_folder


@pytest.fixture
def trained(tmp_path, monkeypatch):
    """The policy of the package is taken instead of trainings; the configurations that were trained."""
    configs, tables = [], []

    def copy(config, run):
        configs.append(config)
        shutil.copytree(policy_folder("oneshot-cardinal"), run)
        (run / "progress.csv").write_text("agent_steps,seconds\n0,1800\n1,5400\n")

    monkeypatch.setattr(imitation, "train", copy)
    columns = ("hours", "mazes 4", "mazes 4 with layer")
    monkeypatch.setattr(imitation, "STUDY", replace(imitation.STUDY, file=tmp_path / "imitation.csv", measures=columns))
    monkeypatch.setattr(imitation, "MEASURES", ("mazes 4",))
    monkeypatch.setattr(imitation, "SETS", {"mazes": imitation.SETS["mazes"]})
    monkeypatch.setattr(imitation, "TEAMS", (4,))
    monkeypatch.setattr(imitation, "write_table", lambda page, name, lines: tables.append((name, list(lines))))
    return configs, tables


def test_results_of_runs_and_their_table(tmp_path, trained):
    configs, tables = trained
    chosen = {"presets": ("oneshot-cardinal",), "settings": ("embeddings",), "agent_steps": 500_000}
    for seeds in ((0,), (0, 1)):
        imitation.main(imitation.Options(tmp_path, **chosen, seeds=seeds, episodes=2))
    assert [config.seed for config in configs] == [0, 1]
    assert {config.agent_steps for config in configs} == {500_000}
    (name, lines), *others = tables[-len(imitation.EXPERTS) :]
    assert name == "imitation oneshot-cardinal"
    assert lines[0] == "| imitation of LaCAM | seeds | million agent steps | hours | mazes 4 |"
    assert lines[2:] == ["| embeddings | 2 | 0.5 | 1.5 | 1.00; 1.00 |"]
    assert [(name, lines[2:]) for name, lines in others] == [
        ("imitation lifelong-cardinal", []),
        ("imitation oneshot", []),
        ("imitation lifelong", []),
    ]
