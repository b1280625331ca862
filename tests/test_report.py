"""The report's experiment: one change at a time, and that it can be run."""

import dataclasses
import itertools
import json

import pytest

pytest.importorskip("torchrl")

from experiments import report
from experiments.reproduction import Variation
from mapf_pz.rl.algorithms.named import ALGORITHMS
from tests.helpers.small_run import TINY


def flat(config, name=""):
    """Return the fields of a configuration by their full names."""
    if not dataclasses.is_dataclass(config):
        return {name: config}
    parts = (flat(getattr(config, field.name), f"{name}.{field.name}") for field in dataclasses.fields(config))
    return {key: value for part in parts for key, value in part.items()}


def test_each_row_makes_one_change():
    rows = [report.REPORT, *report.changes()]
    changes = []
    for above, row in itertools.pairwise(rows):
        before, after = flat(above.config), flat(row.config)
        changes.append({name for name in before.keys() | after.keys() if before.get(name) != after.get(name)})
    optimization = {".optimization.learning_rate", ".optimization.max_grad_norm"}
    assert changes[0] == {*optimization, ".ppo.gamma", ".ppo.critic_coeff"}
    assert changes[1] == {".task.env.channels"}
    assert all(name.startswith(".task.env.reward") for name in changes[2])
    assert changes[3:] == [
        {".ppo.credit"},
        {".algorithm"},
        {".task.env.view_size", ".task.env.view", ".model.encoder"},
    ]


def test_every_row_can_be_trained():
    for row in report.changes():
        ALGORITHMS[row.config.algorithm](row.config).make_learner()


def test_runs_are_kept_and_reported(tmp_path, monkeypatch):
    options = report.Options(output=tmp_path, agent_steps=768)
    row = Variation("tiny", dataclasses.replace(TINY, algorithm="central-ppo", validation_episodes=2))
    report.learn(row, 0, options)
    run = report.folder(options, row.name, 0)
    results = json.loads((run / "results.json").read_text())
    assert results["before"].keys() == results["after"].keys() == {"CSR", "ISR", "reward"}
    assert report.training_curve(run, "ISR")[-1, 0] == 768 / report.NUM_AGENTS
    *_, line = report.table({row.name: [run, run]})
    assert line.startswith("| tiny | 0.")
    assert line.count("→") == 3
    monkeypatch.setattr(report, "train", None)
    report.learn(row, 0, options)
