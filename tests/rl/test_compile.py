"""Compiled losses."""

import dataclasses
import shutil

import pytest

from mapf_pz.rl import train
from mapf_pz.rl.algorithms.named import ALGORITHMS
from mapf_pz.rl.config import ImitationConfig
from tests.helpers.small_run import TINY, changed, rows

DAGGER = {
    "algorithm": "dagger",
    "task": changed(TINY.task, action_model="cardinal"),
    "imitation": ImitationConfig("pibt"),
}


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("g++") is None, reason="no C++ compiler")
@pytest.mark.filterwarnings("ignore::FutureWarning", "ignore::DeprecationWarning", "ignore::UserWarning")
@pytest.mark.filterwarnings("ignore:Guards may run slower on Python 3.13.0:RuntimeWarning")  # not on 3.13.1
@pytest.mark.parametrize("fields", [{}, DAGGER], ids=["mappo", "dagger"])
def test_a_compiled_loss_is_the_same(tmp_path, fields):
    config = dataclasses.replace(TINY, **fields)
    plain, compiled = (
        rows(train(dataclasses.replace(config, compile=value), tmp_path / str(value))) for value in (False, True)
    )
    assert len(plain) == 3
    for one, other in zip(plain, compiled, strict=True):
        for name in ("return", "loss_critic", "entropy", "loss", "agreement"):
            if name in one:
                assert float(other[name]) == pytest.approx(float(one[name]), rel=1e-3, nan_ok=True)


@pytest.mark.slow
def test_without_a_compiler(monkeypatch):
    monkeypatch.delenv("CXX", raising=False)
    monkeypatch.setenv("PATH", "")
    algorithm = ALGORITHMS["mappo"](dataclasses.replace(TINY, compile=True))
    with pytest.raises(
        ValueError, match=r"^compile=True: found no compiler; expected g\+\+, or the path of one in CXX$"
    ):
        algorithm.make_learner()
    ALGORITHMS["mappo"](TINY).make_learner()
