import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mapf_pz
from mapf_pz.instances import RandomObstacles
from mapf_pz.planners import EPIBT, validate
from tests.helpers.episodes import play
from tests.helpers.reference_planners import SlowEPIBT, World, assert_same_decisions
from tests.helpers.text_instances import drawn


@pytest.mark.parametrize("depth", [1, 2, 3, 4])
@settings(max_examples=15)
@given(seed=st.integers(0, 2**31), num_agents=st.sampled_from([4, 12, 24]))
def test_it_decides_as_in_plain_python(depth, seed, num_agents):
    env = mapf_pz.parallel_env(source=RandomObstacles(8, 8, 0.2, num_agents), on_target="restart", max_steps=30)
    observations, _ = env.reset(seed=seed)
    planner, slow = EPIBT(env, depth=depth), SlowEPIBT(World(env.grid), depth)
    assert_same_decisions(env, observations, planner, slow)


@pytest.mark.parametrize("model", ["cardinal", "rotate"])
@pytest.mark.parametrize("weights", ["uniform", "random", "crisscross"])
@settings(max_examples=10)
@given(
    seed=st.integers(0, 2**31),
    on_target=st.sampled_from(["nothing", "restart", "finish"]),
    depth=st.integers(1, 4),
    time_limit=st.sampled_from([0.0, 0.002]),
)
def test_no_move_is_blocked(model, weights, seed, on_target, depth, time_limit):
    env = mapf_pz.parallel_env(
        source=RandomObstacles(8, 8, 0.2, 14),
        action_model=model,
        edge_weights=weights,
        on_target=on_target,
        max_steps=40,
    )
    assert len(list(play(env, EPIBT(env, seed, depth, time_limit), seed))) > 0


@pytest.mark.parametrize("model", ["cardinal", "rotate"])
@settings(max_examples=15)
@given(seed=st.integers(0, 2**31), depth=st.integers(3, 5))
def test_an_agent_that_is_alone_takes_a_cheap_way(model, seed, depth):
    """It never prefers a wait where waits are cheap to a move to a cell where they are dearer."""
    env = mapf_pz.parallel_env(
        source=RandomObstacles(8, 8, 0.2, 1), action_model=model, edge_weights="random", max_steps=80
    )
    assert len(list(play(env, EPIBT(env, seed, depth), seed))) > 0
    metrics = env.metrics()
    assert metrics["CSR"] == 1
    assert metrics["weighted_cost_ratio"] < 2


@pytest.mark.parametrize("headings", [None, [0, 2]])
def test_two_pass_each_other(headings):
    instance = drawn("aB.bA ..... ", headings)
    plan = EPIBT().solve(instance)
    assert plan is not None
    assert validate(instance, plan) is None


def test_more_time_gives_a_higher_throughput():
    arrivals = []
    for time_limit in (0.0, 0.02):
        env = mapf_pz.parallel_env(map="random-16-16-20", num_agents=60, on_target="restart", max_steps=60)
        assert len(list(play(env, EPIBT(env, depth=5, time_limit=time_limit), seed=0))) == 60
        arrivals.append(env.metrics()["avg_throughput"])
    assert arrivals[1] > 1.05 * arrivals[0]


def test_the_same_episode_again_without_reset_states():
    actions = []
    env = mapf_pz.parallel_env(source=RandomObstacles(6, 6, 0.2, 8), on_target="restart", max_steps=1)
    planner = EPIBT(env, depth=3)
    for _ in range(2):
        observations, _ = env.reset(seed=0)
        actions.append(planner.act(observations))
        env.step(actions[-1])  # some agents move and keep their headings; others turn and keep their cells
    assert len(set(actions[0].values())) > 1
    assert actions[0] == actions[1]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"depth": 0}, "depth=0: expected a number of actions from 1 to 8"),
        ({"rounds": -1}, "rounds=-1: expected a number of rounds, 0 or more"),
        ({"num_threads": 0}, "num_threads=0: expected a number of threads, 1 or more"),
    ],
)
def test_an_invalid_option(options, message):
    with pytest.raises(ValueError, match=message):
        EPIBT(**options)


@pytest.mark.parametrize("model", ["cardinal", "rotate"])
def test_rounds_do_not_depend_on_the_number_of_threads(model):
    actions = []
    for rounds, num_threads in ((0, 1), (5, 1), (5, 2)):
        source = RandomObstacles(40, 48, 0.2, 500)
        keywords = {"action_model": model, "on_target": "restart", "max_steps": 25}
        env = mapf_pz.parallel_env(source=source, **keywords)
        actions.append(list(play(env, EPIBT(env, depth=3, rounds=rounds, num_threads=num_threads), seed=0)))
    assert actions[1] == actions[2] != actions[0]
