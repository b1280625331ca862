import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mapf_pz
from mapf_pz.instances import RandomObstacles
from mapf_pz.planners import PIBT, validate
from mapf_pz.planners.pibt.priority import priority_key, sort_by_key
from tests.helpers.episodes import play
from tests.helpers.reference_planners import SlowPIBT, World, assert_same_decisions
from tests.helpers.text_instances import drawn


def test_one_agent_takes_the_shortest_path():
    plan = PIBT().solve(drawn("a..# ..#A ...."))
    assert plan is not None
    assert plan.sum_of_costs == 6


def test_time_away_precedes_distance():
    away, to_go = np.array([0, 1, 2, 1, 0, 1]), np.array([0, 9999, 500, 7, 3, 9999], np.float32)
    key = np.array([priority_key(*agent) for agent in zip(away, to_go, strict=True)])
    for order in ([0, 1, 2, 3, 4, 5], [5, 4, 3, 2, 1, 0], [2, 5, 0, 1, 4, 3]):
        sorted_now = np.array(order, np.int32)
        sort_by_key(key, sorted_now, np.zeros(6, np.int32))
        assert sorted_now.tolist() == [2, 3, 1, 5, 0, 4]


@given(seed=st.integers(0, 2**31), num_agents=st.integers(1, 200), num_keys=st.integers(1, 200))
def test_equal_keys_are_sorted_by_index(seed, num_agents, num_keys):
    rng = np.random.default_rng(seed)
    key, order = rng.integers(num_keys, size=num_agents).astype(float), rng.permutation(num_agents).astype(np.int32)
    sort_by_key(key, order, np.zeros(num_agents, np.int32))
    assert order.tolist() == np.argsort(key, kind="stable").tolist()


@pytest.mark.parametrize("headings", [None, [0, 2]])
def test_an_agent_at_its_goal_makes_way(headings):
    instance = drawn("aB.bA ..... ", headings)
    plan = PIBT().solve(instance)
    assert plan is not None
    assert validate(instance, plan) is None


def test_a_corridor_that_is_too_narrow_has_no_plan():
    assert PIBT().solve(drawn("aB.bA"), max_steps=50) is None


@pytest.mark.parametrize("model", ["cardinal", "rotate"])
@pytest.mark.parametrize("weights", ["uniform", "random", "crisscross"])
@settings(max_examples=15)
@given(
    seed=st.integers(0, 2**31),
    on_target=st.sampled_from(["nothing", "restart", "finish"]),
    priority=st.sampled_from(["nearest", "elapsed", "late"]),
    swap=st.booleans(),
    preference=st.sampled_from(["random", "hindrance"]),
)
def test_no_move_is_blocked(model, weights, seed, on_target, priority, swap, preference):
    env = mapf_pz.parallel_env(
        source=RandomObstacles(8, 8, 0.2, 14),
        action_model=model,
        edge_weights=weights,
        on_target=on_target,
        max_steps=40,
    )
    assert len(list(play(env, PIBT(env, seed, priority, swap, preference), seed))) > 0


@pytest.mark.parametrize("headings", [None, [2, 0]])
def test_an_agent_makes_room_for_one_that_leaves_its_dead_end(headings):
    instance = drawn("Aba.B ##...", headings)
    assert PIBT(swap=False).solve(instance, max_steps=50) is None
    plan = PIBT().solve(instance, max_steps=50)
    assert plan is not None
    assert validate(instance, plan) is None


@pytest.mark.parametrize("headings", [None, [2, 0]])
@pytest.mark.parametrize("text", [".####### ..Ab.aB. .#######", "..#####.. ..Ab.aB.. ..#####.."])
def test_agents_change_places_in_a_corridor(headings, text):
    instance = drawn(text, headings)
    assert PIBT(swap=False).solve(instance, max_steps=100) is None
    plan = PIBT().solve(instance, max_steps=40)
    assert plan is not None
    assert validate(instance, plan) is None


def test_an_agent_gives_way_to_the_one_behind_it():
    instance = drawn("B. .A a. b.")  # up or right, a comes equally near to its goal; b needs the cell above
    firsts = {"random": set(), "hindrance": set()}
    for preference, seen in firsts.items():
        plans = [PIBT(seed=seed, preference=preference).solve(instance) for seed in range(20)]
        seen.update(tuple(plan.positions[1, 0].tolist()) for plan in plans)
    assert firsts == {"random": {(1, 0), (2, 1)}, "hindrance": {(2, 1)}}


@pytest.mark.parametrize(
    ("option", "expected"), [("priority", "nearest, elapsed, late"), ("preference", "random, hin")]
)
def test_an_unknown_option(option, expected):
    with pytest.raises(ValueError, match=f"{option}='first': expected one of {expected}"):
        PIBT(**{option: "first"})


@pytest.mark.parametrize("on_target", ["nothing", "restart"])
@settings(max_examples=15)
@given(seed=st.integers(0, 2**31), num_agents=st.sampled_from([4, 12, 24]), density=st.sampled_from([0.2, 0.4]))
def test_it_decides_as_in_plain_python(on_target, seed, num_agents, density):
    env = mapf_pz.parallel_env(source=RandomObstacles(8, 8, density, num_agents), on_target=on_target, max_steps=30)
    observations, _ = env.reset(seed=seed)
    planner, slow = PIBT(env, seed), SlowPIBT(World(env.grid), seed, stays=on_target == "nothing")
    assert_same_decisions(env, observations, planner, slow)


def test_without_an_environment_it_cannot_act():
    with pytest.raises(RuntimeError, match="expected an environment to act in, as in PIBT"):
        PIBT().act({})
