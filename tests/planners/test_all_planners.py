"""What all planners guarantee: their plans are valid, and no move is blocked."""

import inspect

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mapf_pz
from mapf_pz.instances import RandomObstacles
from mapf_pz.instances.instance import Grid, Instance, Scenario
from mapf_pz.planners import PLANNERS, Plan, validate

MODELS = ["rotate", "cardinal"]
WEIGHTS = ["uniform", "random", "crisscross"]


def quick(name):
    """Return the options with which a planner is fastest."""
    known = inspect.signature(PLANNERS[name]).parameters
    if "anytime" in known:
        return {"anytime": False, "time_limit": 0.5}
    return {"time_limit": 0.02} if name == "cbs" else {}


@pytest.mark.parametrize("name", list(PLANNERS))
@pytest.mark.parametrize("model", MODELS)
@settings(max_examples=15)
@given(seed=st.integers(0, 2**31), weights=st.sampled_from(WEIGHTS), num_agents=st.integers(1, 10))
def test_solutions_are_valid(name, model, seed, weights, num_agents):
    rng = np.random.default_rng(seed)
    drawn = RandomObstacles(6, 6, 0.2, num_agents).sample(rng)
    headings = rng.integers(4, size=num_agents) if model == "rotate" else None
    instance = Instance(drawn.grid, drawn.scenario, headings)
    plan = PLANNERS[name](seed=seed, **quick(name)).solve(instance, time_limit=0.5, max_steps=300, edge_weights=weights)
    if plan is not None:
        assert validate(instance, plan) is None
        assert plan.num_steps <= 300


@pytest.mark.parametrize("name", list(PLANNERS))
@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("on_target", ["nothing", "restart"])
@settings(max_examples=8)
@given(seed=st.integers(0, 2**31), weights=st.sampled_from(WEIGHTS))
def test_every_step_is_valid_and_not_blocked(name, model, on_target, seed, weights):
    env = mapf_pz.parallel_env(
        source=RandomObstacles(6, 6, 0.2, 6),
        action_model=model,
        edge_weights=weights,
        on_target=on_target,
        max_steps=25,
    )
    observations, _ = env.reset(seed=seed)
    starts, first_headings = env.positions, env.headings
    planner = PLANNERS[name](env, seed=seed, **quick(name))
    cells, headings = [starts], [first_headings]
    while env.agents:
        observations, _, _, _, infos = env.step(planner.act(observations))
        assert not any(info["blocked"] for info in infos.values())
        cells.append(env.positions)
        headings.append(env.headings)
    rotates = model == "rotate"
    # As if each agent had several goals, so that none must be reached at the end.
    instance = Instance(Grid(env.grid), Scenario(starts, starts[:, None]), first_headings if rotates else None)
    assert validate(instance, Plan(np.array(cells), np.array(headings) if rotates else None)) is None
