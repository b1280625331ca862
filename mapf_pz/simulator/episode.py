"""Episodes: instances, guidance graphs and headings are sampled and written to the simulator's arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from mapf_pz._internal.arrays import Ints
from mapf_pz.guidance import GuidanceGraph, open_edges
from mapf_pz.guidance.library import EdgeWeights, fits_any_map, guidance_graph, random_share
from mapf_pz.instances.heading import Heading
from mapf_pz.instances.instance import Grid, HeadingName, Instance, InstanceSource
from mapf_pz.instances.place import check_reachable, place
from mapf_pz.simulator.config import EnvConfig, check_whole
from mapf_pz.simulator.kernels import world
from mapf_pz.simulator.kernels.cost_tables import CostTables
from mapf_pz.simulator.kernels.observation.layers import MapLayers, draw_map
from mapf_pz.simulator.kernels.state import State, World
from mapf_pz.simulator.seeds import MAX_SEED


def shares_map(config: EnvConfig, source: InstanceSource) -> bool:
    """Whether all environments and episodes have the same map and the same guidance graph."""
    return source.grid is not None and not random_share(config.edge_weights)


class EpisodeLoader:
    """Samples the instance of each episode and writes it to the simulator's arrays."""

    def __init__(
        self,
        config: EnvConfig,
        source: InstanceSource,
        world: World,
        layers: MapLayers,
        tables: CostTables,
        state: State,
    ) -> None:
        """Keep references to the arrays of B environments; raises `ValueError` where `config` does not fit `source`."""
        num_envs, num_agents = state.agents.shape
        _check_headings(config.initial_heading, num_agents)
        self._config = config
        self._source = source
        self._world = world
        self._layers = layers
        self._tables = tables
        self._state = state
        self._delays = config.delays_of(source)
        self._shares_map = shares_map(config, source)
        self._graph = _common_graph(config.edge_weights, source)
        self._grids: list[Grid | None] = [None] * len(world.obstacle)
        self._rngs = [np.random.default_rng() for _ in range(num_envs)]
        self.starts = np.zeros((num_envs, num_agents), np.int32)
        """(B, N) cells where the agents of the current episodes started."""
        self.headings = np.zeros((num_envs, num_agents), np.int8)
        """(B, N) headings with which they started."""
        self.goal_counts = np.ones((num_envs, num_agents), np.int32)
        """(B, N) number of goals of each agent before its sequence repeats."""

    def grid(self, b: int) -> Grid:
        """Return the map of environment `b`; raises `RuntimeError` before the first episode."""
        grid = self._grids[self._state.map[b]]
        if grid is None:
            raise RuntimeError("call reset() first")
        return grid

    def load(
        self,
        envs: Sequence[int],
        seeds: Mapping[int, int],
        instances: Mapping[int, Instance],
        graphs: Mapping[int, GuidanceGraph],
    ) -> None:
        """Sample and write new episodes of the environments `envs`; nothing is written if one of them is refused.

        `seeds`, `instances` and `graphs` are given by environment; see `Simulator.reset`. Random guidance graphs that
        are not given are sampled.
        """
        for seed in seeds.values():
            check_whole("seed", seed, 0, MAX_SEED)
        for b in envs:
            if b in seeds:
                self._rngs[b] = np.random.default_rng(seeds[b])
        sampled = [self._instance(b, instances) for b in envs]
        for b, instance in zip(envs, sampled, strict=True):
            self._write(b, instance, graphs.get(b))

    def _instance(self, b: int, given: Mapping[int, Instance]) -> Instance:
        """Return the given instance of environment `b`, or sample one."""
        if b not in given:
            instance = self._source.sample(self._rngs[b])
        else:
            instance = given[b]
            check_reachable(instance)
        self._check(instance)
        return instance

    def _check(self, instance: Instance) -> None:
        num_envs, num_agents = self._state.agents.shape
        if (instance.num_agents, instance.grid.shape) != (num_agents, self._source.shape):
            raise ValueError(
                f"instance of {instance.num_agents} agents on {instance.grid.shape} cells: this environment has "
                f"{num_agents} agents on {self._source.shape} cells"
            )
        if self._config.delays is None and instance.delays != self._delays:
            raise ValueError(f"instance with delays={instance.delays}: this environment has delays={self._delays}")
        if self._shares_map and num_envs > 1 and instance.grid is not self._source.grid:
            raise ValueError("instance on another map: this batch shares one map, use a source of several maps")
        if self._config.reward_config.weighted_step_cost != 0 and self._graph is not None:
            _check_finite(self._graph, instance.grid)

    def _write(self, b: int, instance: Instance, graph: GuidanceGraph | None) -> None:
        """Write `instance` to row `b` of the arrays."""
        rng = self._rngs[b]
        m = 0 if self._shares_map else b
        self._set_map(m, instance.grid, rng, graph)
        self._state.map[b] = m
        self.headings[b] = self._initial_headings(instance, rng)
        self.starts[b] = instance.start_cells
        self._state.goals[b], self.goal_counts[b] = self._goals(instance, rng)
        if self._delays is not None:
            self._state.delay_key[b] = rng.integers(2**64, dtype=np.uint64)

    def _set_map(self, m: int, grid: Grid, rng: np.random.Generator, given: GuidanceGraph | None) -> None:
        if grid is self._grids[m] and self._graph is not None:
            return
        self._grids[m] = grid
        graph = self._graph or given or guidance_graph(self._config.edge_weights, grid, rng)
        world.set_map(self._world, m, grid.free, graph)
        draw_map(self._layers, m, self._world.weight[m], self._world.obstacle[m])
        self._tables.forget(m)

    def _goals(self, instance: Instance, rng: np.random.Generator) -> tuple[Ints, Ints]:
        """Return each agent's goals in order, (N, G), and the number of them before its sequence repeats, (N,).

        Where an instance has one goal per agent and more are needed, the others are sampled.
        """
        num_agents = instance.num_agents
        goals, counts = instance.goal_cells, instance.scenario.goal_counts
        needed = self._state.goals.shape[2]
        if goals.shape[1] == 1 and needed > 1:
            sampled = place(instance.grid, num_agents, rng, goals_per_agent=needed)
            goals = np.concatenate([goals, Instance(instance.grid, sampled).goal_cells[:, 1:]], axis=1)
            counts = None
        if counts is None:
            counts = np.full(num_agents, goals.shape[1], np.int32)
            if goals.shape[1] == needed:
                return goals, counts
        return np.take_along_axis(goals, np.arange(needed) % counts[:, None], axis=1), counts

    def _initial_headings(self, instance: Instance, rng: np.random.Generator) -> Ints:
        initial, num_agents = self._config.initial_heading, instance.num_agents
        if self._config.action_model == "cardinal":
            return np.full(num_agents, Heading.NORTH)
        if instance.headings is not None:
            return instance.headings
        if not isinstance(initial, str):
            return np.asarray(initial)
        if initial == "east":
            return np.full(num_agents, Heading.EAST)
        return rng.integers(4, size=num_agents)


def _check_finite(graph: GuidanceGraph, grid: Grid) -> None:
    """Raise `ValueError` if a move that the map allows has an infinite weight, which a reward cannot have."""
    infinite = np.argwhere(open_edges(grid.free) & np.isinf(graph.move))
    if infinite.size:
        heading, row, col = infinite[0].tolist()
        raise ValueError(
            f"reward: weighted_step_cost needs finite edge weights, but that of the move "
            f"{Heading(heading).name.lower()} from [row {row}, col {col}] is infinite"
        )


def _check_headings(headings: HeadingName | ArrayLike, num_agents: int) -> None:
    """Raise `ValueError` for headings that are neither a name nor one for each agent."""
    if not isinstance(headings, str) and np.shape(headings) != (num_agents,):
        raise ValueError(f"initial_heading: expected 'random', 'east' or {num_agents} numbers 0 to 3")


def _common_graph(weights: EdgeWeights, source: InstanceSource) -> GuidanceGraph | None:
    """Return the guidance graph of all maps of a source; None: each has its own."""
    if random_share(weights):
        return None
    if fits_any_map(weights):  # edges into obstacles are blocked when a map is laid out
        return guidance_graph(weights, Grid(np.ones(source.shape, np.bool_)))
    if source.grid is None:
        raise ValueError(f"edge_weights={str(weights)!r}: a file is for one map, but the maps of the episodes differ")
    return guidance_graph(weights, source.grid)
