"""Observations of previous steps and of neighbors: the options `num_frames`, `num_neighbors`, `neighbor_radius`."""

import numpy as np
import pytest
import torch
from gymnasium import spaces
from pettingzoo.test import parallel_api_test, parallel_seed_test
from tensordict import TensorDictBase
from torchrl.envs import check_env_specs

import mapf_pz
from mapf_pz import Action, Channel, EnvConfig, Scenario
from mapf_pz.commands.render import EpisodeOptions, render
from mapf_pz.evaluation import EvaluationTask, evaluate, make_env
from mapf_pz.instances.sources import RandomObstacles
from mapf_pz.rl import BatchedMapfEnv, load_policy, train
from mapf_pz.rl.config import ModelConfig, OptimizationConfig, TaskConfig, TrainConfig
from mapf_pz.rl.config_file import CONFIG, config_files, load_config
from mapf_pz.rl.networks.observation_shape import ObservationShape
from mapf_pz.simulator import Simulator
from mapf_pz.simulator.keywords import EnvKeywords
from mapf_pz.wrappers import CentralizedEnv, CentralizedVectorEnv, ContinuousActions, RecordEpisode
from tests.helpers.small_run import changed

pytestmark = pytest.mark.usefixtures("without_figures")

FORWARD, WAIT = int(Action.FORWARD), int(Action.WAIT)
FRAMES, NEIGHBORS = {"num_frames": 3}, {"num_neighbors": 2, "neighbor_radius": 3}
OPTIONS = [FRAMES, NEIGHBORS, FRAMES | NEIGHBORS, {"num_frames": 2, "num_neighbors": 5}]
KINDS = [
    {},
    {"features": ("goal_vector", "time"), "on_target": "finish"},
    {"on_target": "restart"},
    {"action_model": "cardinal", "features": ("location",)},
]
OFF = {name: getattr(EnvConfig, name) for name in ("num_frames", "num_neighbors", "neighbor_radius")}


# The same in plain Python, from an environment without the options.


def parts(seen):
    """The image and the features of an observation, or of its space."""
    return [seen["image"], seen["features"]] if isinstance(seen, (dict, spaces.Dict, TensorDictBase)) else [seen]


def nearest(positions, active, number, radius):
    """The indices of each agent's neighbors."""
    found = []
    for i, (row, col) in enumerate(positions):
        others = []
        for j, (r, c) in enumerate(positions):
            rows, cols = abs(r - row), abs(c - col)
            if i != j and active[i] and active[j] and rows <= radius and cols <= radius:
                others.append((rows + cols, j))
        found.append([j for _, j in sorted(others)][:number])
    return found


class Plain:
    """An environment without the options, and what its agents would observe with them."""

    def __init__(self, num_frames=1, num_neighbors=0, neighbor_radius=8, **keywords):
        self.env = mapf_pz.parallel_env(**keywords)
        self.num_frames, self.num_neighbors, self.radius = num_frames, num_neighbors, neighbor_radius

    def reset(self, **keywords):
        self.frames = []
        return self._expected(self.env.reset(**keywords)[0])

    def step(self, actions):
        return self._expected(self.env.step(actions)[0])

    def _expected(self, seen):
        """The parts of each agent's observation."""
        active = self.env.render_state().active
        near = nearest(self.env.positions.tolist(), active, self.num_neighbors, self.radius)
        self.frames.append({agent: self._with_neighbors(seen, agent, near) for agent in seen})
        last = ([self.frames[0]] * self.num_frames + self.frames)[-self.num_frames :]
        return {
            agent: [np.concatenate(frames) for frames in zip(*(frame[agent] for frame in last), strict=True)]
            for agent in seen
        }

    def _with_neighbors(self, seen, agent, near):
        """The agent's own parts, each followed by those of its neighbors."""
        own = parts(seen[agent])
        theirs = [parts(seen[f"agent_{j}"]) for j in near[int(agent.removeprefix("agent_"))]]
        theirs += [[np.zeros_like(part) for part in own]] * (self.num_neighbors - len(theirs))
        return [np.concatenate(observed) for observed in zip(own, *theirs, strict=True)]


def assert_same(seen, expected):
    assert seen.keys() == expected.keys()
    for agent, observation in seen.items():
        for part, other in zip(parts(observation), expected[agent], strict=True):
            assert part.dtype == np.float32
            assert np.array_equal(part, other), agent


def random_actions(rng, env):
    actions = rng.choice(4, len(env.agents), p=(0.6, 0.2, 0.1, 0.1))
    return dict(zip(env.agents, actions.tolist(), strict=True))


@pytest.mark.parametrize("options", OPTIONS, ids=str)
@pytest.mark.parametrize("keywords", KINDS, ids=str)
def test_observations_are_those_computed_plainly(keywords, options):
    keywords = {"num_agents": 6, "max_steps": 15, "map": "......\n" * 5, "view_size": (3, 4)} | keywords | options
    env, plain, rng = mapf_pz.parallel_env(**keywords), Plain(**keywords), np.random.default_rng(0)
    fewest = 6
    for episode in range(4):
        assert_same(env.reset(seed=episode)[0], plain.reset(seed=episode))
        while env.agents:
            actions = random_actions(rng, env)
            assert_same(env.step(actions)[0], plain.step(actions))
            fewest = min(fewest, len(env.agents) or fewest)
    assert (fewest < 6) == (keywords.get("on_target") == "finish")


def test_one_frame_and_no_neighbors_are_the_default():
    assert OFF == {"num_frames": 1, "num_neighbors": 0, "neighbor_radius": 8}


# Single environments.


@pytest.mark.parametrize("options", OPTIONS, ids=str)
@pytest.mark.parametrize("keywords", KINDS, ids=str)
def test_pettingzoos_own_tests(keywords, options):
    keywords = {"num_agents": 4, "max_steps": 20} | keywords | options
    parallel_api_test(mapf_pz.parallel_env(**keywords), num_cycles=50)
    parallel_seed_test(lambda: mapf_pz.parallel_env(**keywords))


def test_spaces():
    plain = mapf_pz.parallel_env().observation_space("agent_0")
    for options, number in ((FRAMES, 3), (NEIGHBORS, 3), (FRAMES | NEIGHBORS, 9)):
        env = mapf_pz.parallel_env(**options)
        space = env.observation_space("agent_0")
        assert space is env.observation_space("agent_3") is env.observation_spaces["agent_1"]
        bounds = (np.concatenate([bound] * number) for bound in (plain.low, plain.high))
        assert space == spaces.Box(*bounds, dtype=np.float32)
    both = mapf_pz.parallel_env(features=("time", "location"), **FRAMES).observation_space("agent_0")
    assert (both["image"].shape, both["features"].shape) == ((21, 5, 5), (21,))


def draw_two(_inputs, image, plane):
    image[:, :, plane] = 2


def test_the_bounds_of_neighbors_include_zeros():
    env = mapf_pz.parallel_env(channels=(Channel(draw_two, low=2, high=3),), num_agents=1, num_neighbors=1)
    space = env.observation_space("agent_0")
    assert (space.low[:, 0, 0].tolist(), space.high[:, 0, 0].tolist()) == ([2, 0], [3, 3])
    assert space.contains(env.reset(seed=0)[0]["agent_0"])


def test_the_oldest_frame_first_and_the_first_one_repeated():
    env = mapf_pz.parallel_env(features=("time",), max_steps=4, num_frames=3)
    times = [env.reset(seed=0)[0]["agent_1"]["features"].tolist()]
    while env.agents:
        times.append(env.step(dict.fromkeys(env.agents, WAIT))[0]["agent_1"]["features"].tolist())
    assert times == [[0, 0, 0], [0, 0, 0.25], [0, 0.25, 0.5], [0.25, 0.5, 0.75], [0.5, 0.75, 1]]
    assert env.reset()[0]["agent_1"]["features"].tolist() == [0, 0, 0]


def test_frames_are_of_steps_whether_observed_or_not():
    simulator = Simulator(EnvConfig(features=("time",), max_steps=4, num_frames=3))
    simulator.reset()
    for _ in range(3):
        simulator.step(np.full((1, 4), WAIT))
    for _ in range(2):  # observing changes nothing
        assert simulator.observe().features[0, 0].tolist() == [0.25, 0.5, 0.75]


MAP = """
0..1...
..2....
.......
4..3...
......5
"""  # the digits are agents
ROWS = MAP.split()
AGENTS = np.array([next((r, row.index(str(i))) for r, row in enumerate(ROWS) if str(i) in row) for i in range(6)])


def drawn(goals, **keywords):
    """The keywords of the drawn map."""
    free = "\n".join("." * len(row) for row in ROWS) + "\n"
    place = {"map": free, "scenario": Scenario(AGENTS, goals), "initial_heading": "east"}
    return place | {"view_size": (3, 3), "features": ("location",)} | keywords


def neighbors_seen(seen):
    """The indices of each agent's neighbors, by their locations; None for one of zeros."""
    cells = {agent: part.reshape(-1, 6) for agent, part in ((agent, one["features"]) for agent, one in seen.items())}
    own = [tuple(numbers[0]) for numbers in cells.values()]
    agents = [int(agent.removeprefix("agent_")) for agent in cells]
    return {
        i: [agents[own.index(tuple(one))] if one.any() else None for one in numbers[1:]]
        for i, numbers in zip(agents, cells.values(), strict=True)
    }


def near(number, radius):
    env = mapf_pz.parallel_env(**drawn(AGENTS), num_neighbors=number, neighbor_radius=radius)
    return neighbors_seen(env.reset()[0])


def test_neighbors_on_a_drawn_map():
    assert near(3, 3) == {
        0: [1, 2, 4],  # 3, 3 and 3 steps away: by index; 3 is in reach, but 6 steps away
        1: [2, 0, 3],  # 2, 3 and 3 steps
        2: [1, 0, 3],  # 2, 3 and 3 steps
        3: [1, 2, 4],  # 3, 3 and 3 steps; 5 is 4 away
        4: [0, 3, 2],  # 3, 3 and 4 steps
        5: [3, None, None],  # the others are more than 3 columns or rows away
    }


def test_the_radius_is_a_square():
    assert near(6, 2)[2] == [1, 0, 3, 4, None, None]
    assert near(6, 1)[2] == [1, None, None, None, None, None]
    assert list(near(2, 0).values()) == [[None, None]] * 6


def test_agents_that_have_disappeared_are_not_neighbors_and_have_none():
    goals = AGENTS + (0, 1)
    goals[5] = (3, 6)  # it stands at the right edge
    env = mapf_pz.parallel_env(**drawn(goals, on_target="finish"), num_neighbors=3, neighbor_radius=3)
    env.reset()
    leaving = ("agent_1", "agent_4")
    seen = env.step({agent: FORWARD if agent in leaving else WAIT for agent in env.agents})[0]
    expected = {0: [2, 3, None], 1: [None] * 3, 2: [0, 3, None], 3: [2, 5, 0], 4: [None] * 3, 5: [3, None, None]}
    assert neighbors_seen(seen) == expected
    for agent in leaving:
        assert seen[agent]["image"][:7].any()
        assert not seen[agent]["image"][7:].any()
    assert list(env.step(dict.fromkeys(env.agents, WAIT))[0]) == env.agents == [f"agent_{i}" for i in (0, 2, 3, 5)]


def test_neighbors_are_there_in_the_last_observation_at_the_time_limit():
    env = mapf_pz.parallel_env(num_neighbors=3, max_steps=1)
    env.reset(seed=0)
    seen = env.step(dict.fromkeys(env.agents, 0))[0]
    assert not env.agents
    assert all(seen[agent][21:].any() for agent in seen)


def test_all_neighbors_are_the_whole_team():
    seen = mapf_pz.parallel_env(num_neighbors=3).reset(seed=0)[0]
    alone = mapf_pz.parallel_env().reset(seed=0)[0]
    everything = sorted(planes.tobytes() for planes in alone.values())
    for agent in seen:
        assert sorted(planes.tobytes() for planes in np.split(seen[agent], 4)) == everything


def test_observations_are_the_callers_own():
    env, same = (mapf_pz.parallel_env(**FRAMES, **NEIGHBORS) for _ in range(2))
    for seen in env.reset(seed=0)[0].values():
        seen[:] = 9
    same.reset(seed=0)
    actions = dict.fromkeys(env.agents, 0)
    assert np.array_equal(env.step(actions)[0]["agent_0"], same.step(actions)[0]["agent_0"])


def test_the_global_state_has_none_of_it():
    envs = [mapf_pz.parallel_env(), mapf_pz.parallel_env(**FRAMES, **NEIGHBORS)]
    for env in envs:
        env.reset(seed=0)
        env.step(dict.fromkeys(env.agents, FORWARD))
    assert np.array_equal(*(env.state() for env in envs))


@pytest.mark.parametrize(
    ("name", "value", "least"), [("num_frames", 0, 1), ("num_neighbors", -1, 0), ("neighbor_radius", -1, 0)]
)
def test_wrong_numbers_are_refused(tmp_path, name, value, least):
    for wrong in (value, 1.5, True):
        least_of = f", {least} or more" if wrong == value else ""
        with pytest.raises(ValueError, match=f"^{name}={wrong}: expected a whole number{least_of}$"):
            EnvConfig(**{name: wrong})
    file = tmp_path / "config.json"
    text = config_files(TrainConfig())[CONFIG].decode()
    file.write_text(text.replace(f'"{name}": {OFF[name]}', f'"{name}": {value}'))
    with pytest.raises(mapf_pz.FormatError, match=f"{name}={value}"):
        load_config(file)


# Wrappers.


def test_a_centralized_environment():
    env = CentralizedEnv(mapf_pz.parallel_env(num_agents=3, **FRAMES, **NEIGHBORS))
    assert env.observation_space.shape == env.reset(seed=0)[0].shape == (3 * 3 * 3 * 7, 5, 5)
    wrapped = ContinuousActions(mapf_pz.parallel_env(num_frames=2))
    assert wrapped.observation_space("agent_0").shape == (14, 5, 5)


def test_a_centralized_batch_is_the_single_environments():
    """Also of agents that have disappeared: their earlier frames are not seen either."""
    keywords = {"num_agents": 5, "max_steps": 25, "map": ".....\n" * 5, "on_target": "finish", "features": ("time",)}
    keywords |= {"initial_heading": "east", "num_frames": 3, "num_neighbors": 2}
    batch = CentralizedVectorEnv(2, **keywords)
    singles = [CentralizedEnv(mapf_pz.parallel_env(**keywords)) for _ in range(2)]
    seen, _ = batch.reset(seed=3)
    alone = [single.reset(seed=3 + b)[0] for b, single in enumerate(singles)]
    rng, over, gone = np.random.default_rng(1), [False, False], 0
    for _ in range(60):
        for b in range(2):
            for part in ("image", "features"):
                assert np.array_equal(seen[part][b], alone[b][part])
            gone += int((alone[b]["features"].reshape(5, -1)[:, -3] == 0).any())
        action = rng.uniform(-1, 1, (2, 5, 4)) + (0.7, 0, 0, 0)
        seen, *_ = batch.step(action)
        for b, single in enumerate(singles):
            if over[b]:
                alone[b], over[b] = single.reset()[0], False
            else:
                alone[b], _, terminated, truncated, _ = single.step(action[b])
                over[b] = terminated or truncated
    assert gone > 10


def test_a_recording_shows_the_agents_own_observations_of_each_step():
    recorded = []
    for options in ({}, FRAMES | NEIGHBORS):
        env = RecordEpisode(mapf_pz.parallel_env(max_steps=6, **options))
        env.reset(seed=0)
        rng = np.random.default_rng(0)
        while env.agents:
            env.step(random_actions(rng, env))
        recorded.append(env.recording)
    assert np.array_equal(recorded[0].observed, recorded[1].observed)
    assert recorded[0].planes == recorded[1].planes


# Batches and training.

TASK = changed(
    TaskConfig(), height=7, width=6, num_agents=4, max_steps=9, view_size=(3, 3), features=("time", "goal_vector")
)
TASKS = {"dict": TASK, "box": changed(TASK, features=())}


@pytest.fixture(params=TASKS)
def task(request):
    return TASKS[request.param]


@pytest.mark.parametrize("options", OPTIONS, ids=str)
def test_specs_hold_and_are_the_shapes_that_networks_are_built_for(task, options):
    task = changed(task, **options)
    env = BatchedMapfEnv(3, **task.env_keywords())
    check_env_specs(env)
    observed = ObservationShape.of_task(task)
    expected = [observed.image, (observed.features,)] if task.env.features else [observed.image]
    space = mapf_pz.parallel_env(**task.env_keywords()).observation_space("agent_0")
    assert [box.shape for box in parts(space)] == expected


@pytest.mark.parametrize(
    ("on_target", "num_threads"), [("nothing", 1), ("finish", 1), ("finish", 2), ("restart", 1)], ids=str
)
@pytest.mark.parametrize("options", OPTIONS, ids=str)
def test_a_row_of_a_batch_is_a_single_environment(task, options, on_target, num_threads):
    """Over several episodes that begin at different times in different rows."""
    source = RandomObstacles(7, 6, 0.1, 4, 20 if on_target == "restart" else 1)
    keywords = task.env_keywords() | {"source": source, "on_target": on_target} | options
    env = BatchedMapfEnv(3, num_threads, **keywords)
    env.set_seed(20)
    now = env.reset()
    singles = [Plain(**keywords) for _ in range(3)]
    seen = [single.reset(seed=20 + b) for b, single in enumerate(singles)]
    rng = np.random.default_rng(3)
    began = np.zeros(3, int)
    for step in range(40):
        for b, single in enumerate(singles):
            for i, agent in enumerate(single.env.possible_agents):
                for k, part in enumerate(parts(now["agents", "observation"][b, i])):
                    expected = seen[b][agent][k] if agent in seen[b] else np.zeros(part.shape)
                    assert np.array_equal(part, expected)
        over = now["done"].clone()
        if step in (4, 6):  # rows 0 and 2 begin anew before their episode's end
            over |= torch.tensor([[True], [False], [step == 6]])
        if over.any():
            now["_reset"] = over
            now = env.reset(now)
            for b in over.flatten().nonzero().flatten().tolist():
                seen[b] = singles[b].reset()
                began[b] += 1
            continue
        actions = rng.choice([0, 0, 0, 1, 2], (3, 4))
        now["agents", "action"] = torch.from_numpy(actions)
        now = env.step(now)["next"]
        for b, single in enumerate(singles):
            seen[b] = single.step({agent: int(actions[b, int(agent[-1])]) for agent in single.env.agents})
    assert began.min() >= 3
    assert len(set(began.tolist())) > 1


@pytest.mark.parametrize("algorithm", ["mappo", "central-ppo"])
def test_train_then_play(tmp_path, algorithm):
    options = {"num_frames": 2, "num_neighbors": 2, "neighbor_radius": 3}
    config = TrainConfig(
        task=changed(TASK, **options),
        algorithm=algorithm,
        model=ModelConfig(conv_channels=(4,), hidden=16),
        optimization=OptimizationConfig(num_envs=4, steps_per_batch=16, num_epochs=1, minibatch_size=32),
        agent_steps=600,
    )
    policy = load_policy(train(config, tmp_path))
    assert policy.env_kwargs.items() >= options.items()
    task = EvaluationTask("maps", 4, {"source": RandomObstacles(9, 9, 0.2, 4), "max_steps": 10}, episodes=2)
    env = make_env(policy, **task.keywords)
    planes = mapf_pz.parallel_env(**policy.env_kwargs | OFF).observation_space("agent_0")["image"].shape[0]
    assert env.observation_space("agent_0")["image"].shape[0] == 2 * 3 * planes
    assert [episode.metrics["ep_length"] for episode in evaluate({"it": policy}, [task])] == [10, 10]
    keywords = EnvKeywords({"map": "empty-8-8", "num_agents": 4, "max_steps": 3})
    render(EpisodeOptions(tmp_path / "end.png", (str(tmp_path),), keywords))
    assert (tmp_path / "end.png").stat().st_size > 0
