"""A run's policy becomes one of the package."""

import torch

from experiments import bundle
from mapf_pz.rl import load_policy, train
from mapf_pz.rl.policies.folder import WEIGHTS
from tests.helpers.small_run import TINY


def test_its_weights_are_rounded_to_half_the_size(tmp_path, monkeypatch):
    run = train(TINY, tmp_path / "run")
    monkeypatch.setattr(bundle, "bundled", lambda: tmp_path)
    bundle.main(bundle.Options(run, "mine"))
    original, copy = load_policy(run), load_policy(tmp_path / "mine")
    assert copy.config == original.config
    for name, weight in original.network.state_dict().items():
        assert torch.equal(copy.network.state_dict()[name], weight.half().float())
    assert (tmp_path / "mine" / WEIGHTS).stat().st_size < 0.7 * (run / WEIGHTS).stat().st_size
