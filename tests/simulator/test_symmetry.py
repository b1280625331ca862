"""What must not matter: where north and left are, and, where the collision rule has no index in it, who is who."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapf_pz.instances import RandomObstacles
from mapf_pz.instances.instance import Grid, Instance, Scenario
from mapf_pz.simulator import Simulator
from mapf_pz.simulator.actions import Action, CardinalAction
from mapf_pz.simulator.config import EnvConfig
from mapf_pz.simulator.observation import ObservationLayout

NUM_STEPS = 15
EVERY_CHANNEL = ("view", "goal", "orientation", "edge_weights", "cost_to_go", "heuristic", "other_goals")
NO_TIES = ("others_heuristic", "others_at_goal")  # `others_next` prefers one of equal paths by its direction
SEEDS = st.integers(0, 2**32 - 1)
# A cardinal action, and what it is once the map is turned a quarter to the left, or mirrored.
TURNED = {"UP": "LEFT", "LEFT": "DOWN", "DOWN": "RIGHT", "RIGHT": "UP", "WAIT": "WAIT"}
MIRRORED = {"UP": "UP", "LEFT": "RIGHT", "DOWN": "DOWN", "RIGHT": "LEFT", "WAIT": "WAIT"}
TURNED_ACTIONS = np.array([CardinalAction[TURNED[action.name]] for action in CardinalAction])
MIRRORED_ACTIONS = np.array([CardinalAction[MIRRORED[action.name]] for action in CardinalAction])
LEFT_IS_RIGHT = np.array([Action.FORWARD, Action.ROTATE_RIGHT, Action.ROTATE_LEFT, Action.WAIT])


def config_of(grid_shape, num_agents, action_model, **keywords):
    cardinal = action_model == "cardinal"
    return EnvConfig(
        source=RandomObstacles(*grid_shape, 0.2, num_agents),
        action_model=action_model,
        max_steps=NUM_STEPS,
        view_size=(3, 3),
        view="centered",
        channels=EVERY_CHANNEL + NO_TIES,
        features=() if cardinal else ("goal_vector", "action_advantage", "last_actions", "time"),
        reward="progress",
        **keywords,
    )


def drawn_instance(config, seed):
    rng = np.random.default_rng(seed)
    instance = config.source.sample(rng)
    return Instance(instance.grid, instance.scenario, rng.integers(4, size=instance.num_agents))


def turned_instance(instance):
    """The instance, turned a quarter to the left."""
    width = instance.grid.shape[1]

    def turned(places):
        return np.stack([width - 1 - places[:, 1], places[:, 0]], axis=1)

    scenario = Scenario(turned(instance.scenario.starts), turned(instance.scenario.goals))
    return Instance(Grid(np.rot90(instance.grid.free)), scenario, (instance.headings + 3) % 4)


def mirrored_instance(instance):
    """The instance, in which west is east and east is west."""
    width = instance.grid.shape[1]

    def mirrored(places):
        return np.stack([places[:, 0], width - 1 - places[:, 1]], axis=1)

    scenario = Scenario(mirrored(instance.scenario.starts), mirrored(instance.scenario.goals))
    return Instance(Grid(instance.grid.free[:, ::-1]), scenario, (2 - instance.headings) % 4)


episodes_of_all_rules = given(
    seed=SEEDS,
    collision_system=st.sampled_from(["soft", "priority", "block_both"]),
    on_target=st.sampled_from(["nothing", "finish"]),
)


def played(config, instance, actions):
    """Observations, rewards, ends and positions at each step."""
    simulator = Simulator(config)
    simulator.reset(instances={0: instance})
    agents = simulator.agents[0]
    trace = [(simulator.observe(), np.zeros(len(agents)), simulator.positions(0))]
    for row in actions:
        simulator.step(row[None])
        trace.append((simulator.observe(), agents["reward"].copy(), simulator.positions(0)))
    return trace, simulator.metrics(0), (agents["terminated"].copy(), agents["truncated"].copy())


@pytest.mark.parametrize("action_model", ["rotate", "cardinal"])
@settings(max_examples=25)
@episodes_of_all_rules
def test_a_turned_instance_gives_the_turned_episode(action_model, seed, collision_system, on_target):
    rules = {"collision_system": collision_system, "on_target": on_target}
    config = config_of((5, 6), 6, action_model, **rules)
    instance = drawn_instance(config, seed)
    num_actions = 5 if action_model == "cardinal" else 4
    actions = np.random.default_rng(seed).integers(num_actions, size=(NUM_STEPS, 6))
    turned_actions = TURNED_ACTIONS[actions] if action_model == "cardinal" else actions
    one, metrics, ends = played(config, instance, actions)
    other, turned_metrics, turned_ends = played(
        config_of((6, 5), 6, action_model, **rules), turned_instance(instance), turned_actions
    )
    assert turned_metrics == metrics
    assert np.array_equal(turned_ends, ends)
    for (seen, rewards, places), (turned_seen, turned_rewards, turned_places) in zip(one, other, strict=True):
        assert np.array_equal(turned_places, np.stack([5 - places[:, 1], places[:, 0]], axis=1))
        assert turned_rewards == pytest.approx(rewards)
        if action_model == "rotate":  # egocentric: they see just the same
            assert np.array_equal(turned_seen.image, seen.image)
            assert turned_seen.features == pytest.approx(seen.features)
        else:
            for plane in (EVERY_CHANNEL.index("view"), EVERY_CHANNEL.index("goal")):
                assert np.array_equal(turned_seen.image[:, :, plane], np.rot90(seen.image[:, :, plane], axes=(2, 3)))


@pytest.mark.parametrize("action_model", ["rotate", "cardinal"])
@settings(max_examples=25)
@episodes_of_all_rules
def test_a_mirrored_instance_gives_the_mirrored_episode(action_model, seed, collision_system, on_target):
    config = config_of((5, 6), 6, action_model, collision_system=collision_system, on_target=on_target)
    instance = drawn_instance(config, seed)
    mirrored_actions = MIRRORED_ACTIONS if action_model == "cardinal" else LEFT_IS_RIGHT
    actions = np.random.default_rng(seed).integers(len(mirrored_actions), size=(NUM_STEPS, 6))
    one, metrics, ends = played(config, instance, actions)
    other, other_metrics, other_ends = played(config, mirrored_instance(instance), mirrored_actions[actions])
    assert other_metrics == metrics
    assert np.array_equal(other_ends, ends)
    for (seen, rewards, places), (other_seen, other_rewards, other_places) in zip(one, other, strict=True):
        assert np.array_equal(other_places, np.stack([places[:, 0], 5 - places[:, 1]], axis=1))
        assert other_rewards == pytest.approx(rewards)
        for name in ("view", "goal", "cost_to_go", "other_goals"):
            plane = ObservationLayout(config).plane_names.index(name)
            assert np.array_equal(other_seen.image[:, :, plane], seen.image[:, :, plane, :, ::-1])


@pytest.mark.parametrize("action_model", ["rotate", "cardinal"])
@settings(max_examples=25)
@given(seed=SEEDS, on_target=st.sampled_from(["nothing", "finish"]))
def test_rules_without_an_index_do_not_depend_on_the_order(action_model, seed, on_target):
    config = config_of((5, 6), 6, action_model, collision_system="block_both", on_target=on_target)
    instance = drawn_instance(config, seed)
    rng = np.random.default_rng(seed)
    order = rng.permutation(6)
    actions = rng.integers(5 if action_model == "cardinal" else 4, size=(NUM_STEPS, 6))
    scenario = Scenario(instance.scenario.starts[order], instance.scenario.goals[order])
    one, metrics, ends = played(config, instance, actions)
    shuffled = Instance(instance.grid, scenario, instance.headings[order])
    other, other_metrics, other_ends = played(config, shuffled, actions[:, order])
    assert other_metrics == metrics
    assert np.array_equal(other_ends, np.array(ends)[:, order])
    for (seen, rewards, places), (other_seen, other_rewards, other_places) in zip(one, other, strict=True):
        assert np.array_equal(other_places, places[order])
        assert other_rewards == pytest.approx(rewards[order])
        assert np.array_equal(other_seen.image[0], seen.image[0, order])
        assert np.array_equal(other_seen.features[0], seen.features[0, order])
