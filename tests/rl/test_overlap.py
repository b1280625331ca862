"""Workers that collect the next batch during an update."""

import dataclasses

import pytest
import torch

from mapf_pz.rl import resume, train
from mapf_pz.rl.algorithms.named import ALGORITHMS
from tests.helpers.small_run import TINY, rows, untimed

pytestmark = pytest.mark.usefixtures("forked_processes")

OVERLAP = dataclasses.replace(TINY, collector="processes", num_workers=1, overlap=True)


def always_wait(algorithm):
    """Change the policy in place, as an update does."""
    with torch.no_grad():
        layer = algorithm.network.head[-1]
        layer.weight.zero_()
        layer.bias.fill_(-50.0).view(-1, 4)[:, 3] = 50.0


def test_a_batch_is_collected_with_the_policy_from_before_the_update():
    algorithm = ALGORITHMS["mappo"](OVERLAP)
    with algorithm.batches(seed=0, updates=3) as batches:
        batch = next(batches)
        before = batch.clone()
        always_wait(algorithm)  # the second batch is being collected
        second, third = (next(batches)["agents", "action"].clone() for _ in range(2))
    assert (batch == before).all()  # the next batches have not replaced it
    assert len(before["agents", "action"].unique()) == len(second.unique()) == 4
    assert not torch.equal(second, before["agents", "action"])
    for step in range(16):  # also the last steps
        assert (second[..., step, :] != 3).any()
    assert (third == 3).all()


@pytest.mark.slow
def test_the_same_seed_gives_the_same_curve(tmp_path):
    first, second = (untimed(train(OVERLAP, tmp_path / name)) for name in ("first", "second"))
    assert first == second
    assert len(first) == 3
    alternating = untimed(train(dataclasses.replace(OVERLAP, overlap=False), tmp_path / "alternating"))
    assert alternating[0] == first[0]  # the first batch is the same
    assert alternating != first


def test_an_interrupted_run_is_resumed(tmp_path):
    def interrupt(row):
        if row["agent_steps"] > 200:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(OVERLAP, tmp_path, interrupt)
    assert len(rows(tmp_path)) == 2
    resume(tmp_path)
    assert len(rows(tmp_path)) == 3


def test_it_needs_workers():
    with pytest.raises(ValueError, match="overlap=True: expected the collector 'processes' or 'ray'"):
        dataclasses.replace(OVERLAP, collector="single")
