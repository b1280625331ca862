"""Data augmentation: turned and mirrored, an episode is an episode of the turned and mirrored instance."""

import dataclasses
import re

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from mapf_pz import Channel, Feature
from mapf_pz.guidance import GuidanceGraph
from mapf_pz.instances import RandomObstacles
from mapf_pz.instances.instance import Grid, Instance, Scenario
from mapf_pz.rl import load_policy
from mapf_pz.rl.algorithms.expert import NO_LABEL
from mapf_pz.rl.algorithms.symmetries import Symmetries
from mapf_pz.rl.training.train import train
from mapf_pz.simulator import Simulator
from mapf_pz.simulator.actions import CardinalAction
from mapf_pz.simulator.config import EnvConfig
from mapf_pz.simulator.kernels.observation.channels import CHANNELS
from mapf_pz.simulator.kernels.observation.features import FEATURES
from mapf_pz.simulator.observation import ObservationLayout
from tests.helpers.small_run import changed
from tests.rl.test_imitation import DAGGER, batch_of, imitating, learner_of

SHAPE, NUM_AGENTS, NUM_STEPS = (5, 6), 6, 8
CONFIG = EnvConfig(
    source=RandomObstacles(*SHAPE, 0.2, NUM_AGENTS, goals_per_agent=2),
    max_steps=NUM_STEPS,
    view_size=(5, 5),
    channels=tuple(CHANNELS),
    features=tuple(FEATURES),
    num_last_actions=2,
    num_neighbors=1,
    neighbor_radius=2,
)
AGENTS = {
    "cardinal": {"action_model": "cardinal"},
    "front": {"view": "front"},
    "centered": {"view": "centered"},
    "map": {"view": "centered", "frame": "map"},
}
WITHOUT_ORIENTATION = dataclasses.replace(
    DAGGER, task=changed(DAGGER.task, channels=("view", "heuristic"), features=("action_advantage",))
)


def transformed(cells, mirrored, quarters):
    """The cells (..., 2) of a map, mirrored and then turned to the left."""
    rows, cols, (height, width) = cells[..., 0], cells[..., 1], SHAPE
    if mirrored:
        cols = width - 1 - cols
    for _ in range(quarters):
        rows, cols, height, width = width - 1 - cols, rows, width, height
    return np.stack([rows, cols], -1)


def transformed_headings(headings, mirrored, quarters):
    return ((2 - headings if mirrored else headings) - quarters) % 4


def transformed_planes(planes, mirrored, quarters):
    """Numbers of the cells (..., H, W) of a map."""
    return np.rot90(planes[..., ::-1] if mirrored else planes, quarters, axes=(-2, -1))


def transformed_instance(instance, mirrored, quarters):
    free = transformed_planes(instance.grid.free, mirrored, quarters)
    cells = (transformed(part, mirrored, quarters) for part in (instance.scenario.starts, instance.scenario.goals))
    return Instance(Grid(free), Scenario(*cells), transformed_headings(instance.headings, mirrored, quarters))


def transformed_config(config, mirrored, quarters):
    """The configuration of the environment of transformed instances, with the transformed edge weights."""
    shape = SHAPE if quarters % 2 == 0 else SHAPE[::-1]
    weights = config.edge_weights
    if weights != "uniform":
        move = np.empty((4, *shape))
        for heading, plane in enumerate(weights.move):
            becomes = transformed_headings(heading, mirrored, quarters)
            move[becomes] = transformed_planes(plane, mirrored, quarters)
        weights = GuidanceGraph(move, transformed_planes(weights.wait, mirrored, quarters))
    return dataclasses.replace(config, source=RandomObstacles(*shape, 0.2, NUM_AGENTS), edge_weights=weights)


def drawn(config, rng, weighted):
    """An instance, and the configuration with random edge weights, or without `others_next`, which shows one path."""
    instance = config.source.sample(rng)
    instance = Instance(instance.grid, instance.scenario, rng.integers(4, size=NUM_AGENTS))
    if weighted:  # no two paths cost the same
        return instance, dataclasses.replace(config, edge_weights=GuidanceGraph.random(instance.grid.free, rng))
    channels = tuple(name for name in config.channels if name != "others_next")
    return instance, dataclasses.replace(config, channels=channels)


def compare(config, seen, expected):
    """Compare observations, channel by channel and feature by feature."""
    layout = ObservationLayout(config)
    images = [
        image.reshape(-1, layout.num_own_planes, *config.view_size) for image in (seen[0].numpy(), expected.image)
    ]
    for plane, name in enumerate(layout.plane_names):
        assert np.array_equal(images[0][:, plane], images[1][:, plane]), name
    features = [part.reshape(-1, layout.num_own_features) for part in (seen[1].numpy(), expected.features)]
    for k, name in enumerate(layout.feature_names):
        one, other = features[0][:, k], features[1][:, k]
        # The matrix of a location adds two rounded numbers.
        assert np.abs(one - other).max() <= (1e-6 if name.startswith("location") else 0), name


@pytest.mark.parametrize("agents", AGENTS)
@settings(max_examples=50)
@given(
    seed=st.integers(0, 2**32 - 1),
    number=st.integers(0, 7),
    weighted=st.booleans(),
    view_size=st.sampled_from([(5, 5), (3, 3), (5, 3), (4, 5)]),
    num_frames=st.sampled_from([1, 2]),
    on_target=st.sampled_from(["nothing", "finish", "restart"]),
    see_through_walls=st.booleans(),
)
def test_a_transformed_instance_is_observed_as_the_symmetry_says(agents, seed, number, weighted, view_size, **keywords):
    mirrored, quarters = divmod(number, 4)
    rng = np.random.default_rng(seed)
    if agents in ("cardinal", "map"):  # all eight
        view_size = (view_size[1], view_size[1])
    config = dataclasses.replace(CONFIG, view_size=view_size, **AGENTS[agents], **keywords)
    instance, config = drawn(config, rng, weighted)
    symmetries, which = Symmetries.of_env(config, SHAPE), torch.tensor([number])
    assert symmetries.number == 8
    one, other = Simulator(config), Simulator(transformed_config(config, mirrored, quarters))
    one.reset(instances={0: instance})
    other.reset(instances={0: transformed_instance(instance, mirrored, quarters)})
    while not one.over[0]:
        seen, expected = one.observe(), other.observe()
        transformed_seen = symmetries.transform(which, torch.tensor(seen.image), torch.tensor(seen.features))
        compare(config, transformed_seen, expected)
        actions = torch.from_numpy(rng.integers(one.num_actions, size=(1, NUM_AGENTS)))
        one.step(actions.numpy())
        other.step(symmetries.transform_actions(which, actions).numpy())
        assert np.array_equal(other.positions(0), transformed(one.positions(0), mirrored, quarters))
        assert np.array_equal(other.over, one.over)


def test_what_has_no_label_has_none_afterwards():
    labels = torch.tensor([[NO_LABEL, CardinalAction.WAIT], [CardinalAction.WAIT, NO_LABEL]])
    assert torch.equal(Symmetries.of_env(CONFIG, SHAPE).transform_actions(torch.tensor([3, 6]), labels), labels)


CARDINAL, TURNING = [1, 2, 3, 4], [1, 2]  # actions that turned or mirrored states exchange: not to wait, not forward


@pytest.mark.parametrize("augment", [False, True])
@pytest.mark.parametrize(("action_model", "exchanged"), [("cardinal", CARDINAL), ("rotate", TURNING)])
def test_the_policy_learns_what_to_do_in_turned_states(action_model, exchanged, augment):
    optimization = dataclasses.replace(DAGGER.optimization, learning_rate=5e-3)
    task = changed(WITHOUT_ORIENTATION.task, action_model=action_model)
    config = dataclasses.replace(WITHOUT_ORIENTATION, task=task, optimization=optimization)
    torch.manual_seed(0)
    algorithm, learner = learner_of(imitating(config, augment=augment))
    image = torch.zeros(64, 3, *algorithm.observation_shape.image)
    best = torch.eye(algorithm.observation_shape.actions) - 1
    first = exchanged[0]
    batch = batch_of(
        torch.full((64, 3), first), torch.zeros(64, 3, dtype=torch.bool), best[first].expand(64, 3, len(best))
    )
    batch["agents", "observation", "image"] = image
    for _ in range(60):
        learner.learn(batch, 0)
    (logits,) = algorithm.network(image[: len(exchanged), 0], best[exchanged])
    learned = logits.argmax(-1)
    assert learned.tolist() == (exchanged if augment else [first] * len(exchanged))


TEAM = dataclasses.replace(
    DAGGER,
    task=changed(DAGGER.task, action_model="rotate", channels=tuple(CHANNELS), features=tuple(FEATURES)),
    model=dataclasses.replace(DAGGER.model, communication=1, hidden=32),
)


@pytest.mark.parametrize("config", [WITHOUT_ORIENTATION, TEAM], ids=["cardinal", "team"])
@pytest.mark.parametrize("precision", ["float32", "float16"])
def test_a_run_is_the_same_again(tmp_path, config, precision):
    config = dataclasses.replace(config, agent_steps=192, observation_precision=precision)
    config = imitating(config, augment=True)
    one, other = (load_policy(train(config, tmp_path / name)).network.state_dict() for name in ("one", "other"))
    assert all(torch.equal(one[name], other[name]) for name in one)


def draw_nothing(inputs, image, plane):
    image[:, :, plane] = 0


def write_nothing(inputs, values, at):
    values[..., at] = 0


def of_env(**keywords):
    return Symmetries.of_env(dataclasses.replace(CONFIG, **keywords), SHAPE)


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"view_size": (5, 4)}, "expected a view_size with an odd width, got (5, 4)"),
        (
            {"view_size": (4, 6), "view": "centered", "frame": "map"},
            "expected a view_size with an odd width, got (4, 6)",
        ),
        (
            {"channels": ("view", Channel(draw_nothing))},
            "expected channels and features that state their symmetry, got ",
        ),
        (
            {"features": ("time", Feature(write_nothing))},
            "expected channels and features that state their symmetry, got ",
        ),
        ({"features": (Feature(write_nothing, 2, symmetry=lambda *_: np.eye(3)),)}, "expected a matrix (2, 2) of "),
    ],
)
def test_observations_that_cannot_be_transformed_are_refused(keywords, message):
    with pytest.raises(ValueError, match=f"augment: {re.escape(message)}"):
        of_env(**keywords)


def test_views_that_are_not_squares_are_transformed_as_far_as_they_keep_their_shape():
    centered = {"view": "centered", "frame": "map"}
    assert of_env(view_size=(5, 3), **centered).number == 4  # half a turn, and mirrored
    assert of_env(view_size=(4, 3), **centered).number == 2  # mirrored left-right
    assert of_env(view_size=(4, 4), **centered).number == 2  # mirrored in the diagonal through the agent
    assert of_env(view_size=(4, 3), view="front").number == 8  # its view never turns


def draw_degrees(inputs, image, plane):
    """How many ways lead on from each cell."""
    leads_on = inputs.world.leads_to[inputs.state.map] != np.arange(inputs.world.leads_to.shape[-1])
    degrees = leads_on.sum(axis=1) / 4
    b = np.arange(len(degrees))[:, None, None]
    image[:, :, plane] = degrees[b, inputs.cells].reshape(image[:, :, plane].shape)


def write_sides(inputs, values, at):
    """Whether the agent can leave its cell to its left, and to its right."""
    b, cells = inputs.state.map[:, None], inputs.state.agents["cell"]
    for k, turn in enumerate((3, 1)):
        values[..., at + k] = inputs.world.leads_to[b, (inputs.headings + turn) % 4, cells] != cells


def sides_symmetry(symmetry, size):
    left_and_right = symmetry.directions[[3, 1]]  # of up, right, down, left
    return np.eye(2) if left_and_right[0] == 3 else np.eye(2)[::-1]


def test_channels_and_features_of_users_state_their_symmetry():
    parts = {"channels": (Channel(draw_degrees, symmetry="cells"),)}
    parts["features"] = (Feature(write_sides, 2, symmetry=sides_symmetry),)
    config = dataclasses.replace(CONFIG, **parts)
    instance, _ = drawn(config, np.random.default_rng(0), weighted=False)
    symmetries = Symmetries.of_env(config, SHAPE)
    one = Simulator(config)
    one.reset(instances={0: instance})
    seen = one.observe()
    for number in range(8):
        other = Simulator(transformed_config(config, *divmod(number, 4)))
        other.reset(instances={0: transformed_instance(instance, *divmod(number, 4))})
        which = torch.tensor([number])
        compare(config, symmetries.transform(which, *map(torch.tensor, seen[:2])), other.observe())


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"symmetry": "planes"}, "symmetry='planes': expected one of 'cells', 'directions', 'headings'"),
        ({"symmetry": "directions", "planes": 2}, "symmetry='directions': expected planes=4, got 2"),
        ({"symmetry": "headings", "low": -1}, "symmetry='headings': expected bounds from 0 to 1, got -1 and 1"),
    ],
)
def test_a_channel_has_a_symmetry_that_fits(keywords, message):
    with pytest.raises(ValueError, match=message):
        Channel(draw_nothing, **keywords)
