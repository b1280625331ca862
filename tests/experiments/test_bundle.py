"""A run's policy becomes one of the package."""

from dataclasses import replace
from math import isnan

import torch

from experiments.policies import bundle, cards
from mapf_pz.rl import load_policy, train
from mapf_pz.rl.policies.folder import WEIGHTS
from mapf_pz.rl.progress import read_progress
from tests.helpers.small_run import TINY


def test_a_policy_has_rounded_weights_validations_and_a_card(tmp_path, monkeypatch):
    run = train(replace(TINY, validation_interval=200), tmp_path / "run")
    for module in (bundle, cards):
        monkeypatch.setattr(module, "bundled", lambda: tmp_path)
    bundle.main(bundle.Options(run, "mine"))
    original, copy = load_policy(run), load_policy(tmp_path / "mine")
    assert copy.config == original.config
    for name, weight in original.network.state_dict().items():
        assert torch.equal(copy.network.state_dict()[name], weight.half().float())
    assert (tmp_path / "mine" / WEIGHTS).stat().st_size < 0.7 * (run / WEIGHTS).stat().st_size
    whole, kept = read_progress(run), read_progress(tmp_path / "mine")
    assert 1 < len(kept) < len(whole)
    assert kept[-1] == whole[-1]
    assert not any(isnan(row["validation_return"]) for row in kept[:-1])
    text = (tmp_path / "mine" / "README.md").read_text()
    assert f"| agent steps | {whole[-1]['agent_steps']:.0f} |" in text
