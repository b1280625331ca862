"""The rules of one episode in plain Python. `tests.helpers.reference` adds the observations."""

from __future__ import annotations

import heapq
from itertools import pairwise
from math import inf, isfinite

from mapf_pz.instances.delays import Delays
from mapf_pz.instances.heading import Heading
from mapf_pz.simulator.actions import Action, CardinalAction
from mapf_pz.simulator.config import RewardConfig
from tests.helpers.reference_delays import ReferenceDelays

Cell = tuple[int, int]
STEP: dict[int, Cell] = {Heading.EAST: (0, 1), Heading.SOUTH: (1, 0), Heading.WEST: (0, -1), Heading.NORTH: (-1, 0)}
CARDINAL_DIRECTION = {
    CardinalAction.UP: Heading.NORTH,
    CardinalAction.DOWN: Heading.SOUTH,
    CardinalAction.LEFT: Heading.WEST,
    CardinalAction.RIGHT: Heading.EAST,
}
TURN = {Action.ROTATE_LEFT: -1, Action.ROTATE_RIGHT: 1}


def ahead(cell: Cell, direction: int, distance: int = 1) -> Cell:
    row, col = STEP[direction % 4]
    return cell[0] + distance * row, cell[1] + distance * col


# Conflicts: each system takes where the active agents are and what they want (by agent), and tells where they end.


def soft(at: dict[int, Cell], wanted: dict[int, Cell]) -> dict[int, Cell]:
    target = dict(wanted)
    for agent in at:
        if any(wanted[agent] == at[other] and wanted[other] == at[agent] for other in at if other != agent):
            target[agent] = at[agent]
    changed = True
    while changed:
        changed = False
        for agent in at:
            rivals = [other for other in at if other != agent and target[other] == target[agent]]
            beaten = any(other < agent or target[other] == at[other] for other in rivals)
            if beaten and target[agent] != at[agent]:
                target[agent] = at[agent]
                changed = True
    return target


def priority(at: dict[int, Cell], wanted: dict[int, Cell]) -> dict[int, Cell]:
    now = dict(at)
    for agent in sorted(at):
        if wanted[agent] not in now.values():
            now[agent] = wanted[agent]
    return now


def block_both(at: dict[int, Cell], wanted: dict[int, Cell]) -> dict[int, Cell]:
    wishes = list(wanted.values())
    return {
        agent: wanted[agent] if wishes.count(wanted[agent]) == 1 and wanted[agent] not in at.values() else at[agent]
        for agent in at
    }


COLLISION_SYSTEMS = {"soft": soft, "priority": priority, "block_both": block_both}


class Rules:
    """One episode: state, transitions, rewards and metrics.

    Readable after every step, by agent: `positions`, `headings`, `active` (not yet gone), `goals` (the current ones),
    `at_goal` (stands on its current goal), `arrived` (in this step, as the goal reward counts it), `moved`, `blocked`,
    `delayed`, `rewards`, `terminated` (stays True); and `truncated` (of all that are left), `step_count`.
    """

    def __init__(
        self,
        free: list[list[bool]],
        starts: list[Cell],
        headings: list[int],
        goals: list[list[Cell]],
        *,
        action_model: str = "rotate",
        collision_system: str = "soft",
        on_target: str = "nothing",
        max_steps: int = 256,
        rewards: RewardConfig | None = None,
        move: list[list[list[float]]] | None = None,
        wait: list[list[float]] | None = None,
        delays: Delays | None = None,
        delay_key: int = 0,
    ) -> None:
        self.free = free
        self.height, self.width = len(free), len(free[0])
        self.cardinal = action_model == "cardinal"
        self.action_type = CardinalAction if self.cardinal else Action
        self.collision_system, self.on_target, self.max_steps = collision_system, on_target, max_steps
        self.reward_config = rewards or RewardConfig()
        self.unit_move = [self._open_edges(direction) for direction in range(4)]
        self.unit_wait = [[1.0] * self.width for _ in range(self.height)]
        self.weighted = move is not None
        self.move = move or self.unit_move
        self.wait = wait or self.unit_wait
        moves = [weight for plane in self.move for row in plane for weight in row if isfinite(weight)]
        waits = [self.wait[r][c] for r in range(self.height) for c in range(self.width) if free[r][c]]
        self.largest_move_weight = max(moves, default=1.0)
        self.mean_weight = sum(moves + waits) / len(moves + waits)
        self.tables: dict[Cell, dict[tuple[Cell, int], float]] = {}

        self.agents = range(len(starts))
        self.goal_lists = [[(goal[0], goal[1]) for goal in one] for one in goals]
        self.goals = [one[0] for one in self.goal_lists]
        self.starts = [(start[0], start[1]) for start in starts]
        self.positions = list(self.starts)
        self.start_headings = [int(Heading.NORTH) if self.cardinal else int(heading) for heading in headings]
        self.headings = list(self.start_headings)
        self.active = [True] * len(starts)
        self.delays = None if delays is None else ReferenceDelays(delays, delay_key, len(starts))
        self.delayed = [False] * len(starts)
        self.delay_log: list[list[bool]] = []  # per step, by agent
        self.arrived = [False] * len(starts)
        self.moved = [False] * len(starts)
        self.blocked = [False] * len(starts)
        self.rewards = [0.0] * len(starts)
        self.terminated = [False] * len(starts)
        self.truncated = False
        self.step_count = 0
        self.arrival_steps: list[list[int]] = [[] for _ in starts]
        self.on_goal_log: list[list[bool]] = []  # per step, by agent
        self.weight_log: list[list[float]] = [[] for _ in starts]  # by agent, of each step until it is gone
        self.action_log: list[list[tuple[int, bool]]] = [[] for _ in starts]  # by agent: (action, moved) per step

    # The map and its weights.

    def is_inside(self, cell: Cell) -> bool:
        return 0 <= cell[0] < self.height and 0 <= cell[1] < self.width

    def is_free(self, cell: Cell) -> bool:
        return self.is_inside(cell) and self.free[cell[0]][cell[1]]

    def _open_edges(self, direction: int) -> list[list[float]]:
        return [
            [1.0 if self.is_free((r, c)) and self.is_free(ahead((r, c), direction)) else inf for c in range(self.width)]
            for r in range(self.height)
        ]

    def move_weight(self, cell: Cell, direction: int) -> float:
        return self.move[direction][cell[0]][cell[1]]

    def wait_weight(self, cell: Cell) -> float:
        return self.wait[cell[0]][cell[1]]

    def _table(
        self, goal: Cell, move: list[list[list[float]]], wait: list[list[float]]
    ) -> dict[tuple[Cell, int], float]:
        """Search backwards from the goal in every heading; what is missing from the result is unreachable."""
        costs: dict[tuple[Cell, int], float] = {}
        queue = [(0.0, goal, heading) for heading in range(4)]
        while queue:
            cost, cell, heading = heapq.heappop(queue)
            if (cell, heading) in costs:
                continue
            costs[cell, heading] = cost
            turning = 0.0 if self.cardinal else wait[cell[0]][cell[1]]
            for side in (1, 3):
                heapq.heappush(queue, (cost + turning, cell, (heading + side) % 4))
            behind = ahead(cell, heading, -1)
            if self.is_free(behind) and isfinite(move[heading][behind[0]][behind[1]]):
                heapq.heappush(queue, (cost + move[heading][behind[0]][behind[1]], behind, heading))
        return costs

    def cost_to_go(self, goal: Cell, cell: Cell, heading: int | None = None) -> float:
        """D(cell, heading) to `goal`; without a heading the least over all."""
        if goal not in self.tables:
            self.tables[goal] = self._table(goal, self.move, self.wait)
        headings = range(4) if heading is None else [heading]
        return min(self.tables[goal].get((cell, h), inf) for h in headings)

    def lower_bound(self, agent: int) -> float:
        """The fewest steps from the agent's start to its first goal."""
        table = self._table(self.goal_lists[agent][0], self.unit_move, self.unit_wait)
        return table.get((self.starts[agent], self.start_headings[agent]), inf)

    # One step.

    def direction_of(self, agent: int, action: int) -> int | None:
        """The direction in which an action drives the agent; None for turning and waiting."""
        if self.cardinal:
            return CARDINAL_DIRECTION.get(CardinalAction(action))
        return self.headings[agent] if action == Action.FORWARD else None

    def turned(self, heading: int, action: int) -> int:
        return (heading + TURN.get(Action(action), 0)) % 4

    def action_mask(self, agent: int) -> list[int]:
        waiting = self.action_type.WAIT
        if not self.active[agent]:
            return [int(action == waiting) for action in self.action_type]
        directions = [self.direction_of(agent, action) for action in self.action_type]
        return [int(d is None or self.is_free(ahead(self.positions[agent], d))) for d in directions]

    @property
    def at_goal(self) -> list[bool]:
        return [self.positions[agent] == self.goals[agent] for agent in self.agents]

    def step(self, actions: list[int]) -> None:
        playing = [agent for agent in self.agents if self.active[agent]]
        if self.delays is not None:
            self.delayed = self.delays.step()
            self.delay_log.append(self.delayed)
            wait = self.action_type.WAIT
            actions = [wait if late else action for late, action in zip(self.delayed, actions, strict=True)]
        before = [
            self.cost_to_go(self.goals[agent], self.positions[agent], self.headings[agent]) for agent in self.agents
        ]
        stayed = self.at_goal
        self._advance(playing, actions)
        self._note_arrivals(playing)
        solved = self.on_target == "nothing" and all(self.at_goal)
        stayed = [was and is_there for was, is_there in zip(stayed, self.at_goal, strict=True)]
        own = {
            agent: self._own_reward(agent, actions[agent], before[agent], stayed[agent], solved) for agent in playing
        }
        self.rewards = [own[agent] + self._shared(agent, own) if agent in own else 0.0 for agent in self.agents]
        self._apply_on_target()
        if solved:
            self.terminated = [True for _ in self.agents]
        self.truncated = self.step_count >= self.max_steps and not all(self.terminated)

    def _advance(self, playing: list[int], actions: list[int]) -> None:
        at = {agent: self.positions[agent] for agent in playing}
        wanted = dict(at)
        directions = {agent: self.direction_of(agent, actions[agent]) for agent in playing}
        for agent, direction in directions.items():
            if direction is not None and self.is_free(ahead(at[agent], direction)):
                wanted[agent] = ahead(at[agent], direction)
        after = COLLISION_SYSTEMS[self.collision_system](at, wanted)
        self.moved = [agent in at and after[agent] != at[agent] for agent in self.agents]
        self.blocked = [directions.get(agent) is not None and not self.moved[agent] for agent in self.agents]
        for agent in playing:
            direction = directions[agent]
            moves = self.moved[agent] and direction is not None
            weight = self.move_weight(at[agent], direction) if moves else self.wait_weight(at[agent])
            self.weight_log[agent].append(weight)
            self.positions[agent] = after[agent]
            if not self.cardinal:
                self.headings[agent] = self.turned(self.headings[agent], actions[agent])
            self.action_log[agent].append((int(actions[agent]), self.moved[agent]))
        self.step_count += 1

    def _note_arrivals(self, playing: list[int]) -> None:
        on_goal = self.at_goal
        self.on_goal_log.append(on_goal)
        again = self.on_target == "restart"
        self.arrived = [
            agent in playing and on_goal[agent] and (again or not self.arrival_steps[agent]) for agent in self.agents
        ]
        for agent in self.agents:
            if self.arrived[agent]:
                self.arrival_steps[agent].append(self.step_count)

    def _apply_on_target(self) -> None:
        for agent in self.agents:
            if self.arrived[agent] and self.on_target == "finish":
                self.active[agent] = False
                self.terminated[agent] = True
            if self.arrived[agent] and self.on_target == "restart":
                goals = self.goal_lists[agent]
                self.goals[agent] = goals[len(self.arrival_steps[agent]) % len(goals)]

    # Rewards.

    def _own_reward(self, agent: int, action: int, before: float, stayed: bool, solved: bool) -> float:
        config = self.reward_config
        after = self.cost_to_go(self.goals[agent], self.positions[agent], self.headings[agent])
        reward = config.goal if self.arrived[agent] else self._action_reward(agent, action)
        if isfinite(before) and isfinite(after):
            reward += config.progress * (before - after) / self.mean_weight
        if not self.at_goal[agent]:
            reward -= config.step_cost
        if config.weighted_step_cost and not stayed:
            reward -= config.weighted_step_cost * self.weight_log[agent][-1] / self.mean_weight
        if self.blocked[agent]:
            reward -= config.blocked
        if solved:
            reward += config.team_goal
        return reward

    def _action_reward(self, agent: int, action: int) -> float:
        config = self.reward_config
        if self.moved[agent] or (self.blocked[agent] and config.pay_blocked_forward):
            return config.forward
        if self.blocked[agent]:
            return 0.0
        return config.wait if action == self.action_type.WAIT else config.rotate

    def _shared(self, agent: int, own: dict[int, float]) -> float:
        row, col = self.positions[agent]
        near = [
            reward
            for other, reward in own.items()
            if other != agent
            and abs(self.positions[other][0] - row) <= self.reward_config.share_radius
            and abs(self.positions[other][1] - col) <= self.reward_config.share_radius
        ]
        return self.reward_config.share * sum(near) / len(near) if near else 0.0

    # Metrics: POGEMA's definitions, and those of the guidance graph.

    def metrics(self) -> dict[str, float]:
        if self.on_target == "restart":
            arrivals = sum(len(steps) for steps in self.arrival_steps)
            ends = [len(steps) >= len(goals) for steps, goals in zip(self.arrival_steps, self.goal_lists, strict=True)]
            return {
                "avg_throughput": arrivals / self.max_steps,
                "ep_length": float(self.step_count),
                "exhausted_agents": float(sum(ends)),
                **self._delay_share([self.step_count] * len(self.agents)),
            }
        if self.on_target == "finish":
            solved = [bool(steps) for steps in self.arrival_steps]
            times = [steps[0] if steps else self.step_count for steps in self.arrival_steps]
        else:
            solved = self.at_goal
            times = [self._settled(agent) for agent in self.agents]
        shortest = [self.lower_bound(agent) for agent in self.agents]
        bound = sum(max(length, 1) for length in shortest if isfinite(length))
        weighted = self._weighted_metrics(times) if self.weighted else {}
        delayed = self._delay_share(times if self.on_target == "finish" else [self.step_count] * len(times))
        if self.delays is not None:
            alone = sum(
                self._cost_alone(agent, int(length)) for agent, length in enumerate(shortest) if isfinite(length)
            )
            delayed["delayed_SoC_ratio"] = sum(times) / alone if alone else 1.0
        return (
            weighted
            | delayed
            | {
                "CSR": float(all(solved)),
                "ISR": sum(solved) / len(solved),
                "SoC": float(sum(times)),
                "makespan": float(max(times)),
                "ep_length": sum(times) / len(times) if self.on_target == "finish" else float(self.step_count),
                "SoC_ratio": sum(times) / bound if bound else 1.0,
            }
        )

    def _delay_share(self, ends: list[int]) -> dict[str, float]:
        """The share of delayed steps up to each agent's last one."""
        if self.delays is None:
            return {}
        steps = [self.delay_log[step][agent] for agent in self.agents for step in range(ends[agent])]
        return {"delay_share": sum(steps) / len(steps) if steps else 0.0}

    def _cost_alone(self, agent: int, length: int) -> int:
        """The step in which an agent that never waits for others arrives with its delays, at most the last one."""
        made = 0
        for step, delayed in enumerate(self.delay_log, start=1):
            made += not delayed[agent]
            if made >= length:
                return step
        return max(self.step_count, 1)

    def _weighted_metrics(self, times: list[int]) -> dict[str, float]:
        cost = sum(sum(log[:time]) for log, time in zip(self.weight_log, times, strict=True))
        alone = [
            self.wait_weight(start) if start == goals[0] else self.cost_to_go(goals[0], start, heading)
            for start, heading, goals in zip(self.starts, self.start_headings, self.goal_lists, strict=True)
        ]
        bound = sum(filter(isfinite, alone))
        return {"weighted_cost": cost, "weighted_cost_ratio": cost / bound if bound else 1.0}

    def _settled(self, agent: int) -> int:
        """The step from which the agent stays on its goal to the end; the last step if it is not there."""
        log = [on_goal[agent] for on_goal in self.on_goal_log]
        if not log or not log[-1]:
            return self.step_count
        came = [step for step, (was, now) in enumerate(pairwise([False, *log]), start=1) if now and not was]
        return came[-1]
