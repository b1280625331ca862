"""How fast small tasks are learned. An update that is right step by step can still be one of other settings."""

import dataclasses

import numpy as np
import pytest

from tests.rl.learning_curves import TASKS, measure

pytestmark = pytest.mark.usefixtures("forked_processes")

# The mean and the standard deviation of the return of a run's episodes that start in updates 2 to 4, and of its entropy
# in the last update, as
# recorded by `python -m tests.rl.learning_curves`. Half the learning rate or no entropy bonus leave at least one band.
RECORDED = {
    "mappo": ((0.348, 0.023), (1.243, 0.041)),
    "recurrent-ippo": ((0.308, 0.049), (1.264, 0.027)),
    "central-ppo": ((0.140, 0.030), (6.733, 0.066)),
}


@pytest.mark.slow
@pytest.mark.parametrize(("name", "num_learners"), [*((name, 1) for name in TASKS), ("mappo", 2)])
def test_three_runs_learn_as_fast_as_recorded(name, num_learners):
    config = dataclasses.replace(TASKS[name], num_learners=num_learners)
    means = np.mean([measure(config, seed) for seed in range(3)], axis=0)
    for found, (mean, deviation) in zip(means, RECORDED[name], strict=True):
        assert found == pytest.approx(mean, abs=3 * deviation / np.sqrt(3))
