"""Batched environments: one simulator under the PettingZoo, TorchRL and Gymnasium interfaces."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from contextlib import nullcontext
from functools import partial
from typing import NamedTuple

import numpy as np

from mapf_pz._internal.arrays import Bools, Floats, Ints, coordinates
from mapf_pz._internal.compilation.dry_run import compiling_together
from mapf_pz._internal.jit import numba_config
from mapf_pz.guidance import GuidanceGraph
from mapf_pz.guidance.library import random_share
from mapf_pz.instances.instance import Grid, Instance, Scenario
from mapf_pz.simulator.config import EnvConfig
from mapf_pz.simulator.episode import EpisodeLoader, shares_map
from mapf_pz.simulator.kernels import world
from mapf_pz.simulator.kernels.conflict import COLLISION_SYSTEMS, write_masks
from mapf_pz.simulator.kernels.cost_around import CostAround
from mapf_pz.simulator.kernels.cost_bfs import FEWEST_GOALS, LANES
from mapf_pz.simulator.kernels.cost_lookup import costs_at
from mapf_pz.simulator.kernels.cost_tables import CostTables
from mapf_pz.simulator.kernels.delay import delay_rules, delayed_agents
from mapf_pz.simulator.kernels.observation.inputs import ObservationInputs
from mapf_pz.simulator.kernels.observation.layers import allocate_layers, allocate_origins
from mapf_pz.simulator.kernels.path_length import shortest_lengths
from mapf_pz.simulator.kernels.reward import reward_terms
from mapf_pz.simulator.kernels.state import (
    WAIT_WEIGHT,
    CostToGo,
    PlanningView,
    Rules,
    allocate_state,
    planning_view_of,
    reset,
)
from mapf_pz.simulator.kernels.step import ON_TARGET, step
from mapf_pz.simulator.metrics import EpisodeRecord, WeightedCosts, episode_metrics, metric_names
from mapf_pz.simulator.observation import ObservationLayout
from mapf_pz.simulator.observer import Observer
from mapf_pz.simulator.small_config import small_config
from mapf_pz.simulator.source import goals_per_agent, make_source
from mapf_pz.simulator.states import FIELDS, States
from mapf_pz.simulator.transition import Transition

MAX_OBSERVATION_BYTES = 2**32
"""Maximum size of the observations and past actions of all agents in a batch."""
NO_GRAPHS: Mapping[int, GuidanceGraph] = {}
MOST_DIFFERENT = LANES + FEWEST_GOALS
"""Number of goals on a map from which on no other kernels are called."""


class Observation(NamedTuple):
    """What all agents observe; the arrays are the caller's own."""

    image: Floats  # (B, N, *layout.image_shape) float32
    features: Floats  # (B, N, layout.num_features) float32
    action_mask: Ints  # (B, N, A) int8


class Simulator:
    """B environments with one configuration, stepped together.

    Row `b` of a batch that is seeded with `s` is the single environment seeded with `s + b`, to the bit.
    """

    def __init__(self, config: EnvConfig, num_envs: int = 1, num_threads: int = 1) -> None:
        """Allocate all arrays.

        Args:
            config: The configuration of all B environments.
            num_envs: B, at least 1.
            num_threads: Number of threads that step and observe, at least 1.

        Raises:
            ValueError: A number is too small, or the configuration and the map do not fit.
        """
        for name, value in (("num_envs", num_envs), ("num_threads", num_threads)):
            if value < 1:
                raise ValueError(f"{name}={value}: expected a whole number, 1 or more")
        self.config = config
        self.source = make_source(config)
        self.num_envs = num_envs
        self.num_agents = self.source.num_agents
        self.shape = self.source.shape
        self.layout = ObservationLayout(config)
        self.num_actions = self.layout.num_actions
        self._check_size()
        self._avoids_agents = config.around_agents_at_goals and config.on_target == "nothing"
        self.needs_cost_to_go = (
            self.layout.needs_cost_to_go or config.reward_config.progress != 0 or self._avoids_agents
        )
        self._has_weights = config.edge_weights != "uniform"
        self._reward_function = config.reward_function
        self._num_threads = min(num_threads, numba_config.NUMBA_NUM_THREADS)
        self._num_headings = 1 if config.action_model == "cardinal" else 4
        self.delays = config.delays_of(self.source)
        """The delays of the agents; None if there are none."""
        self._delay_rules = delay_rules(self.delays)
        self._allocate()
        rules = Rules(
            cardinal=config.action_model == "cardinal",
            collision=COLLISION_SYSTEMS[config.collision_system],
            on_target=ON_TARGET[config.on_target],
            max_steps=config.max_steps,
        )
        terms = reward_terms(config.reward_config)
        each = (num_envs, self.num_agents)
        self._mask_shape = (*each, self.num_actions)
        self._is_loaded = False
        """Whether the kernels of steps are loaded."""
        self._small_episode = partial(run_small_episode, config, num_envs, self.num_agents, self._num_threads)
        fields = tuple(map(tuple, (rules, self._delay_rules, terms, self.world, self.tables.arrays, self.state)))
        self._step = step.bind(self._num_threads, fields, (np.empty(each, np.int64),))
        shown = (rules.cardinal, self.world.leads_to, self.state.map, self.state.agents)
        self._write_masks = write_masks.bind(self._num_threads, shown, (np.empty(self._mask_shape, np.int8),))

    def _check_size(self) -> None:
        """Raise `ValueError` if the observations and past actions of all agents would take too much memory."""
        numbers = math.prod(self.layout.image_shape) + self.layout.num_features
        each = 4 * numbers + 2 * self.config.num_last_actions
        size = each * self.num_envs * self.num_agents
        if size > MAX_OBSERVATION_BYTES:
            raise ValueError(
                f"observations of {self.num_envs} x {self.num_agents} agents, {each} bytes each: expected at most "
                f"{MAX_OBSERVATION_BYTES} bytes together, got {size}"
            )

    def _allocate(self) -> None:
        config, shape, view_shape = self.config, self.shape, self.layout.view_shape()
        unit_weights = config.edge_weights == "uniform"
        num_maps = 1 if shares_map(config, self.source) else self.num_envs
        self.world = world.allocate(num_maps, shape)
        self.tables = CostTables(
            self.world,
            self._num_headings,
            self.num_envs * self.num_agents,
            unit_weights and not self._avoids_agents,
            config.distance_bytes,
            self._num_threads,
            num_own=self.num_envs * self.num_agents if self._avoids_agents else 0,
        )
        self.state = allocate_state(
            self.num_envs, self.num_agents, shape[0] * shape[1], goals_per_agent(config), config.num_last_actions
        )
        self._around: CostAround | None = None
        if self._avoids_agents:
            self._around = CostAround(self.world, self.tables, self.state, self._num_threads)
        layers = allocate_layers(view_shape, shape, num_maps, self._num_threads, self.layout.shows_edges, unit_weights)
        self._inputs = ObservationInputs(
            view_shape,
            layers,
            allocate_origins(self.num_envs, self.num_agents),
            self.world,
            self.tables.arrays,
            self.state,
            has_distances=self.layout.needs_cost_to_go,
            cardinal=config.action_model == "cardinal",
            max_steps=config.max_steps,
            longest_delay=self._delay_rules.largest,
            num_threads=self._num_threads,
        )
        self._observer = Observer(config, self.layout, self._inputs)
        self._loader = EpisodeLoader(config, self.source, self.world, layers, self.tables, self.state)

    def reset(
        self,
        envs: Iterable[int] | None = None,
        seeds: Mapping[int, int] | None = None,
        instances: Mapping[int, Instance] | None = None,
    ) -> None:
        """Start new episodes in the environments `envs`.

        Args:
            envs: Indices of environments; None: all.
            seeds: Seeds by environment; the others continue with their random generators.
            instances: Instances by environment; the others sample theirs from the source.

        Raises:
            ValueError: A seed is not a whole number, 0 or more; an instance does not fit, or some of its goals cannot
                be reached.
        """
        chosen = list(range(self.num_envs) if envs is None else envs)
        if not chosen:
            return
        with nullcontext() if self._is_loaded else compiling_together(self._small_episode):
            self._start(chosen, seeds or {}, instances or {})

    def _start(
        self,
        chosen: list[int],
        seeds: Mapping[int, int],
        instances: Mapping[int, Instance],
        graphs: Mapping[int, GuidanceGraph] = NO_GRAPHS,
    ) -> None:
        """Start new episodes in the environments `chosen`."""
        self._loader.load(chosen, seeds, instances, graphs)
        reset(np.array(chosen, np.int64), self._loader.starts, self._loader.headings, self.state)
        if self._around is not None:
            self._around.reset(chosen)
        if self.needs_cost_to_go:
            self._assign_cost_to_go()
        self._observer.reset(chosen)

    def states(self) -> States:
        """Return the states of all B episodes, in new arrays."""
        agents, envs = self.state.agents, range(self.num_envs)
        maps = self.state.map if random_share(self.config.edge_weights) else self.state.map[:0]
        weight = self.world.weight[maps, :, :-1]
        return States(
            np.stack([self.grid(b).free for b in envs]),
            weight.reshape(self.num_envs, -1, *self.shape),
            self.state.time.copy(),
            np.stack([agents[name].astype(np.int32) for name in FIELDS], axis=-1),
            self.state.history.copy(),
        )

    def restore(self, states: States) -> None:
        """Continue from the states of B episodes, whose agents have no other goals: they observe what they did then.

        Previous frames are those of the states, and metrics count from here. Raises `ValueError` if the maps or the
        agents do not fit, or if agents disappear at their goals.
        """
        if self.config.on_target == "finish":
            raise ValueError("restore: expected agents that stay on the map")
        envs = range(self.num_envs)
        graphs = {b: GuidanceGraph(states.weight[b, :4], states.weight[b, 4]) for b in envs if states.weight.size}
        self._start(list(envs), {}, {b: self._instance_of(states, b) for b in envs}, graphs)
        self.state.time[:], self.state.history[:] = states.time, states.history
        for name, values in zip(FIELDS, np.moveaxis(states.agents, -1, 0), strict=True):
            self.state.agents[name] = values
        self._observer.reset(range(self.num_envs))

    def _instance_of(self, states: States, b: int) -> Instance:
        """Return the instance that starts in a state."""
        shared = self.source.grid
        grid = Grid(states.free[b]) if shared is None else shared
        cells, goals, headings, *_ = np.moveaxis(states.agents[b], -1, 0)
        return Instance(grid, Scenario(self.coordinates(cells), self.coordinates(goals)), headings, self.delays)

    def step(self, actions: Ints) -> None:
        """Take one step in all environments: `actions` (B, N) integers, each in 0 to A - 1 (which is not checked here).

        Raises `ValueError` for another shape, and `TypeError` for actions that are not integers.
        """
        actions = actions.astype(np.int64, order="C", casting="same_kind", copy=False)
        if actions.shape != self.state.agents.shape:
            raise ValueError(f"actions: expected the shape {self.state.agents.shape}, got {actions.shape}")
        if not self._is_loaded:
            self._load()
        if self.delays is not None:
            actions = actions.copy()  # since the kernel replaces those of delayed agents
        self._step(actions)
        if self._reward_function is not None:
            self._set_rewards(self._reward_function(self._transition(actions)))
        if self._around is not None:
            self._around.update()
        elif self.needs_cost_to_go and self.config.on_target == "restart":
            self._assign_cost_to_go()
        self._observer.step()

    def _load(self) -> None:
        """Load the kernels of steps. If they must be compiled, so are all others that episodes call."""
        with compiling_together(self._small_episode):
            self._step.load()
        self._is_loaded = True

    def _assign_cost_to_go(self) -> None:
        """Set every agent's table of the cost to go."""
        if self._around is None:
            self.tables.assign(self.state.map, self.state.agents)
        else:
            self.require_cost_to_go()
            self._around.update()

    def _transition(self, actions: Ints) -> Transition:
        return Transition(self.state.agents, actions, self.state.time, self.shape, self._cost_to_go)

    def _set_rewards(self, rewards: object) -> None:
        """Set the rewards that a function has computed; raise `ValueError` unless they are finite numbers (B, N)."""
        values, agents = np.asarray(rewards), self.state.agents
        if values.shape != agents.shape or not np.issubdtype(values.dtype, np.number) or not np.isfinite(values).all():
            expected = f"finite numbers of the shape {agents.shape}"
            raise ValueError(f"reward: expected {expected} from the function, got {values.dtype} {values.shape}")
        agents["reward"] = np.where(agents["was_active"], values, 0)

    @property
    def agents(self) -> np.ndarray:
        """(B, N) records `AGENT` (`mapf_pz.simulator.kernels.state`), not to be written to."""
        return self.state.agents

    @property
    def steps(self) -> Ints:
        """(B,) int32: steps taken in the episode of each environment."""
        return self.state.time

    @property
    def terminated(self) -> Bools:
        """(B,) bool: which episodes are over because all agents have finished."""
        return self.state.terminated

    @property
    def truncated(self) -> Bools:
        """(B,) bool: which episodes are over because of the time limit."""
        return self.state.truncated

    @property
    def over(self) -> Bools:
        """(B,) bool: which episodes are over."""
        return np.logical_or(self.terminated, self.truncated)

    def observe(self) -> Observation:
        """Return what all agents observe now, in new arrays; agents that have disappeared observe zeros."""
        if not self._is_loaded:
            self._load()
        image, features = self._observer.observe()
        action_mask = np.empty(self._mask_shape, np.int8)
        self._write_masks(action_mask)
        return Observation(image, features, action_mask)

    def require_cost_to_go(self) -> None:
        """Compute the cost to go to every agent's goal where it is not known yet."""
        self.tables.require(self.state.map, self.state.agents["goal"])

    def prepare_cost_to_go(self, num_goals: int) -> None:
        """Compute the cost to go to each agent's first `num_goals` goals, which together is faster than one by one.

        Does nothing if the tables would need more memory than there is.
        """
        goals = self.state.goals[:, :, :num_goals].reshape(self.num_envs, -1)
        if self.tables.has_room_for(self.state.map, goals):
            self.tables.require(self.state.map, goals)

    def planning_view(self, b: int = 0) -> PlanningView:
        """Return environment `b` as planners read it, with the cost to go to every agent's goal."""
        self.require_cost_to_go()
        return planning_view_of(self.world, self.tables.arrays, self.state, b)

    def cost_to_go(self) -> Floats:
        """Return the cost to go (B, N) float32 of all agents; `inf` where there is no path."""
        agents = self.state.agents
        return self._cost_to_go(agents["goal"], agents["cell"], agents["heading"])

    def costs_to(self, goals: Ints, b: int = 0) -> Floats:
        """Return the cost to go (N, K) float32 of each agent in environment `b` to `goals` (K, 2), [row, col]."""
        agents, cells = self.state.agents[b], np.asarray(goals) @ (self.shape[1], 1)
        self.tables.require(self.state.map[b : b + 1], np.concatenate([agents["goal"], cells])[None].astype(np.int32))
        slot, *to_go = self.tables.arrays
        tables = np.tile(slot[self.state.map[b], cells], len(agents))
        starts = (np.repeat(agents[name], len(cells)) for name in ("cell", "heading"))
        return costs_at(CostToGo(*to_go), tables, *starts).reshape(len(agents), len(cells))

    def set_goals(self, goals: Ints, b: int = 0) -> None:
        """Set the goals (N, 2), [row, col], of the agents in environment `b`; they keep them after arrivals."""
        cells = np.asarray(goals) @ (self.shape[1], 1)
        self.state.agents[b]["goal"] = cells
        self.state.goals[b] = cells[:, None]
        if self._around is not None:
            self._around.reset([b])
        if self.needs_cost_to_go:
            self._assign_cost_to_go()

    def _cost_to_go(self, goals: Ints, cells: Ints, headings: Ints) -> Floats:
        """Return the cost to go (B, N) float32 from `cells` and `headings` (B, N) to `goals` (B, N)."""
        slot, *to_go = self.tables.arrays
        if self._around is None:
            self.tables.require(self.state.map, goals)
            slots = slot[self.state.map[:, None], goals]
        else:
            slots = self.state.agents["table"]
        flat = (array.reshape(-1) for array in (slots, cells, headings))
        return costs_at(CostToGo(*to_go), *flat).reshape(goals.shape)

    def grid(self, b: int) -> Grid:
        """Return the map of environment `b`; raises `RuntimeError` before the first reset."""
        return self._loader.grid(b)

    def leads_to(self, b: int) -> Ints:
        """Return the cell (4, C + 1) int32 that a move in each direction ends in, on the map of environment `b`."""
        return self.world.leads_to[self.state.map[b]]

    def guidance(self, b: int) -> GuidanceGraph:
        """Return the guidance graph of environment `b`; moves that the map does not allow are `inf`."""
        weight = self.world.weight[self.state.map[b], :, :-1].reshape(-1, *self.shape)
        return GuidanceGraph(weight[:WAIT_WEIGHT], weight[WAIT_WEIGHT])

    def mean_weight(self, b: int) -> float:
        """Return the mean of the finite weights of moving and waiting on the map of environment `b`."""
        return float(self.world.mean_weight[self.state.map[b]])

    @property
    def metric_names(self) -> tuple[str, ...]:
        """The names of the metrics of every episode."""
        return metric_names(self.config.on_target, self._has_weights, self.delays is not None)

    def metrics(self, b: int) -> dict[str, float]:
        """Return the metrics of environment `b` as if its episode ended now: see `mapf_pz.simulator.metrics`.

        With other edge weights than `uniform`, the cost to go is computed unless it is known: raises `MemoryError` if
        `distance_bytes` does not allow it.
        """
        agents, one_goal = self.state.agents[b], self.config.on_target != "restart"
        return episode_metrics(
            EpisodeRecord(
                on_target=self.config.on_target,
                num_steps=int(self.state.time[b]),
                max_steps=self.config.max_steps,
                resting_since=agents["resting_since"],
                arrivals=agents["arrivals"],
                goal_counts=self._loader.goal_counts[b],
                shortest=self._shortest_lengths(b) if one_goal else np.empty(0, np.int32),
                weighted=self._weighted_costs(b) if one_goal and self._has_weights else None,
                delayed=self._delayed(b),
            )
        )

    def _delayed(self, b: int) -> Bools | None:
        """Return in which steps of its episode which agents of environment `b` were delayed; None without delays."""
        if self.delays is None:
            return None
        num_steps, key = int(self.state.time[b]), int(self.state.delay_key[b])
        return delayed_agents(self._delay_rules, key, num_steps, self.num_agents)

    def _weighted_costs(self, b: int) -> WeightedCosts:
        """Return the costs of the agents of environment `b` in edge weights."""
        m, starts, goals = self.state.map[b], self._loader.starts[b], self.state.goals[b, :, 0]
        self.tables.require(self.state.map[b : b + 1], goals[None])
        slot, *to_go = self.tables.arrays
        alone = costs_at(CostToGo(*to_go), slot[m, goals], starts, self._loader.headings[b])
        cheapest = np.where(starts == goals, self.world.weight[m, WAIT_WEIGHT, starts], alone)
        return WeightedCosts(self.state.agents["weighted_cost"][b], cheapest)

    def _shortest_lengths(self, b: int) -> Ints:
        """Return the length in steps (N,) int32 of each agent's shortest path to its first goal; -1: there is none."""
        m, starts, headings = int(self.state.map[b]), self._loader.starts[b], self._loader.headings[b]
        goals = self.state.goals[b, :, 0]
        slot, *to_go = self.tables.arrays
        slots = slot[m, goals]
        if not self._has_weights and (slots >= 0).all():  # their tables are known already
            costs = costs_at(CostToGo(*to_go), slots, starts, headings)
            return np.where(np.isinf(costs), -1, costs).astype(np.int32)
        return shortest_lengths(self.world, m, starts, headings, goals, self._num_headings)

    def positions(self, b: int) -> Ints:
        """Return where the agents of environment `b` are: (N, 2) int, [row, col]."""
        return self.coordinates(self.state.agents["cell"][b])

    def goals(self, b: int) -> Ints:
        """Return the current goals of the agents of environment `b`: (N, 2) int, [row, col]."""
        return self.coordinates(self.state.agents["goal"][b])

    def coordinates(self, cells: Ints) -> Ints:
        """Return [row, col] (..., 2) int64 of cell numbers."""
        return coordinates(cells, self.shape[1])


def run_small_episode(config: EnvConfig, num_envs: int, num_agents: int, num_threads: int) -> None:
    """Run an episode that calls the kernels of such a simulator; more environments and agents call no others."""
    small = Simulator(small_config(config, min(num_agents, MOST_DIFFERENT)), min(num_envs, 2), num_threads)
    small.reset(seeds=dict.fromkeys(range(small.num_envs), 0))
    while not small.over.all():
        small.observe()
        small.step(np.zeros(small.state.agents.shape, np.int64))
    small.metrics(0)
