"""The kernels and `tests.helpers.reference` in lockstep, on maps so full of agents that conflicts are many."""

from itertools import product

import numpy as np
import pytest

import mapf_pz
from mapf_pz.guidance import GuidanceGraph, open_edges
from mapf_pz.instances.delays import Delays
from mapf_pz.instances.instance import Grid, Instance, Scenario
from mapf_pz.simulator import Simulator
from mapf_pz.simulator.config import REWARDS, EnvConfig, RewardConfig
from mapf_pz.simulator.kernels.observation import layers
from mapf_pz.simulator.kernels.observation.channels import CHANNELS
from mapf_pz.simulator.kernels.observation.features import FEATURES
from tests.helpers.reference import Reference

COMBINATIONS = list(
    product(("rotate", "cardinal"), ("soft", "priority", "block_both"), ("nothing", "finish", "restart"))
)
COMBINATION_NAMES = ("action_model", "collision_system", "on_target")


class Disorder:
    """Instances without any mercy: goals may be shared, out of reach, or where the agent starts. Remembers them."""

    grid = None

    def __init__(self, rng, shape, num_agents, num_goals=1, num_maps=6, density=0.2):
        self.shape, self.num_agents, self.num_goals = shape, num_agents, num_goals
        self.grids = [Grid(self._draw(rng, density)) for _ in range(num_maps)]
        self.drawn = []

    def _draw(self, rng, density):
        while True:
            free = rng.random(self.shape) >= density
            if free.sum() >= self.num_agents:
                return free

    def sample(self, rng):
        grid = self.grids[rng.integers(len(self.grids))]
        cells = np.argwhere(grid.free)
        starts = cells[rng.permutation(len(cells))[: self.num_agents]]
        goals = cells[rng.integers(len(cells), size=(self.num_agents, self.num_goals))]
        headings = rng.integers(4, size=self.num_agents)
        self.drawn.append(Instance(grid, Scenario(starts, goals), headings))
        return self.drawn[-1]


class Lockstep:
    """B environments of the simulator, and a reference for each."""

    def __init__(self, config, num_envs, seed):
        self.config, self.num_envs = config, num_envs
        self.simulator = Simulator(config, num_envs)
        self.rng = np.random.default_rng(seed)
        self.tables = {}  # of the references, by map: they are slow to compute
        self.games = [None] * num_envs
        self.counts = dict.fromkeys(("steps", "blocked", "arrived", "terminated", "truncated", "delayed"), 0)
        self.reset(range(num_envs), {b: seed + b for b in range(num_envs)})

    def reset(self, envs, seeds=None):
        self.config.source.drawn.clear()
        self.simulator.reset(envs, seeds)
        for b, instance in zip(envs, self.config.source.drawn, strict=True):
            assert not self.simulator.over[b]
            self.games[b] = self._reference(b, instance)
            np.testing.assert_array_equal(self.simulator.positions(b), instance.scenario.starts)
            self._compare(b)

    def _reference(self, b, instance):
        config, scenario = self.config, instance.scenario
        game = Reference(
            instance.grid.free.tolist(),
            scenario.starts.tolist(),
            instance.headings.tolist(),
            scenario.goals.tolist(),
            **self._weights(b, instance.grid),
            rewards=config.reward_config,
            **{name: getattr(config, name) for name in (*COMBINATION_NAMES, "max_steps", "num_last_actions")},
            **{name: getattr(config, name) for name in ("view_size", "see_through_walls")},
            view=config.resolved_view,
            frame=config.resolved_frame,
            **{name: getattr(config, name) for name in ("channels", "features", "delays")},
            delay_key=int(self.simulator.state.delay_key[b]),
        )
        if config.edge_weights != "random":
            game.tables = self.tables.setdefault(instance.grid, {})
        return game

    def _weights(self, b, grid):
        graph = self.config.edge_weights
        if graph == "uniform":
            return {}
        if graph == "random":  # drawn by the simulator
            weight = self.simulator.world.weight[b, :, :-1].reshape(5, *grid.shape)
            assert np.array_equal(np.isfinite(weight[:4]), open_edges(grid.free))
            return {"move": weight[:4].tolist(), "wait": weight[4].tolist()}
        if graph == "crisscross":
            graph = GuidanceGraph.crisscross(grid.free)
        return {"move": np.where(open_edges(grid.free), graph.move, np.inf).tolist(), "wait": graph.wait.tolist()}

    def step(self):
        """Step all, compare all, and begin anew what has ended and, now and then, what has not."""
        actions = self._actions()
        playing = [game.active.copy() for game in self.games]
        self.simulator.step(actions)
        over = []
        for b, game in enumerate(self.games):
            game.step(actions[b].tolist())
            self._compare(b)
            self._compare_outcome(b, playing[b])
            is_over = bool(game.truncated or all(game.terminated))
            assert self.simulator.over[b] == is_over
            if is_over or self.rng.random() < 0.003:
                over.append(b)
                if self.rng.random() < 0.2:  # slow, in the reference
                    self._compare_metrics(b)
        self.reset(over)

    def _actions(self):
        """Draw actions: more moves than turns."""
        chances = (
            (0.1, 0.225, 0.225, 0.225, 0.225) if self.config.action_model == "cardinal" else (0.55, 0.2, 0.2, 0.05)
        )
        shape = (self.num_envs, self.simulator.num_agents)
        return self.rng.choice(len(chances), shape, p=chances)

    def _compare(self, b):
        game, agents = self.games[b], self.simulator.agents[b]
        assert list(map(tuple, self.simulator.positions(b).tolist())) == game.positions
        assert list(map(tuple, self.simulator.goals(b).tolist())) == game.goals
        assert agents["heading"].tolist() == game.headings
        assert agents["active"].tolist() == game.active
        assert self.simulator.steps[b] == game.step_count

    def _compare_outcome(self, b, playing):
        game, agents = self.games[b], self.simulator.agents[b]
        terminated = [ended and played for ended, played in zip(game.terminated, playing, strict=True)]
        truncated = [game.truncated and p and not t for p, t in zip(playing, terminated, strict=True)]
        at_goal = [on_goal and played for on_goal, played in zip(game.on_goal_log[-1], playing, strict=True)]
        for name, expected in (
            ("arrived", game.arrived),
            ("blocked", game.blocked),
            ("delayed", game.delayed),
            ("terminated", terminated),
            ("truncated", truncated),
            ("at_goal", at_goal),
            ("was_active", playing),
            ("step_weight", [log[-1] if p else 0 for log, p in zip(game.weight_log, playing, strict=True)]),
            ("arrivals", [len(steps) for steps in game.arrival_steps]),
        ):
            assert agents[name].tolist() == expected, name
        assert (agents["cell"] != agents["was_cell"]).tolist() == game.moved
        assert np.abs(agents["reward"] - game.rewards).max() < 1e-4
        self.counts["steps"] += 1
        for name in ("blocked", "arrived", "terminated", "truncated", "delayed"):
            self.counts[name] += int(agents[name].sum())

    def _compare_metrics(self, b):
        expected, got = self.games[b].metrics(), self.simulator.metrics(b)
        assert got == pytest.approx(expected)

    def compare_observations(self):
        seen = self.simulator.observe()
        for b, game in enumerate(self.games):
            for i in game.agents:
                compare_observation(game, i, seen.image[b, i], seen.features[b, i], seen.action_mask[b, i])


def compare_observation(game, agent, image, features, mask):
    expected = game.observe(agent)
    drawn = np.concatenate([np.array(expected[name]) for name in game.channels])
    if not np.allclose(image, drawn, rtol=0, atol=1e-5):
        wrong = np.abs(image - drawn).max(axis=(1, 2)) > 1e-5
        names = np.repeat(game.channels, [len(expected[name]) for name in game.channels])
        pytest.fail(f"agent {agent}: {set(names[wrong])} differ: {image[wrong]}, expected {drawn[wrong]}")
    numbers = game.feature(agent)
    told = [number for name in game.features for number in numbers[name]]
    assert features.shape == (len(told),)
    if not np.allclose(features, told, rtol=0, atol=1e-5):
        names = np.repeat(game.features, [len(numbers[name]) for name in game.features])
        wrong = np.abs(features - told) > 1e-5
        pytest.fail(f"agent {agent}: {set(names[wrong])} differ: {features}, expected {told}")
    assert mask.tolist() == game.action_mask(agent)


def any_reward(rng, edge_weights="uniform"):
    """Draw a reward; moves of infinite weight cannot be penalized."""
    if rng.random() < 0.3:
        return rng.choice(list(REWARDS))
    names = ("forward", "rotate", "wait", "goal", "progress", "step_cost", "blocked", "team_goal")
    names += () if isinstance(edge_weights, GuidanceGraph) else ("weighted_step_cost",)
    return RewardConfig(
        **{name: float(rng.choice([0, 1, -1, rng.normal()], p=(0.1, 0.1, 0.1, 0.7))) for name in names},
        pay_blocked_forward=rng.random() < 0.5,
        share=rng.choice([0.0, 0.5, 1.0, -1.0]),
        share_radius=int(rng.integers(4)),
    )


def any_weights(rng, shape):
    """Name a generator, or draw a graph in which some passages are one-way."""
    if rng.random() < 0.75:
        return str(rng.choice(["uniform", "random", "crisscross"]))
    move = np.where(rng.random((4, *shape)) < 0.1, np.inf, rng.uniform(0.1, 2, (4, *shape)))
    return GuidanceGraph(move, rng.uniform(0.1, 2, shape))


def any_delays(rng):
    """Draw delays, of some episodes' agents most of the time; or none."""
    if rng.random() < 0.3:
        return None
    duration = sorted(rng.integers(1, 8, size=2).tolist())
    events, durations = str(rng.choice(["bernoulli", "poisson"])), str(rng.choice(["uniform", "normal"]))
    return Delays(float(rng.choice([0.02, 0.1, 0.9])), tuple(duration), events, durations)


@pytest.mark.parametrize("num_envs", [8, pytest.param(20, marks=pytest.mark.slow)])
@pytest.mark.parametrize(COMBINATION_NAMES, COMBINATIONS)
def test_thousands_of_steps(action_model, collision_system, on_target, num_envs):
    rng = np.random.default_rng(COMBINATIONS.index((action_model, collision_system, on_target)))
    steps = arrived = terminated = truncated = blocked = 0
    for shape, num_agents, max_steps, num_steps in (((4, 5), 9, 25, 160), ((3, 3), 4, 30, 100), ((2, 3), 2, 60, 250)):
        config = EnvConfig(
            source=Disorder(rng, shape, num_agents, num_goals=3 if on_target == "restart" else 1),
            action_model=action_model,
            collision_system=collision_system,
            on_target=on_target,
            max_steps=max_steps,
            reward=any_reward(rng),
            edge_weights=str(rng.choice(["uniform", "crisscross"])),
            delays=None if num_agents == 9 else any_delays(rng),
            view_size=(1, 1),
        )
        lockstep = Lockstep(config, num_envs=num_envs, seed=int(rng.integers(2**32)))
        for _ in range(num_steps):
            lockstep.step()
        counts = lockstep.counts
        steps, arrived, blocked = steps + counts["steps"], arrived + counts["arrived"], blocked + counts["blocked"]
        terminated, truncated = terminated + counts["terminated"], truncated + counts["truncated"]
    assert steps >= 500 * num_envs
    assert min(blocked, arrived, truncated) > 10 * num_envs  # else this test has seen nothing
    assert terminated == 0 if on_target == "restart" else terminated > num_envs


@pytest.mark.parametrize("number", [3, pytest.param(6, marks=pytest.mark.slow)])
@pytest.mark.parametrize(COMBINATION_NAMES, COMBINATIONS)
def test_observations(action_model, collision_system, on_target, number):
    rng = np.random.default_rng(100 + COMBINATIONS.index((action_model, collision_system, on_target)))
    for k in range(number):
        # Views of more than 8 columns are copied in several blocks.
        shape = (int(rng.integers(2, 6)), int(rng.integers(9, 19) if k == 0 else rng.integers(2, 6)))
        num_agents = min(int(rng.integers(2, 6)), shape[0] * shape[1] // 2)
        view = "centered" if action_model == "cardinal" else rng.choice(["front", "centered"])
        map_frame = action_model == "cardinal" or (view == "centered" and rng.random() < 0.5)
        edge_weights = any_weights(rng, shape)
        config = EnvConfig(
            source=Disorder(rng, shape, num_agents, num_goals=3 if on_target == "restart" else 1),
            action_model=action_model,
            collision_system=collision_system,
            on_target=on_target,
            max_steps=13,
            view_size=(int(rng.integers(1, shape[0] + 1)), shape[1] if k == 0 else int(rng.integers(1, shape[1] + 1))),
            view=str(view),
            frame="map" if map_frame else "egocentric",
            see_through_walls=bool(rng.random() < 0.5),
            channels=rng.permutation(list(CHANNELS)).tolist(),
            features=rng.permutation(list(FEATURES)).tolist(),
            num_last_actions=int(rng.integers(1, 4)),
            edge_weights=edge_weights,
            reward=any_reward(rng, edge_weights),
            delays=any_delays(rng),
        )
        lockstep = Lockstep(config, num_envs=2, seed=int(rng.integers(2**32)))
        lockstep.compare_observations()
        for _ in range(14):
            lockstep.step()
            lockstep.compare_observations()


@pytest.mark.parametrize("see_through_walls", [True, False])
@pytest.mark.parametrize("channel", CHANNELS)
def test_each_channel_alone(channel, see_through_walls):
    """Nothing is drawn that was not asked for, and walls hide whatever else there is."""
    observe_alone(channels=(channel,), see_through_walls=see_through_walls)


@pytest.mark.parametrize("feature", FEATURES)
def test_each_feature_alone(feature):
    """It has what it is computed from."""
    observe_alone(channels=("goal",), features=(feature,))


@pytest.mark.parametrize(
    ("shape", "view_size"), [((3, 10), (5, 5)), ((4, 3), (11, 9)), ((1, 6), (4, 30)), ((5, 2), (2, 12))]
)
@pytest.mark.parametrize("view", ["front", "centered"])
@pytest.mark.parametrize("action_model", ["rotate", "cardinal"])
def test_views_larger_than_the_map(shape, view_size, view, action_model):
    """Cells outside the map are obstacles."""
    rng = np.random.default_rng(9)
    config = EnvConfig(
        source=Disorder(rng, shape, 3, num_maps=2, density=0.1),
        max_steps=5,
        action_model=action_model,
        view_size=view_size,
        view="centered" if action_model == "cardinal" else view,
        see_through_walls=view == "front",
        channels=tuple(CHANNELS),
        features=tuple(FEATURES),
        edge_weights=any_weights(rng, shape),
    )
    lockstep = Lockstep(config, num_envs=2, seed=9)
    for _ in range(8):
        lockstep.compare_observations()
        lockstep.step()


def observe_alone(**keywords):
    source = Disorder(np.random.default_rng(5), (5, 5), 8, num_maps=2)
    config = EnvConfig(source=source, max_steps=5, delays=Delays(0.3, (1, 3)), **keywords)
    lockstep = Lockstep(config, num_envs=2, seed=5)
    for _ in range(8):
        lockstep.compare_observations()
        lockstep.step()


@pytest.mark.parametrize("action_model", ["rotate", "cardinal"])
def test_edges_of_large_maps(action_model, monkeypatch):
    """Where numbers of all edges would not fit into the cache, open edges are bits. Views are decoded in blocks."""
    monkeypatch.setattr(layers, "_CACHED_BYTES", 0)
    source = Disorder(np.random.default_rng(7), (8, 9), 35, num_maps=3)
    config = EnvConfig(source=source, max_steps=9, action_model=action_model, view_size=(5, 7))
    lockstep = Lockstep(config, num_envs=2, seed=7)
    assert lockstep.simulator._inputs.layers.edges.size == 0
    for _ in range(4):
        lockstep.compare_observations()
        lockstep.step()


@pytest.mark.parametrize(
    "width", [3, 4, 8, *(pytest.param(width, marks=pytest.mark.slow) for width in (5, 7, 12, 17, 23))]
)
def test_views_of_every_width(width):
    """Rows of views are copied in blocks of eight, four and one."""
    rng = np.random.default_rng(width)
    config = EnvConfig(
        source=Disorder(rng, (2, 25), 12, num_maps=1, density=0.3),
        view_size=(2, width),
        view="centered",
        action_model="cardinal",
        channels=("view", "edge_weights"),
        edge_weights="random",
    )
    Lockstep(config, num_envs=1, seed=width).compare_observations()


@pytest.mark.parametrize(COMBINATION_NAMES, COMBINATIONS)
def test_the_pettingzoo_environment_returns_the_same_values(action_model, collision_system, on_target):
    """`MapfEnv` gives each agent what is its own: few steps, all dictionaries."""
    rng = np.random.default_rng(200)
    source = Disorder(rng, (3, 4), 5, num_goals=2 if on_target == "restart" else 1)
    config = EnvConfig(
        source=source,
        action_model=action_model,
        collision_system=collision_system,
        on_target=on_target,
        max_steps=9,
        view_size=(3, 3),
        features=("goal_vector", "time"),
    )
    env = mapf_pz.MapfEnv(config)
    for seed in range(6):
        observations, infos = env.reset(seed)
        instance = source.drawn[-1]
        game = Reference(
            instance.grid.free.tolist(), instance.scenario.starts.tolist(), instance.headings.tolist(),
            instance.scenario.goals.tolist(), features=config.features, max_steps=9, view_size=(3, 3),
            view=config.resolved_view, frame=config.resolved_frame, action_model=action_model,
            collision_system=collision_system, on_target=on_target,
        )  # fmt: skip
        compare_dictionaries(game, env, observations, infos, env.agents)
        while env.agents:
            playing = env.agents
            actions = {agent: int(rng.choice(env.action_space(agent).n)) for agent in playing}
            game.step([actions.get(agent, 0) for agent in env.possible_agents])
            observations, rewards, terminations, truncations, infos = env.step(actions)
            compare_dictionaries(game, env, observations, infos, playing)
            for i, agent in enumerate(env.possible_agents):
                if agent in playing:
                    assert rewards[agent] == pytest.approx(game.rewards[i], abs=1e-5)
                    assert terminations[agent] is game.terminated[i]
                    assert truncations[agent] is (game.truncated and not game.terminated[i])
                    for name in ("arrived", "blocked", "moved"):
                        assert infos[agent][name] == getattr(game, name)[i]
                    assert infos[agent]["at_goal"] == game.on_goal_log[-1][i]
                    assert infos[agent]["arrivals"] == len(game.arrival_steps[i])
            assert rewards.keys() == terminations.keys() == truncations.keys() == set(playing)


def compare_dictionaries(game, env, observations, infos, playing):
    assert list(observations) == list(infos) == playing
    assert env.positions.tolist() == list(map(list, game.positions))
    assert env.goals.tolist() == list(map(list, game.goals))
    for i, agent in enumerate(env.possible_agents):
        if agent in playing:
            seen = observations[agent]
            compare_observation(game, i, seen["image"], seen["features"], infos[agent]["action_mask"])
