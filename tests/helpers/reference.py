"""The environment in plain Python, written from the design alone: an oracle for the kernels."""

from __future__ import annotations

from math import hypot, inf, isfinite, log1p
from typing import Any

from mapf_pz.instances.heading import Heading
from tests.helpers.reference_rules import Cell, Rules, ahead

Plane = list[list[float]]


def sign(number: int) -> int:
    return (number > 0) - (number < 0)


def clip(number: float, low: float, high: float) -> float:
    return max(low, min(high, number))


class Reference(Rules):
    """`Rules`, and what each agent observes: `observe` gives planes by channel, `feature` numbers by name."""

    def __init__(
        self,
        *args: Any,
        view_size: tuple[int, int] = (5, 5),
        view: str = "front",
        frame: str = "egocentric",
        see_through_walls: bool = True,
        channels: tuple[str, ...] = ("view", "goal", "orientation", "edge_weights"),
        features: tuple[str, ...] = (),
        num_last_actions: int = 4,
        **rules: Any,
    ) -> None:
        super().__init__(*args, **rules)
        self.view_size = view_size
        self.centre = (view_size[0] - 1 if view == "front" else view_size[0] // 2, view_size[1] // 2)
        self.egocentric = frame == "egocentric"
        self.see_through_walls = see_through_walls
        self.channels, self.features, self.num_last_actions = channels, features, num_last_actions

    def observe(self, agent: int) -> dict[str, list[Plane]]:
        planes = {name: getattr(self, f"_{name}")(agent) for name in self.channels}
        return planes if self._is_watching(agent) else {name: self._zeros(len(p)) for name, p in planes.items()}

    def feature(self, agent: int) -> dict[str, list[float]]:
        numbers = {name: getattr(self, f"_{name}")(agent) for name in self.features}
        return numbers if self._is_watching(agent) else {name: [0.0] * len(n) for name, n in numbers.items()}

    def _is_watching(self, agent: int) -> bool:
        """An agent that disappears observes once more, in the step of its arrival."""
        return self.active[agent] or self.arrived[agent]

    # The view: view cells are (row, col) in the picture, map cells (row, col) on the map.

    def up(self, agent: int) -> int:
        """The direction on the map that is up in the agent's view."""
        return self.headings[agent] if self.egocentric else Heading.NORTH

    def map_cell(self, agent: int, view_cell: Cell) -> Cell:
        forward, right = self.centre[0] - view_cell[0], view_cell[1] - self.centre[1]
        return ahead(ahead(self.positions[agent], self.up(agent), forward), self.up(agent) + 1, right)

    def view_cells(self) -> list[Cell]:
        return [(row, col) for row in range(self.view_size[0]) for col in range(self.view_size[1])]

    def is_seen(self, agent: int, view_cell: Cell) -> bool:
        if self.see_through_walls:
            return True
        rows, cols = view_cell[0] - self.centre[0], view_cell[1] - self.centre[1]
        length = max(abs(rows), abs(cols))
        between = [
            (
                self.centre[0] + sign(rows) * ((2 * k * abs(rows) + length) // (2 * length)),
                self.centre[1] + sign(cols) * ((2 * k * abs(cols) + length) // (2 * length)),
            )
            for k in range(1, length)
        ]
        return all(self.is_free(self.map_cell(agent, cell)) for cell in between)

    def seen_others(self, agent: int) -> list[int]:
        seen = [self.map_cell(agent, cell) for cell in self.view_cells() if self.is_seen(agent, cell)]
        return [
            other for other in self.agents if other != agent and self.active[other] and self.positions[other] in seen
        ]

    def _zeros(self, planes: int = 1) -> list[Plane]:
        return [[[0.0] * self.view_size[1] for _ in range(self.view_size[0])] for _ in range(planes)]

    def _plane(self, agent: int, values: dict[Cell, float]) -> Plane:
        """Draw values by map cell into the view; the rest is 0."""
        (plane,) = self._zeros()
        for row, col in self.view_cells():
            plane[row][col] = values.get(self.map_cell(agent, (row, col)), 0.0)
        return plane

    def _directions(self, agent: int) -> list[int]:
        """Forward, right, back, left; or east, south, west, north in the map frame."""
        first = self.headings[agent] if self.egocentric else Heading.EAST
        return [(first + k) % 4 for k in range(4)]

    # Channels: each a list of planes.

    def _view(self, agent: int) -> list[Plane]:
        others = [self.positions[other] for other in self.agents if self.active[other] and other != agent]
        (plane,) = self._zeros()
        for row, col in self.view_cells():
            cell = self.map_cell(agent, (row, col))
            if not self.is_seen(agent, (row, col)):
                plane[row][col] = -1.0
            elif not self.is_free(cell):
                plane[row][col] = 1.0
            elif cell in others:
                plane[row][col] = 0.5
        return [plane]

    def _goal(self, agent: int) -> list[Plane]:
        return [self._plane(agent, {self.goals[agent]: 1.0})]

    def _orientation(self, agent: int) -> list[Plane]:
        own = self.headings[agent] if self.egocentric else 0
        shown = [agent, *self.seen_others(agent)]
        return [self._plane(agent, {self.positions[a]: (1 + (self.headings[a] - own) % 4) / 4 for a in shown})]

    def _edge_weights(self, agent: int) -> list[Plane]:
        planes = self._zeros(4)
        for plane, direction in zip(planes, self._directions(agent), strict=True):
            for row, col in self.view_cells():
                cell = self.map_cell(agent, (row, col))
                if self.is_inside(cell):
                    weight = self.move_weight(cell, direction)
                    plane[row][col] = (
                        weight / self.largest_move_weight if self.is_free(cell) and isfinite(weight) else -1.0
                    )
        return planes

    def _cost_to_go(self, agent: int) -> list[Plane]:
        own = self.cost_to_go(self.goals[agent], self.positions[agent], self.headings[agent])
        scale = sum(self.view_size) * self.mean_weight
        (plane,) = self._zeros()
        for row, col in self.view_cells():
            cost = self.cost_to_go(self.goals[agent], self.map_cell(agent, (row, col)))
            plane[row][col] = clip((own - cost) / scale, -1, 1) if isfinite(own) and isfinite(cost) else -1.0
        return [plane]

    def _heuristic(self, agent: int) -> list[Plane]:
        planes = self._zeros(4)
        for plane, direction in zip(planes, self._directions(agent), strict=True):
            for row, col in self.view_cells():
                cell = self.map_cell(agent, (row, col))
                neighbour = ahead(cell, direction)
                if self.is_free(cell) and self.is_free(neighbour):
                    nearer = self.cost_to_go(self.goals[agent], neighbour) < self.cost_to_go(self.goals[agent], cell)
                    plane[row][col] = float(nearer)
        return planes

    def _other_goals(self, agent: int) -> list[Plane]:
        return [self._plane(agent, {self.goals[other]: 1.0 for other in self.seen_others(agent)})]

    def _others_next(self, agent: int) -> list[Plane]:
        cells = [self.next_cell(other) for other in self.seen_others(agent) if not self.at_goal[other]]
        return [self._plane(agent, {cell: 1.0 for cell in cells if cell is not None})]

    def _others_heuristic(self, agent: int) -> list[Plane]:
        planes = []
        for direction in self._directions(agent):
            closer = {}
            for other in self.seen_others(agent):
                cell = self.positions[other]
                next_cell = ahead(cell, direction)
                here, there = (self.cost_to_go(self.goals[other], at) for at in (cell, next_cell))
                closer[cell] = float(self.is_free(next_cell) and there < here)
            planes.append(self._plane(agent, closer))
        return planes

    def _others_at_goal(self, agent: int) -> list[Plane]:
        others = self.seen_others(agent)
        return [self._plane(agent, {self.positions[o]: 1.0 if self.at_goal[o] else -1.0 for o in others})]

    def _others_delayed(self, agent: int) -> list[Plane]:
        others = self.seen_others(agent)
        return [self._plane(agent, {self.positions[o]: 1.0 if self.delayed[o] else -1.0 for o in others})]

    def next_cell(self, agent: int) -> Cell | None:
        """The cell that the agent enters next on its own cheapest path; None if there is no path."""
        cell, heading, best, chosen = self.positions[agent], self.headings[agent], inf, None
        turns = {0: 0, 1: 1, 3: 1, 2: 2}  # by the side to drive to, in the order in which ties are resting_since
        if self.cardinal:
            heading, turns = 0, {0: 0, 1: 0, 2: 0, 3: 0}
        for side, count in turns.items():
            direction = (heading + side) % 4
            cost = self.move_weight(cell, direction) + count * self.wait_weight(cell)
            cost += self.cost_to_go(self.goals[agent], ahead(cell, direction), direction)
            if cost < best:
                best, chosen = cost, ahead(cell, direction)
        return chosen

    # Features: each a list of numbers.

    def _goal_vector(self, agent: int) -> list[float]:
        rows = self.goals[agent][0] - self.positions[agent][0]
        cols = self.goals[agent][1] - self.positions[agent][1]
        distance = hypot(rows, cols)
        if distance == 0:
            return [0.0, 0.0, 0.0, 1.0]
        forward, right = ahead((0, 0), self.up(agent)), ahead((0, 0), self.up(agent) + 1)
        return [
            (rows * forward[0] + cols * forward[1]) / distance,
            (rows * right[0] + cols * right[1]) / distance,
            log1p(distance) / log1p(self.height + self.width),
            0.0,
        ]

    def _location(self, agent: int) -> list[float]:
        row, col = self.positions[agent]
        return [row / self.height, col / self.width, *(float(self.headings[agent] == h) for h in range(4))]

    def _pose(self, agent: int) -> list[float]:
        row, col = self.positions[agent]
        return [row / 32768, col / 32768, *(float(self.up(agent) % 4 == h) for h in range(4))]

    def _action_advantage(self, agent: int) -> list[float]:
        return [self._advantage(agent, action) for action in self.action_type]

    def _advantage(self, agent: int, action: int) -> float:
        goal, cell, heading = self.goals[agent], self.positions[agent], self.headings[agent]
        direction = self.direction_of(agent, action)
        cost = self.wait_weight(cell)
        if action == self.action_type.WAIT and cell == goal:
            cost = 0.0
        if direction is not None:
            if not self.is_free(ahead(cell, direction)):
                return -1.0
            cost, cell = self.move_weight(cell, direction), ahead(cell, direction)
        elif not self.cardinal:
            heading = self.turned(heading, action)
        own = self.cost_to_go(goal, self.positions[agent], self.headings[agent])
        after = self.cost_to_go(goal, cell, heading)
        return clip((own - cost - after) / self.mean_weight, -2, 0) / 2 if isfinite(own) else -1.0

    def _last_actions(self, agent: int) -> list[float]:
        count = len(self.action_type)
        numbers: list[float] = []
        for action, moved in reversed(self.action_log[agent][-self.num_last_actions :]):
            numbers += [*(float(action == a) for a in range(count)), float(moved)]
        return numbers + [0.0] * (self.num_last_actions * (count + 1) - len(numbers))

    def _time(self, agent: int) -> list[float]:
        return [self.step_count / self.max_steps]

    def _delayed(self, agent: int) -> list[float]:
        return [float(self.delayed[agent])]

    def _remaining_delay(self, agent: int) -> list[float]:
        return [0.0 if self.delays is None else self.delays.left[agent] / self.delays.delays.duration[1]]
