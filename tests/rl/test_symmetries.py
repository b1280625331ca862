"""Data augmentation: turned and mirrored, an episode is an episode of the turned and mirrored instance."""

import dataclasses

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from mapf_pz.instances import RandomObstacles
from mapf_pz.instances.instance import Grid, Instance, Scenario
from mapf_pz.rl import load_policy
from mapf_pz.rl.algorithms.expert import NO_LABEL
from mapf_pz.rl.algorithms.symmetries import Symmetries
from mapf_pz.rl.training.train import train
from mapf_pz.simulator import Simulator
from mapf_pz.simulator.actions import CardinalAction
from mapf_pz.simulator.config import EnvConfig
from tests.helpers.small_run import changed
from tests.rl.test_imitation import DAGGER, batch_of, imitating, learner_of

SIDE, NUM_AGENTS, NUM_STEPS = 6, 5, 8
CONFIG = EnvConfig(
    source=RandomObstacles(SIDE, SIDE, 0.2, NUM_AGENTS),
    action_model="cardinal",
    max_steps=NUM_STEPS,
    view="centered",
    view_size=(5, 5),
    # Not `others_next`, which prefers one of equal paths by its direction.
    channels=(
        "heuristic",
        "view",
        "goal",
        "edge_weights",
        "cost_to_go",
        "other_goals",
        "others_heuristic",
        "others_at_goal",
    ),
    features=("time", "goal_vector", "action_advantage", "last_actions", "pose"),
    num_last_actions=2,
)
WITHOUT_ORIENTATION = dataclasses.replace(
    DAGGER, task=changed(DAGGER.task, channels=("view", "heuristic"), features=("action_advantage",))
)


def transformed(cells, mirrored, quarters):
    """The cells (N, 2) of a square map, mirrored and then turned to the left."""
    rows, cols = cells.T
    if mirrored:
        cols = SIDE - 1 - cols
    for _ in range(quarters):
        rows, cols = SIDE - 1 - cols, rows
    return np.stack([rows, cols], 1)


def transformed_instance(instance, mirrored, quarters):
    free = instance.grid.free[:, ::-1] if mirrored else instance.grid.free
    cells = (transformed(part, mirrored, quarters) for part in (instance.scenario.starts, instance.scenario.goals))
    return Instance(Grid(np.rot90(free, quarters)), Scenario(*cells), instance.headings)


@pytest.mark.parametrize("number", range(8))
@settings(max_examples=10)
@given(seed=st.integers(0, 2**32 - 1), num_frames=st.sampled_from([1, 2]))
def test_a_transformed_instance_is_observed_as_the_symmetry_says(number, seed, num_frames):
    config = dataclasses.replace(CONFIG, num_frames=num_frames)
    symmetries, which = Symmetries.of_env(config), torch.tensor([number])
    mirrored, quarters = divmod(number, 4)
    rng = np.random.default_rng(seed)
    instance = config.source.sample(rng)
    instance = Instance(instance.grid, instance.scenario, np.zeros(NUM_AGENTS, int))
    one, other = Simulator(config), Simulator(config)
    one.reset(instances={0: instance})
    other.reset(instances={0: transformed_instance(instance, mirrored, quarters)})
    while not one.over[0]:
        actions = torch.from_numpy(rng.integers(len(CardinalAction), size=(1, NUM_AGENTS)))
        one.step(actions.numpy())
        other.step(symmetries.transform_actions(which, actions).numpy())
        assert np.array_equal(other.positions(0), transformed(one.positions(0), mirrored, quarters))
        assert np.array_equal(other.over, one.over)
        seen, expected = one.observe(), other.observe()
        image, features = symmetries.transform(which, torch.tensor(seen.image), torch.tensor(seen.features))
        assert np.array_equal(image, expected.image)
        difference = (features - torch.tensor(expected.features))[0].unflatten(-1, (num_frames, -1))
        difference[..., -6:-4] -= difference[:1, :, -6:-4].clone()  # positions are relative
        assert difference.abs().max() < 1e-6


def test_what_has_no_label_has_none_afterwards():
    labels = torch.tensor([[NO_LABEL, CardinalAction.WAIT], [CardinalAction.WAIT, NO_LABEL]])
    assert torch.equal(Symmetries.of_env(CONFIG).transform_actions(torch.tensor([3, 6]), labels), labels)


@pytest.mark.parametrize("augment", [False, True])
def test_the_policy_learns_what_to_do_in_turned_states(augment):
    optimization = dataclasses.replace(DAGGER.optimization, learning_rate=5e-3)
    config = dataclasses.replace(WITHOUT_ORIENTATION, optimization=optimization)
    torch.manual_seed(0)
    algorithm, learner = learner_of(imitating(config, augment=augment))
    image = torch.zeros(64, 3, *algorithm.observation_shape.image)
    up_is_best = torch.tensor([-1.0, 0, -1, -1, -1]).expand(64, 3, 5)
    batch = batch_of(torch.full((64, 3), CardinalAction.UP), torch.zeros(64, 3, dtype=torch.bool), up_is_best)
    batch["agents", "observation", "image"] = image
    for _ in range(60):
        learner.learn(batch, 0)
    each_is_best = torch.eye(5)[1:] - 1  # up, down, left, right
    (logits,) = algorithm.network(image[:4, 0], each_is_best)
    learned = logits.argmax(-1)
    assert learned.tolist() == ([1, 2, 3, 4] if augment else [1, 1, 1, 1])


@pytest.mark.parametrize("precision", ["float32", "float16"])
def test_a_run_is_the_same_again(tmp_path, precision):
    config = dataclasses.replace(WITHOUT_ORIENTATION, agent_steps=192, observation_precision=precision)
    config = imitating(config, augment=True)
    one, other = (load_policy(train(config, tmp_path / name)).network.state_dict() for name in ("one", "other"))
    assert all(torch.equal(one[name], other[name]) for name in one)


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"action_model": "rotate"}, "expected action_model='cardinal' and a square view with an odd side"),
        ({"view_size": (5, 7)}, "expected action_model='cardinal' and a square view"),
        ({"view_size": (4, 4)}, "expected action_model='cardinal' and a square view"),
        ({"channels": ("view", "orientation")}, "expected channels and features among view, .*; got 'orientation'"),
        ({"features": ("location",)}, "expected .*; got 'location'"),
    ],
)
def test_observations_that_cannot_be_transformed_are_refused(keywords, message):
    with pytest.raises(ValueError, match=f"augment: {message}"):
        Symmetries.of_env(dataclasses.replace(CONFIG, **keywords))
