"""The hand-drawn conflicts of `tests.helpers.cases`, through the environment."""

import numpy as np
import pytest

import mapf_pz
from mapf_pz.instances.instance import Grid, Instance, Scenario
from tests.helpers.cases import CASES

SYSTEMS = ("soft", "priority", "block_both")


@pytest.mark.parametrize("system", SYSTEMS)
@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.action_model} {case.name}")
def test_hand_drawn_cases(case, system):
    starts = case.start_cells
    env = mapf_pz.parallel_env(
        map=np.array(case.free),
        num_agents=len(starts),
        action_model=case.action_model,
        collision_system=system,
        view_size=(1, 1),
    )
    # Goals do not matter here: the agents' own starts, in reverse.
    instance = Instance(Grid(np.array(case.free)), Scenario(starts, starts[::-1]), case.start_headings)
    _, infos = env.reset(options={"instance": instance})
    _, _, _, _, infos = env.step(dict(zip(env.agents, case.action_numbers, strict=True)))
    ends = case.end_cells(system)
    assert list(map(tuple, env.positions.tolist())) == ends
    assert env.headings.tolist() == case.end_headings
    moved = [start != end for start, end in zip(starts, ends, strict=True)]
    assert [bool(infos[agent]["moved"]) for agent in env.possible_agents] == moved
