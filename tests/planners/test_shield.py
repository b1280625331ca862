import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import mapf_pz
from mapf_pz.instances import RandomObstacles
from mapf_pz.instances.instance import Scenario
from mapf_pz.planners import EPIBT, BatchShield, Shield
from mapf_pz.planners.base import simulator_of
from mapf_pz.planners.pibt.kernels import plan
from mapf_pz.planners.pibt.state import LATE, Options, allocate_pibt
from mapf_pz.simulator import Simulator
from mapf_pz.simulator.actions import Action, CardinalAction
from mapf_pz.simulator.config import EnvConfig
from tests.helpers.episodes import play
from tests.helpers.reference_planners import (
    CardinalWorld,
    SlowCardinalShield,
    SlowRotatingShield,
    SlowTurningShield,
    World,
)
from tests.helpers.text_instances import drawn

MODELS = {"rotate": Action, "cardinal": CardinalAction}


class Preferences:
    """A policy with the preferences that a function returns for each agent."""

    def __init__(self, preferences):
        self.preferences_of = preferences
        self.resets = 0

    def preferences(self, observations):
        return {name: self.preferences_of(name) for name in observations}

    def reset_states(self):
        self.resets += 1


def random_preferences(rng, shape, kind):
    """Return preferences of a kind; those of kind `masked` are -inf for many actions."""
    preferences = np.zeros(shape) if kind == "constant" else rng.random(shape)
    return np.where(rng.random(shape) < 0.6, -np.inf, preferences) if kind == "masked" else preferences


@pytest.mark.parametrize("model", list(MODELS))
@settings(max_examples=20)
@given(
    seed=st.integers(0, 2**31),
    on_target=st.sampled_from(["nothing", "restart", "finish"]),
    weights=st.sampled_from(["uniform", "crisscross", "random"]),
    patience=st.sampled_from([0, 1, 4]),
    kind=st.sampled_from(["random", "constant", "masked"]),
)
def test_no_move_is_blocked(model, seed, on_target, weights, patience, kind):
    env = mapf_pz.parallel_env(
        source=RandomObstacles(6, 6, 0.2, 10),
        action_model=model,
        on_target=on_target,
        edge_weights=weights,
        max_steps=30,
    )
    rng = np.random.default_rng(seed)
    policy = Preferences(lambda name: random_preferences(rng, len(MODELS[model]), kind))
    assert len(list(play(env, Shield(policy, env, patience), seed))) > 0


@pytest.mark.parametrize("model", list(MODELS))
@given(seed=st.integers(0, 2**31))
@settings(max_examples=20)
def test_a_single_agent_takes_its_preferred_action(model, seed):
    env = mapf_pz.parallel_env(map="empty-8-8", num_agents=1, action_model=model, max_steps=20)
    observations, infos = env.reset(seed=seed)
    rng = np.random.default_rng(seed)
    while env.agents:
        preferred = np.where(infos["agent_0"]["action_mask"], rng.random(len(MODELS[model])), -1)
        actions = Shield(Preferences(lambda name, preferred=preferred: preferred), env).act(observations)
        assert actions["agent_0"] == preferred.argmax()
        observations, _, _, _, infos = env.step(actions)


def test_an_agent_in_the_way_moves_away():
    scenario = Scenario([[0, 0], [0, 1]], [[0, 1], [0, 3]])  # the first agent is nearer to its goal and has priority
    env = mapf_pz.parallel_env(map="....\n", scenario=scenario, num_agents=2, action_model="cardinal", view_size=(1, 1))
    observations, _ = env.reset(seed=0)
    preferences = {"agent_0": {"RIGHT": 1}, "agent_1": {"WAIT": 1, "LEFT": 0.5, "RIGHT": 0.2}}
    shield = Shield(Preferences(lambda name: [preferences[name].get(action.name, 0) for action in CardinalAction]), env)
    env.step(shield.act(observations))
    assert env.positions.tolist() == [[0, 1], [0, 2]]


def test_it_resets_its_policy():
    env = mapf_pz.parallel_env(map="empty-8-8", num_agents=2)
    policy = Preferences(lambda name: np.zeros(4))
    Shield(policy, env).reset_states()
    assert policy.resets == 1


@pytest.mark.parametrize(
    ("model", "on_target", "depth"),
    [
        ("cardinal", "nothing", 3),
        ("cardinal", "restart", 3),
        ("rotate", "nothing", 3),
        ("rotate", "restart", 3),
        ("rotate", "restart", 4),
    ],
)
@settings(max_examples=15)
@given(
    seed=st.integers(0, 2**31), num_agents=st.sampled_from([4, 12, 24]), patience=st.integers(0, 4), ties=st.booleans()
)
@example(seed=218, num_agents=24, patience=3, ties=False)  # an agent gets the goal again where it has arrived
def test_it_decides_as_in_plain_python(model, on_target, depth, seed, num_agents, patience, ties):
    env = mapf_pz.parallel_env(
        source=RandomObstacles(8, 8, 0.2, num_agents), on_target=on_target, max_steps=30, action_model=model
    )
    env.reset(seed=seed)
    rng, shield = np.random.default_rng(seed), BatchShield(env.simulator, patience, depth)
    if model == "cardinal":
        slow = SlowCardinalShield(CardinalWorld(env.grid), patience, stays=on_target == "nothing")
    elif on_target == "nothing":
        slow = SlowTurningShield(World(env.grid), patience, stays=True)
    else:
        slow = SlowRotatingShield(World(env.grid), patience, depth)
    shape = num_agents, len(MODELS[model])
    while env.agents:
        preferences = rng.integers(2, size=shape) if ties else rng.random(shape)
        headings = env.headings.tolist() if model == "rotate" else [0] * num_agents
        states = [(*cell, heading) for cell, heading in zip(env.positions.tolist(), headings, strict=True)]
        expected = slow.actions(preferences, states, list(map(tuple, env.goals.tolist())))
        actions = shield.actions(preferences[None])[0].tolist()
        assert actions == expected
        env.step(dict(zip(env.agents, actions, strict=True)))


@pytest.mark.parametrize("on_target", ["restart", "finish"])
@pytest.mark.parametrize("depth", [3, 4])
def test_turning_agents_with_equal_preferences_follow_epibt(on_target, depth):
    env = mapf_pz.parallel_env(source=RandomObstacles(8, 8, 0.2, 14), on_target=on_target, max_steps=30)
    env.reset(seed=0)
    shield, epibt = BatchShield(env.simulator, depth=depth), EPIBT(env, depth=depth)
    while env.agents:
        expected = epibt.decide(env.simulator)
        np.testing.assert_array_equal(shield.actions(np.zeros((1, 14, 4)))[0], expected)
        env.step(dict(zip(env.possible_agents, expected.tolist(), strict=True)))


@pytest.mark.parametrize("on_target", ["nothing", "restart", "finish"])
def test_equal_preferences_are_those_of_pibt(on_target):
    config = EnvConfig(source=RandomObstacles(8, 8, 0.3, 14), on_target=on_target, action_model="cardinal")
    simulator = Simulator(config)
    simulator.reset(seeds={0: 0})
    shield, pibt = BatchShield(simulator), allocate_pibt(14, 64, seed=1)
    options, expected = Options(LATE, swap=True, hindrance=True), np.zeros((1, 14), np.int64)
    for _ in range(30):
        plan(simulator.planning_view(), on_target != "nothing", options, pibt, expected[0])
        preferences = np.zeros((1, 14, simulator.num_actions))
        np.testing.assert_array_equal(shield.actions(preferences), expected)
        simulator.step(expected)


def solves(text, headings, insisted, patience, max_steps=40):
    """Return whether agents that insist on one action each are all at their goals at the same time."""
    simulator = simulator_of(drawn(text, headings), max_steps, "uniform", 0)
    shield, names = BatchShield(simulator, patience), CardinalAction if headings is None else Action
    preferences = np.zeros((1, simulator.num_agents, simulator.num_actions))
    for i, name in enumerate(insisted):
        preferences[0, i, [names[name], names.WAIT]] = 2, 1
    while not simulator.over[0]:
        simulator.step(shield.actions(preferences))
    return bool(simulator.terminated[0])


@pytest.mark.parametrize(
    ("text", "headings", "insisted"),
    [
        ("Ba..bA ##.###", None, ("RIGHT", "LEFT")),
        ("aB.bA ##.##", None, ("RIGHT", "LEFT")),
        ("a.A #.# #B# #b#", None, ("WAIT", "DOWN")),
        ("aB.bA .....", [0, 2], ("FORWARD", "FORWARD")),
        ("a.A #.# #B# #b#", [0, 1], ("WAIT", "FORWARD")),
    ],
)
def test_agents_without_progress_ignore_their_preferences(text, headings, insisted):
    assert not solves(text, headings, insisted, patience=0)
    assert solves(text, headings, insisted, patience=2)
    assert solves(text, headings, insisted, patience=4)


@pytest.mark.parametrize("model", list(MODELS))
def test_a_batch_is_many_single_environments(model):
    config = EnvConfig(
        source=RandomObstacles(8, 8, 0.2, 14), action_model=model, on_target="restart", max_steps=20, view_size=(1, 1)
    )
    batch, rng = Simulator(config, 3), np.random.default_rng(0)
    batch.reset(seeds={0: 5, 1: 6, 2: 7})
    singles = [Simulator(config) for _ in range(3)]
    for b, single in enumerate(singles):
        single.reset(seeds={0: 5 + b})
    shield, shields = BatchShield(batch), [BatchShield(single) for single in singles]
    for step in range(40):
        preferences = rng.random((3, 14, batch.num_actions)).astype(np.float32)
        actions = shield.actions(preferences)
        assert (actions.dtype, actions.shape) == (np.int64, (3, 14))
        for b, single in enumerate(singles):
            np.testing.assert_array_equal(shields[b].actions(preferences[b : b + 1])[0], actions[b])
            single.step(actions[b : b + 1])
        batch.step(actions)
        if step == 11:  # environment 1 starts over, alone
            batch.reset([1], {1: 9})
            shield.reset([1])
            singles[1].reset(seeds={0: 9})
            shields[1] = BatchShield(singles[1])


@pytest.mark.parametrize("model", list(MODELS))
def test_after_a_reset_it_decides_the_same_again(model):
    simulator = Simulator(EnvConfig(source=RandomObstacles(8, 8, 0.2, 20), action_model=model, view_size=(1, 1)))
    shape = 30, 1, simulator.num_agents, simulator.num_actions
    shield, preferences = BatchShield(simulator), np.random.default_rng(0).random(shape)
    runs = []
    for _ in range(2):
        simulator.reset(seeds={0: 0})
        shield.reset()
        runs.append([])
        for preferred in preferences:
            runs[-1].append(shield.actions(preferred))
            simulator.step(runs[-1][-1])
    np.testing.assert_array_equal(*runs)


@pytest.mark.parametrize("depth", [2, 9, 3.5])
def test_a_wrong_depth(depth):
    with pytest.raises(ValueError, match=f"^depth={depth}: expected a number of actions from 3 to 8$"):
        BatchShield(simulator_of(drawn("aA"), 40, "uniform", 0), depth=depth)


@pytest.mark.parametrize("patience", [-1, 0.5])
def test_a_wrong_patience(patience):
    env = mapf_pz.parallel_env(map="empty-8-8", num_agents=2)
    with pytest.raises(ValueError, match=f"^patience={patience}: expected a whole number, 0 or more$"):
        Shield(Preferences(lambda name: np.zeros(4)), env, patience)


def test_wrong_preferences():
    shield = BatchShield(simulator_of(drawn("aA"), 40, "uniform", 0))
    with pytest.raises(ValueError, match=r"^preferences: expected the shape \(1, 1, 5\), got \(1, 5\)$"):
        shield.actions(np.zeros((1, 5)))
    with pytest.raises(ValueError, match=r"^preferences contain NaN$"):
        shield.actions(np.full((1, 1, 5), np.nan))


@pytest.mark.parametrize("patience", [0, 3])
def test_an_agent_moves_while_it_ignores_its_preference_to_wait(patience):
    env = mapf_pz.parallel_env(map="empty-16-16", num_agents=1, action_model="cardinal", max_steps=30)
    observations, _ = env.reset(options={"instance": Scenario([[0, 0]], [[15, 15]])})
    shield = Shield(Preferences(lambda _: np.eye(5)[CardinalAction.WAIT]), env, patience)
    shield.reset_states()
    ignored = []
    while env.agents:
        actions = shield.act(observations)
        ignored.append(bool(shield.ignores_preferences[0]))
        assert ignored[-1] == (actions["agent_0"] != CardinalAction.WAIT)
        observations, *_ = env.step(actions)
    assert ignored[:8] == ([False] * 8 if patience == 0 else [False] * 3 + [True] * 3 + [False] * 2)
