"""The environment of the report's authors, with its defects, each of which can be repaired.

It does what their published code does, as `docs/explanation/report.md` describes: ten agents of one warehouse, 1000
steps, a single reward for the team, and observations of 30 planes of 20 x 20 cells. Axis 0 of the map is x, axis 1 is
y; direction 0 is x + 1, then y + 1, x - 1, y - 1.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, Literal

import gymnasium
import numpy as np
from gymnasium import spaces
from numba import njit
from numpy.typing import NDArray

from mapf_pz.instances import load_problem
from mapf_pz.wrappers import ACTION_MODES

Ints = NDArray[np.int64]
LEFT, RIGHT, FORWARD, STILL = range(4)
EMPTY, WALL, GOAL, AGENT = range(4)  # what is in a cell; agent `i` is AGENT + i
TYPES = (1, 2, 4, 10)  # how these are shown; 0 is a cell that is not seen
WALL_COLOR = 5  # in the plane of goals, which are 1, as long as an action was a number
DIRECTIONS = np.array([(1, 0), (0, 1), (-1, 0), (0, -1)])
VIEW = 20
NUM_AGENTS = 10
MAX_STEPS = 1000
FORWARD_REWARD, TURN_REWARD, GOAL_REWARD = 0.1, 0.01, 20.0

# The authors' own starts and goals, cells of the upside-down map by their numbers; larger numbers are random cells.
# Source: `warehouse_small_10` in Start-Kit/example_problems/warehouse.domain of VineetTambe/multi-agent-rl, a3bc75b.
STARTS = (1032, 204, 1761, 180, 198, 1311, 252, 406, 1610, 1500)
GOALS = (298, 1543, 2000, 2500, 1650, 1683, 1664, 1641, 255, 1772)

Actions = Literal["number", "weights"]
"""What an agent's action is: a number `a` in [-1, 1], which means action `round(1.5 a + 1.5)`, in runs until December
5, 2023; or four of them, from which it is sampled with the weights `(a + 1) / 2`, from December 6 on."""


@dataclass(frozen=True)
class Defects:
    """The defects of the published environment; False: repaired."""

    bytes: bool = True
    """Observations become bytes: thirds are cut off, so that empty cells, walls and most directions are 0."""
    transposed: bool = True
    """Stable-Baselines3 takes the observation for an image with channels in its last axis: 20 planes of 30 x 20."""
    finished: bool = True
    """Agents that have reached a goal act neither in this episode nor in any later one."""
    border: bool = True
    """An agent that faces the border of the map cannot act, not even turn."""
    header: bool = True
    """The number in the first line of a file is read as the first agent's start or goal, and the last is omitted."""
    flipped: bool = True
    """The map is upside down, with the authors' starts and goals; otherwise, all are the problem's."""
    stations: bool = True
    """The cells of goals, `E` and `S` in the map's file, are walls."""
    any_goal: bool = True
    """Every agent can reach every goal, and all goals look alike; otherwise each agent sees its own alone."""
    blocked: bool = True
    """A forward move pays 0.1 if it is blocked, too."""
    occluded: bool = True
    """Walls hide what is behind them."""


NO_DEFECTS = Defects(**dict.fromkeys((field.name for field in fields(Defects)), False))


class ReportEnv(gymnasium.Env[NDArray[Any], NDArray[Any]]):
    """The team of ten agents in `warehouse_small_10`, as a single agent.

    Observation: `Box (30, 20, 20)`, for each agent the types, the goals and the directions of the cells in its view, in
    thirds; transposed, (20, 30, 20). Action: `Box (10,)` or `Box (10, 4)` in [-1, 1], see `Actions`. Reward: the sum
    over agents. It is truncated after 1000 steps and never terminated.
    """

    def __init__(self, defects: Defects | None = None, actions: Actions = "number") -> None:
        """Read the problem, which comes with the package."""
        self.defects, self._actions = defects or Defects(), actions
        problem = load_problem("warehouse_small_10")
        walls = ~problem.grid.free
        if self.defects.stations:
            walls[tuple(problem.errands.T)] = True
        self.cells = np.where(walls[::-1] if self.defects.flipped else walls, WALL, EMPTY)
        starts, goals = list(STARTS), list(GOALS)
        if not self.defects.flipped:
            numbers = np.arange(walls.size).reshape(walls.shape)
            starts, goals = (numbers[tuple(cells.T)].tolist() for cells in (problem.starts, problem.errands))
        if self.defects.header:
            starts, goals = [len(problem.starts), *starts], [len(problem.errands), *goals]
        self.starts = [divmod(number, walls.shape[1]) for number in starts[:NUM_AGENTS]]
        self._goal_cells = [
            divmod(number, walls.shape[1]) if number < walls.size else None for number in goals[:NUM_AGENTS]
        ]
        shape = (VIEW, NUM_AGENTS * 3, VIEW) if self.defects.transposed else (NUM_AGENTS * 3, VIEW, VIEW)
        if self.defects.bytes:  # a bound of 255 would tell Stable-Baselines3 to transpose the other shape
            self.observation_space = spaces.Box(0, 255 if self.defects.transposed else TYPES[-1] // 3, shape, np.uint8)
        else:
            self.observation_space = spaces.Box(0, TYPES[-1] / 3, shape, np.float32)
        self.action_space = spaces.Box(-1, 1, (NUM_AGENTS, 4) if actions == "weights" else (NUM_AGENTS,), np.float32)
        self.finished = np.zeros(NUM_AGENTS, np.bool_)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[Any], dict[str, Any]]:
        """Start an episode with random directions."""
        super().reset(seed=seed)
        self.grid, self._steps = self.cells.copy(), 0
        self.positions = np.array(self.starts)
        self.directions = self.np_random.integers(4, size=NUM_AGENTS)
        if not self.defects.finished:
            self.finished[:] = False
        for i, (x, y) in enumerate(self.positions):
            self.grid[x, y] = AGENT + i
        self.goals = np.array([self._place(cell) for cell in self._goal_cells])
        for x, y in self.goals:
            self.grid[x, y] = GOAL
        return self.observe(), {}

    def _place(self, cell: tuple[int, int] | None) -> tuple[int, int]:
        """Return the cell, or a random empty one instead of None."""
        while cell is None:
            x, y = self.np_random.integers(self.grid.shape)
            if self.grid[x, y] == EMPTY:
                cell = (int(x), int(y))
        return cell

    def step(self, action: NDArray[Any]) -> tuple[NDArray[Any], float, bool, bool, dict[str, Any]]:
        """Let the agents act in the order of their numbers."""
        values = np.asarray(action, np.float64)
        if self._actions == "weights":
            choices = ACTION_MODES["affine"](values, self.np_random)
        else:
            choices = np.round((values + 1) * 1.5).astype(np.int64)
        reward = sum(self._act(i, choice) for i, choice in enumerate(choices.tolist()))
        self._steps += 1
        return self.observe(), reward, False, self._steps >= MAX_STEPS, {"finished": int(self.finished.sum())}

    def _act(self, i: int, choice: int) -> float:
        """Let agent `i` act, and return its reward."""
        if self.finished[i] or choice == STILL:
            return 0.0
        ahead = self.positions[i] + DIRECTIONS[self.directions[i]]
        is_inside = bool((ahead >= 0).all() and (ahead < self.grid.shape).all())
        if not is_inside and self.defects.border:
            return 0.0
        if choice != FORWARD:
            self.directions[i] = (self.directions[i] + (1 if choice == RIGHT else 3)) % 4
            return TURN_REWARD
        return self._advance(i, tuple(ahead.tolist()) if is_inside else None)

    def _advance(self, i: int, ahead: tuple[int, int] | None) -> float:
        """Let agent `i` move to the cell `ahead` (None: outside of the map), and return its reward."""
        content = WALL if ahead is None else self.grid[ahead]
        if content == GOAL and not self.defects.any_goal and ahead != tuple(self.goals[i].tolist()):
            content = EMPTY
        if content == GOAL:  # it is reached from the cell before it
            self.finished[i] = True
            return FORWARD_REWARD + GOAL_REWARD
        if content != EMPTY or ahead is None:
            return FORWARD_REWARD if self.defects.blocked else 0.0
        here = tuple(self.positions[i].tolist())
        self.grid[ahead] = AGENT + i
        self.grid[here] = EMPTY
        if not self.defects.any_goal and (self.goals == here).all(axis=1).any():
            self.grid[here] = GOAL  # another agent's, which it has crossed
        self.positions[i] = ahead
        return FORWARD_REWARD

    def observe(self) -> NDArray[Any]:
        """Return what the team observes now."""
        planes = np.empty((NUM_AGENTS * 3, VIEW, VIEW), np.float32)
        wall_color = WALL_COLOR if self._actions == "number" else 0
        _draw(self.grid, self.positions, self.directions, self.goals, self.defects.occluded,
              self.defects.any_goal, wall_color, planes.reshape(NUM_AGENTS, 3, VIEW, VIEW))  # fmt: skip
        shown = (planes / 3).astype(self.observation_space.dtype)
        return shown.transpose(2, 0, 1) if self.defects.transposed else shown


_SHOWN = np.array(TYPES)


@njit(cache=True)
def _draw(
    grid: Ints, positions: Ints, directions: Ints, goals: Ints, occluded: bool, any_goal: bool, wall_color: int,
    thirds: NDArray[Any]
) -> None:  # fmt: skip
    """Draw the types, goals and directions that each agent sees to `thirds` (N, 3, 20, 20), times 3."""
    contents, seen = np.empty((VIEW, VIEW), np.int64), np.empty((VIEW, VIEW), np.bool_)
    for i in range(len(positions)):
        _cut_out(grid, positions[i], directions[i], goals[i], any_goal, contents)
        seen[:] = not occluded
        if occluded:
            _look(contents, seen)
        for x in range(VIEW):
            for y in range(VIEW):
                content = contents[x, y] if seen[x, y] else -1
                thirds[i, 0, x, y] = 0 if content < 0 else _SHOWN[min(content, AGENT)]
                thirds[i, 1, x, y] = 1 if content == GOAL else wall_color if content == WALL else 0
                thirds[i, 2, x, y] = directions[content - AGENT] if content >= AGENT else 0


@njit(cache=True)
def _cut_out(grid: Ints, position: Ints, direction: int, goal: Ints, any_goal: bool, contents: Ints) -> None:
    """Copy the square ahead of an agent, turned so that the agent looks toward y = 0 from the middle of the last row.

    Views of an even size have no middle: in two of the four directions, the agent is beside it, as in the original.
    """
    last, half = VIEW - 1, VIEW // 2
    corner_x = position[0] - (0 if direction == 0 else last if direction == 2 else half)
    corner_y = position[1] - (0 if direction == 1 else last if direction == 3 else half)
    for i in range(VIEW):
        for j in range(VIEW):
            x, y = corner_x + i, corner_y + j
            content = WALL
            if 0 <= x < grid.shape[0] and 0 <= y < grid.shape[1]:
                content = grid[x, y]
                if content == GOAL and not any_goal and (x != goal[0] or y != goal[1]):
                    content = EMPTY
            if direction == 0:
                contents[j, last - i] = content
            elif direction == 1:
                contents[last - i, last - j] = content
            elif direction == 2:
                contents[last - j, i] = content
            else:
                contents[i, j] = content


@njit(cache=True)
def _look(contents: Ints, seen: NDArray[np.bool_]) -> None:
    """Find the cells that can be seen: row by row away from the agent, first to the right, then to the left."""
    seen[VIEW // 2, VIEW - 1] = True
    for y in range(VIEW - 1, -1, -1):
        for sign in (1, -1):
            for step in range(VIEW - 1):
                x = step if sign == 1 else VIEW - 1 - step
                if seen[x, y] and contents[x, y] != WALL:
                    seen[x + sign, y] = True
                    if y > 0:
                        seen[x + sign, y - 1] = True
                        seen[x, y - 1] = True
