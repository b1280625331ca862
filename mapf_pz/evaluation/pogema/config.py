"""Keywords of `parallel_env` from the configuration of a POGEMA environment."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mapf_pz._internal.arrays import Bools
from mapf_pz.instances import RandomObstacles
from mapf_pz.instances.instance import Grid, Scenario
from mapf_pz.simulator.config import EnvConfig
from mapf_pz.simulator.kernels.reward import RewardConfig
from mapf_pz.simulator.source import goals_per_agent

_DEFAULTS: dict[str, Any] = {
    "on_target": "finish",
    "collision_system": "priority",
    "observation_type": "default",
    "max_episode_steps": 64,
    "num_agents": None,
    "size": 8,
    "width": None,
    "height": None,
    "density": 0.3,
    "obs_radius": 5,
    "map": None,
    "map_name": None,
    "agents_xy": None,
    "targets_xy": None,
    "possible_agents_xy": None,
    "possible_targets_xy": None,
}
"""The fields of POGEMA 1.4.0's `GridConfig` that are converted, and their defaults."""
_REWARDS = {
    "nothing": RewardConfig(forward=0, rotate=0, goal=0, team_goal=1),
    "finish": RewardConfig(forward=0, rotate=0, goal=1),
    "restart": RewardConfig(forward=0, rotate=0, goal=1),
}


def pogema_keywords(config: object) -> dict[str, Any]:
    """Return the keywords of `parallel_env` for an environment with the rules of a POGEMA environment.

    The observation has the channels `view` and `goal` with a view of `2 * obs_radius + 1` rows and columns, and the
    feature `goal_vector`; with the types `POMAPF` and `MAPF` also `location`. The seed is not a keyword: pass it to
    `reset`.

    Args:
        config: POGEMA's `GridConfig`, or a mapping of its fields to values.

    Raises `ValueError` for fields that cannot be converted: `possible_agents_xy`, `possible_targets_xy`, `map_name`.
    """
    given = dict(config) if isinstance(config, Mapping) else vars(config)
    fields = {name: default if given.get(name) is None else given[name] for name, default in _DEFAULTS.items()}
    for name in ("possible_agents_xy", "possible_targets_xy", "map_name"):
        if fields[name] is not None:
            raise ValueError(f"{name}: cannot be converted; use a map, or a custom source")
    rules: dict[str, Any] = {
        "action_model": "cardinal",
        "collision_system": fields["collision_system"],
        "on_target": fields["on_target"],
        "max_steps": fields["max_episode_steps"],
    }
    instances = _instances(fields, goals_per_agent(EnvConfig(**rules)))
    location = () if fields["observation_type"] == "default" else ("location",)
    size = 2 * fields["obs_radius"] + 1
    return {
        **rules,
        **instances,
        "view_size": (size, size),
        "channels": ("view", "goal"),
        "features": ("goal_vector", *location),
        "reward": _REWARDS[fields["on_target"]],
    }


def _instances(fields: Mapping[str, Any], num_goals: int) -> dict[str, Any]:
    """Return the keywords that determine maps, starts and goals."""
    number, starts, goals = fields["num_agents"], fields["agents_xy"], fields["targets_xy"]
    if fields["map"] is None:
        height, width = fields["height"] or fields["size"], fields["width"] or fields["size"]
        free = np.ones((height, width), np.bool_)
    else:
        free, marks = _parse_map(fields["map"])
        if starts is None and any(name.islower() for name in marks):
            starts = [marks[name] for name in sorted(marks) if name.islower()]
            goals = [marks[name] for name in sorted(marks) if name.isupper()]
    if (starts is None) != (goals is None):
        raise ValueError("agents_xy, targets_xy: expected both or neither")
    if starts is not None:
        return {"map": Grid(free), "scenario": Scenario(np.array(starts), np.array(goals)), "num_agents": len(starts)}
    if fields["map"] is not None:
        return {"map": Grid(free), "num_agents": number or 1}
    height, width = free.shape
    return {"source": RandomObstacles(height, width, fields["density"], number or 1, num_goals)}


def _parse_map(drawn: Any) -> tuple[Bools, dict[str, tuple[int, int]]]:
    """Return the free cells of a map drawn as text or as rows of 0 (free) and 1, and the cells of its letters."""
    if not isinstance(drawn, str):
        return np.array(drawn) == 0, {}
    rows = [list(row) for row in drawn.split()]
    marks = {mark: (row, col) for row, cells in enumerate(rows) for col, mark in enumerate(cells) if mark.isalpha()}
    return np.array(rows) != "#", marks
