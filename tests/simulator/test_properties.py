"""What holds in every state, whatever the configuration and the actions."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mapf_pz
from mapf_pz.instances import RandomObstacles
from mapf_pz.instances.heading import HEADING_STEPS
from mapf_pz.simulator import Simulator
from mapf_pz.simulator.config import REWARDS, EnvConfig
from mapf_pz.simulator.kernels.observation.channels import CHANNELS
from mapf_pz.simulator.kernels.observation.features import FEATURES


@st.composite
def configs(draw):
    shape = draw(st.tuples(st.integers(2, 6), st.integers(2, 6)))
    num_agents = draw(st.integers(1, shape[0] * shape[1] // 2))
    cardinal = draw(st.booleans())
    view, frame = draw(
        st.sampled_from(
            [("centered", "map")]
            if cardinal
            else [("centered", "map"), ("centered", "egocentric"), ("front", "egocentric")]
        )
    )
    on_target = draw(st.sampled_from(["nothing", "finish", "restart"]))
    return EnvConfig(
        source=RandomObstacles(*shape, 0.1, num_agents, goals_per_agent=3 if on_target == "restart" else 1),
        max_steps=draw(st.integers(1, 20)),
        action_model="cardinal" if cardinal else "rotate",
        collision_system=draw(st.sampled_from(["soft", "priority", "block_both"])),
        on_target=on_target,
        view_size=draw(st.tuples(st.integers(1, 14), st.integers(1, 14))),  # often larger than the map
        view=view,
        frame=frame,
        see_through_walls=draw(st.booleans()),
        channels=draw(st.permutations(list(CHANNELS))),
        features=draw(st.sampled_from([(), tuple(FEATURES)])),
        edge_weights=draw(st.sampled_from(["uniform", "random", "crisscross"])),
        reward=draw(st.sampled_from(list(REWARDS))),
    )


@settings(max_examples=30)
@given(config=configs(), seed=st.integers(0, 2**32 - 1))
def test_every_state_is_sound(config, seed):
    simulator = Simulator(config)
    simulator.reset(seeds={0: seed})
    space = simulator.layout.space()
    rng = np.random.default_rng(seed)
    check_state(simulator, space)
    for _ in range(config.max_steps):
        simulator.step(rng.integers(simulator.num_actions, size=(1, simulator.num_agents)))
        check_state(simulator, space)
        check_moves(simulator)
        agents = simulator.agents[0]
        if agents["terminated"].all() or not agents["active"].any():
            break
    else:
        assert agents["truncated"].sum() == agents["active"].sum()


def check_state(simulator, space):
    state, agents = simulator.state, simulator.agents[0]
    active = np.flatnonzero(agents["active"])
    cells = agents["cell"][active]
    assert len(np.unique(cells)) == len(cells), "two agents on one cell"
    assert simulator.grid(0).free.reshape(-1)[agents["cell"]].all(), "an agent in an obstacle"
    occupied = np.full(state.occupant.shape[1], -1)
    occupied[cells] = active
    assert np.array_equal(state.occupant[0], occupied)
    assert (state.claim == -1).all()
    check_observations(simulator, space)


def check_moves(simulator):
    agents = simulator.agents[0]
    width = simulator.shape[1]
    before, after = (np.stack(np.divmod(agents[name], width), axis=1) for name in ("was_cell", "cell"))
    assert np.abs(after - before).sum(axis=1).max() <= 1, "a move of more than one cell"
    moved = np.flatnonzero(agents["cell"] != agents["was_cell"])
    went = set(zip(agents["was_cell"][moved].tolist(), agents["cell"][moved].tolist(), strict=True))
    assert not went & {(there, here) for here, there in went}, "a swap"
    if simulator.config.action_model == "rotate":
        straight = HEADING_STEPS[agents["was_heading"][moved]]
        assert np.array_equal((after - before)[moved], straight), "a move that is not forward"
        assert np.array_equal(agents["heading"][moved], agents["was_heading"][moved]), "moved and turned at once"


def check_observations(simulator, space):
    seen = simulator.observe()
    config, agents = simulator.config, simulator.agents[0]
    for i in np.flatnonzero(agents["was_active"]):
        image, features = seen.image[0, i], seen.features[0, i]
        assert space.contains({"image": image, "features": features} if config.features else image)
    if config.see_through_walls:
        check_others_in_view(simulator, seen.image[0])
    gone = ~agents["was_active"]
    assert not seen.image[0, gone].any()
    assert not seen.features[0, gone].any()


def check_others_in_view(simulator, image):
    """Each active agent whose cell is in another's view is drawn there: POGEMA leaves some of them out."""
    config, agents = simulator.config, simulator.agents[0]
    drawn = image[:, plane_of(config, "view")]
    positions = simulator.positions(0)
    for i in np.flatnonzero(agents["was_active"]):
        expected = np.zeros(config.view_size, np.bool_)
        for j in np.flatnonzero(agents["active"]):
            row, col = place_in_view(config, positions[j] - positions[i], int(agents["heading"][i]))
            if j != i and 0 <= row < config.view_size[0] and 0 <= col < config.view_size[1]:
                expected[row, col] = True
        assert np.array_equal(drawn[i] == 0.5, expected)


def plane_of(config, name):
    before = config.channels[: config.channels.index(name)]
    return sum(CHANNELS[channel].planes for channel in before)


def place_in_view(config, offset, heading):
    """Where a cell `offset` away lies in the view of an agent with this heading."""
    row, col = offset.tolist()
    quarter_turns = (heading + 1) % 4 if config.resolved_frame == "egocentric" else 0  # from looking north
    for _ in range(quarter_turns):
        row, col = -col, row  # turn the world to the left, as the agent turned right
    height, width = config.view_size
    return row + (height - 1 if config.resolved_view == "front" else height // 2), col + width // 2


def test_place_in_view():
    config = EnvConfig(view_size=(5, 5))
    ahead = [place_in_view(config, HEADING_STEPS[heading], heading) for heading in range(4)]
    right = [place_in_view(config, HEADING_STEPS[(heading + 1) % 4], heading) for heading in range(4)]
    assert ahead == [(3, 2)] * 4
    assert right == [(4, 3)] * 4


@settings(max_examples=20)
@given(seed=st.integers(0, 2**32 - 1), cardinal=st.booleans(), on_target=st.sampled_from(["nothing", "finish"]))
def test_masked_actions_are_those_that_the_map_blocks(seed, cardinal, on_target):
    """An agent alone on its map is blocked exactly where its mask says so."""
    env = mapf_pz.parallel_env(
        source=RandomObstacles(4, 4, 0.3, 1),
        action_model="cardinal" if cardinal else "rotate",
        view_size=(1, 1),
        on_target=on_target,
    )
    _, infos = env.reset(seed=seed)
    rng = np.random.default_rng(seed)
    for _ in range(20):
        if not env.agents:
            break
        action = int(rng.integers(env.action_space("agent_0").n))
        mask = infos["agent_0"]["action_mask"]
        _, _, _, _, infos = env.step({"agent_0": action})
        assert infos["agent_0"]["blocked"] == 1 - mask[action]


@pytest.mark.parametrize("view_size", [(1, 1), (2, 3), (4, 4)])
def test_agents_that_look_over_the_edge_see_walls(view_size):
    env = mapf_pz.parallel_env(
        map=np.ones((4, 4), np.bool_), num_agents=3, view_size=view_size, initial_heading=[0, 1, 2]
    )
    corners, goals = [(0, 3), (3, 3), (3, 0)], [(1, 1), (1, 2), (2, 1)]
    observations, _ = env.reset(options={"instance": mapf_pz.Scenario(corners, goals)})
    for observation in observations.values():
        wall = observation[0].copy()
        wall[-1, view_size[1] // 2 :] = 1  # from its own place to the right, the map goes on
        assert (wall == 1).all()
