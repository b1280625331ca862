"""The simulator: B environments of N agents in preallocated arrays. Both environments stand on it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mapf_pz.actions import Heading
from mapf_pz.arrays import Bools, Floats, Ints
from mapf_pz.config import EnvConfig, HeadingName, RewardConfig, WeightsName
from mapf_pz.core import world
from mapf_pz.core.action_mask import write_masks
from mapf_pz.core.conflict import COLLISION_SYSTEMS
from mapf_pz.core.cost_tables import DistanceTables
from mapf_pz.core.cost_to_go import shortest_steps
from mapf_pz.core.jit import numba_config
from mapf_pz.core.observation import layers as layers
from mapf_pz.core.observation.inputs import ObservationInputs, allocate_scratch
from mapf_pz.core.reset import begin
from mapf_pz.core.state import PlanningView, Rules, allocate_state
from mapf_pz.core.step import ON_TARGET, step
from mapf_pz.guidance import GuidanceGraph
from mapf_pz.instance import Grid, Instance
from mapf_pz.instances.configured import goals_per_agent, make_source
from mapf_pz.instances.place import check_reachable, place
from mapf_pz.metrics import EpisodeRecord, episode_metrics
from mapf_pz.observation import ObservationLayout


class Observation(NamedTuple):
    """What all agents observe; the arrays are the caller's own."""

    image: Floats  # (B, N, K, h, w) float32
    features: Floats  # (B, N, F) float32
    action_mask: Ints  # (B, N, A) int8


class Simulator:
    """B environments with one configuration, stepped together.

    Row `b` of a batch that is seeded with `s` is the single environment seeded with `s + b`, to the bit.
    """

    def __init__(self, config: EnvConfig, num_envs: int = 1, num_threads: int = 1) -> None:
        """Allocate everything; raises `ValueError` where the configuration and the map do not fit."""
        for name, value in (("num_envs", num_envs), ("num_threads", num_threads)):
            if value < 1:
                raise ValueError(f"{name}={value}: expected a whole number, 1 or more")
        self.config = config
        self.source = make_source(config)
        self.num_envs = num_envs
        self.num_agents = self.source.num_agents
        self.shape = self.source.shape
        _check_headings(config.initial_heading, self.num_agents)
        self._graph = _common_graph(config.edge_weights, self.shape)
        self.layout = ObservationLayout(config, self.shape)
        self.num_actions = self.layout.num_actions
        self.needs_distances = self.layout.needs_distances or config.rewards.progress != 0
        self._num_threads = min(num_threads, numba_config.NUMBA_NUM_THREADS)
        self._one_map = self.source.grid is not None and config.edge_weights != "random"
        self._grids: list[Grid | None] = [None] * (1 if self._one_map else num_envs)
        self.world = world.allocate(len(self._grids), self.shape)
        self._num_headings = 1 if config.action_model == "cardinal" else 4
        num_goals = num_envs * self.num_agents
        self.tables = DistanceTables(
            self.world, self._num_headings, num_goals, config.distance_bytes, self._num_threads
        )
        self.state = allocate_state(
            num_envs, self.num_agents, self.shape[0] * self.shape[1], goals_per_agent(config), config.num_last_actions
        )
        self._starts = np.zeros((num_envs, self.num_agents), np.int32)
        self._goal_counts = np.ones((num_envs, self.num_agents), np.int32)
        self._start_headings = np.zeros((num_envs, self.num_agents), np.int8)
        self._rules = _rules(config, config.rewards)
        view_shape, with_edges = self.layout.view_shape(), "edge_weights" in config.channels
        self._inputs = ObservationInputs(
            view_shape=view_shape,
            rows=tuple(range(view_shape.height)),
            columns=tuple(range(view_shape.width)),
            layers=layers.allocate_layers(view_shape, self.shape, len(self._grids), self._num_threads, with_edges),
            origins=layers.allocate_origins(num_envs, self.num_agents),
            scratch=allocate_scratch(self._num_threads, self.num_agents, view_shape.height * view_shape.width),
            world=self.world,
            distances=self.tables.arrays,
            state=self.state,
            cardinal=config.action_model == "cardinal",
            max_steps=config.max_steps,
        )
        self._rngs = [np.random.default_rng() for _ in range(num_envs)]

    def reset(
        self,
        envs: Iterable[int] | None = None,
        seeds: Mapping[int, int] | None = None,
        instances: Mapping[int, Instance] | None = None,
    ) -> None:
        """Begin new episodes in the environments `envs` (default: all).

        Args:
            envs: which of the B environments.
            seeds: for environments that shall be seeded afresh; the others go on with their own generators.
            instances: for environments that shall not draw their instance from the source.

        Raises `ValueError` for an instance that does not fit, or whose goals cannot all be reached.
        """
        chosen = list(range(self.num_envs) if envs is None else envs)
        for b in chosen:
            if seeds is not None and b in seeds:
                self._rngs[b] = np.random.default_rng(seeds[b])
        drawn = [self._instance(b, instances or {}) for b in chosen]
        for b, instance in zip(chosen, drawn, strict=True):
            self._set(b, instance)
        begin(np.array(chosen, np.int64), self._starts, self._start_headings, self.state)
        if self.needs_distances:
            self.require_distances()

    def step(self, actions: Ints) -> None:
        """Take one step in all environments: `actions` (B, N) int64, each in 0 to A - 1 (not checked here)."""
        step(self._num_threads, self._rules, self.world, self.tables.arrays, self.state, actions)
        if self.needs_distances and self.config.on_target == "restart":
            self.require_distances()

    @property
    def over(self) -> Bools:
        """(B,) bool: which episodes are over."""
        return np.logical_or(self.state.terminated, self.state.truncated)

    def observe(self) -> Observation:
        """Return what all agents observe now, in new arrays; agents that have disappeared observe zeros."""
        each = (self.num_envs, self.num_agents)
        channels, height, width = self.layout.image_shape
        image = np.empty((*each, channels, height * width), np.float32)
        features = np.empty((*each, self.layout.num_features), np.float32)
        mask = np.empty((*each, self.num_actions), np.int8)
        self.layout.write(self._num_threads, self._inputs, image, features)
        write_masks(
            self._num_threads, self._inputs.cardinal, self.world.leads_to, self.state.map, self.state.agents, mask
        )
        return Observation(image.reshape(*each, channels, height, width), features, mask)

    def require_distances(self) -> None:
        """Make sure that the cost to go to every agent's goal is known."""
        self.tables.require(self.state.map, self.state.agents["goal"])

    def planning_view(self, b: int = 0) -> PlanningView:
        """Return environment `b` as planners look at it, with the cost to go to every agent's goal."""
        self.require_distances()
        m = self.state.map[b]
        world, tables, state = self.world, self.tables.arrays, self.state
        return PlanningView(
            world.leads_to[m], world.weight[m], tables.slot[m], tables.to_go, state.agents[b], state.occupant[b]
        )

    def distance_to_go(self, b: int) -> Floats:
        """Return the cost to go (N,) float32 of each agent in environment `b`; `inf` where there is no path."""
        planning_view = self.planning_view(b)
        agents = planning_view.agents
        return planning_view.to_go[
            planning_view.slot[agents["goal"]], agents["cell"], agents["heading"] % self._num_headings
        ]

    def grid(self, b: int) -> Grid:
        """Return the map of environment `b`; raises `RuntimeError` before the first reset."""
        grid = self._grids[self.state.map[b]]
        if grid is None:
            raise RuntimeError("call reset() first")
        return grid

    def move_weights(self, b: int) -> Floats:
        """Return what leaving each cell of environment `b` in each direction costs, (4, H, W); `inf` where blocked."""
        return self.world.weight[self.state.map[b], :4, :-1].reshape(4, *self.shape)

    def metrics(self, b: int) -> dict[str, float]:
        """Return the metrics of environment `b` as if its episode ended now: see `mapf_pz.metrics`."""
        agents = self.state.agents[b]
        return episode_metrics(
            EpisodeRecord(
                on_target=self.config.on_target,
                num_steps=int(self.state.time[b]),
                max_steps=self.config.max_steps,
                resting_since=agents["resting_since"],
                arrivals=agents["arrivals"],
                goal_counts=self._goal_counts[b],
                shortest=self._shortest_steps(b),
            )
        )

    def positions(self, b: int) -> Ints:
        """Return where the agents of environment `b` are: (N, 2) int, [row, col]."""
        return self.places(self.state.agents["cell"][b])

    def goals(self, b: int) -> Ints:
        """Return the present goals of the agents of environment `b`: (N, 2) int, [row, col]."""
        return self.places(self.state.agents["goal"][b])

    def places(self, cells: Ints) -> Ints:
        """Return the cells of these numbers as (..., 2) int, [row, col]."""
        places = np.empty((*cells.shape, 2), np.int64)
        np.divmod(cells, self.shape[1], out=(places[..., 0], places[..., 1]))
        return places

    def _shortest_steps(self, b: int) -> Ints:
        """Return the length (N,) of each agent's shortest path from its start to its first goal."""
        cells = self.world.obstacle.shape[1]
        to_go = np.empty((cells, self._num_headings), np.float32)
        scratch = np.empty((2, cells * self._num_headings), np.int32)
        lengths = np.empty(self.num_agents, np.int32)
        order = np.argsort(self.state.goals[b, :, 0], kind="stable")
        starts, headings = self._starts[b, order], self._start_headings[b, order]
        goals = self.state.goals[b, order, 0]
        shortest_steps(self.world, int(self.state.map[b]), starts, headings, goals, to_go, scratch, lengths)
        return lengths[np.argsort(order)]

    def _instance(self, b: int, given: Mapping[int, Instance]) -> Instance:
        """Return the instance for row `b`, as it is given or else drawn."""
        if b not in given:
            instance = self.source.sample(self._rngs[b])
        else:
            instance = given[b]
            check_reachable(instance)
        self._check(instance)
        return instance

    def _set(self, b: int, instance: Instance) -> None:
        """Note `instance` for row `b`."""
        rng = self._rngs[b]
        m = 0 if self._one_map else b
        self._set_map(m, instance.grid, rng)
        self.state.map[b] = m
        self._start_headings[b] = self._headings(instance, rng)
        self._starts[b] = instance.start_cells
        self.state.goals[b], self._goal_counts[b] = self._goals(instance, rng)

    def _check(self, instance: Instance) -> None:
        expected = (self.num_agents, self.shape)
        if (instance.num_agents, instance.grid.shape) != expected:
            raise ValueError(
                f"instance of {instance.num_agents} agents on {instance.grid.shape} cells: this environment has "
                f"{self.num_agents} agents on {self.shape} cells"
            )
        if self._one_map and self.num_envs > 1 and instance.grid is not self.source.grid:
            raise ValueError("instance on another map: this batch shares one map, use a source of several maps")

    def _set_map(self, m: int, grid: Grid, rng: np.random.Generator) -> None:
        if grid is self._grids[m] and self.config.edge_weights != "random":
            return
        self._grids[m] = grid
        world.set_map(self.world, m, grid.free, self._guidance(grid, rng))
        self._draw_layers(m)
        self.tables.forget(m)

    def _draw_layers(self, m: int) -> None:
        """Draw map `m`, in every copy of its planes."""
        map_layers = self._inputs.layers
        for planes in map_layers.planes if map_layers.shared else map_layers.planes[m : m + 1]:
            layers.draw_map(planes, map_layers, self.world.weight[m], self.world.obstacle[m])

    def _guidance(self, grid: Grid, rng: np.random.Generator) -> GuidanceGraph:
        return GuidanceGraph.random(grid.free, rng) if self._graph is None else self._graph

    def _goals(self, instance: Instance, rng: np.random.Generator) -> tuple[Ints, Ints]:
        """Return each agent's goals in order, (N, G), and how many of them come before its sequence repeats, (N,).

        Where an instance has one goal per agent and more are needed, the others are sampled.
        """
        goals, counts = instance.goal_cells, instance.scenario.goal_counts
        needed = self.state.goals.shape[2]
        if goals.shape[1] == 1 and needed > 1:
            drawn = place(instance.grid, self.num_agents, rng, goals_per_agent=needed)
            goals = np.concatenate([goals, Instance(instance.grid, drawn).goal_cells[:, 1:]], axis=1)
            counts = None
        if counts is None:
            counts = np.full(self.num_agents, goals.shape[1], np.int32)
        return np.take_along_axis(goals, np.arange(needed) % counts[:, None], axis=1), counts

    def _headings(self, instance: Instance, rng: np.random.Generator) -> Ints:
        initial = self.config.initial_heading
        if self.config.action_model == "cardinal":
            return np.full(self.num_agents, Heading.NORTH)
        if instance.headings is not None:
            return instance.headings
        if not isinstance(initial, str):
            return np.asarray(initial)
        if initial == "east":
            return np.full(self.num_agents, Heading.EAST)
        return rng.integers(4, size=self.num_agents)


def _check_headings(headings: HeadingName | ArrayLike, num_agents: int) -> None:
    """Raise `ValueError` for headings that are neither a name nor one for each agent."""
    if not isinstance(headings, str) and np.shape(headings) != (num_agents,):
        raise ValueError(f"initial_heading: expected 'random', 'east' or {num_agents} numbers 0 to 3")


def _common_graph(weights: WeightsName | GuidanceGraph, shape: tuple[int, int]) -> GuidanceGraph | None:
    """Return the guidance graph of all maps of `shape` (H, W); None: each has its own."""
    if isinstance(weights, GuidanceGraph):
        if weights.shape != shape:
            raise ValueError(f"edge_weights of shape {weights.shape}: the map's shape is {shape}")
        return weights
    # Weights do not depend on obstacles; edges into them are blocked when a map is laid out.
    make = {"uniform": GuidanceGraph.uniform, "crisscross": GuidanceGraph.crisscross}.get(weights)
    return None if make is None else make(np.ones(shape, np.bool_))


def _rules(config: EnvConfig, rewards: RewardConfig) -> Rules:
    return Rules(
        cardinal=config.action_model == "cardinal",
        collision=COLLISION_SYSTEMS[config.collision_system],
        on_target=ON_TARGET[config.on_target],
        max_steps=config.max_steps,
        forward=float(rewards.forward),
        rotate=float(rewards.rotate),
        wait=float(rewards.wait),
        goal=float(rewards.goal),
        pay_blocked_forward=bool(rewards.pay_blocked_forward),
        progress=float(rewards.progress),
        step_cost=float(rewards.step_cost),
        blocked=float(rewards.blocked),
        team_goal=float(rewards.team_goal),
        share=float(rewards.share),
        share_radius=int(rewards.share_radius),
    )
