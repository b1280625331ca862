"""Hand-drawn conflicts, and how each collision system settles them: what every implementation of a step must do.

A drawing is one row of the map after the other, with `/` between them: `@` obstacle, `.` free, a digit an agent.
"""

from __future__ import annotations

from dataclasses import dataclass

from mapf_pz.simulator.actions import Action, CardinalAction

Cell = tuple[int, int]
ARROWS = ">v<^"  # by heading
CARDINAL_ACTIONS = {
    ".": CardinalAction.WAIT,
    "^": CardinalAction.UP,
    "v": CardinalAction.DOWN,
    "<": CardinalAction.LEFT,
    ">": CardinalAction.RIGHT,
}
ROTATE_ACTIONS = {"F": Action.FORWARD, "L": Action.ROTATE_LEFT, "R": Action.ROTATE_RIGHT, "W": Action.WAIT}


@dataclass(frozen=True)
class Case:
    """One step. With `headings` the agents turn and drive (`actions` of F, L, R, W), without they are cardinal."""

    name: str
    start: str
    actions: str
    soft: str
    priority: str
    block_both: str
    headings: str = ""
    headings_after: str = ""

    @property
    def action_model(self) -> str:
        return "rotate" if self.headings else "cardinal"

    @property
    def free(self) -> list[list[bool]]:
        return [[symbol != "@" for symbol in row] for row in self.start.split("/")]

    @property
    def action_numbers(self) -> list[int]:
        return [int((ROTATE_ACTIONS if self.headings else CARDINAL_ACTIONS)[letter]) for letter in self.actions]

    @property
    def start_headings(self) -> list[int]:
        return [ARROWS.index(arrow) for arrow in self.headings or "^" * len(self.actions)]

    @property
    def end_headings(self) -> list[int]:
        return [ARROWS.index(arrow) for arrow in self.headings_after or self.headings or "^" * len(self.actions)]

    @property
    def start_cells(self) -> list[Cell]:
        return agent_cells(self.start)

    def end_cells(self, collision_system: str) -> list[Cell]:
        return agent_cells(getattr(self, collision_system))


def agent_cells(drawing: str) -> list[Cell]:
    """Read the (row, col) of agents 0, 1, ... off a drawing."""
    rows = drawing.split("/")
    cells = {symbol: (r, c) for r, row in enumerate(rows) for c, symbol in enumerate(row) if symbol.isdigit()}
    return [cells[symbol] for symbol in sorted(cells)]


def _alike(name: str, start: str, actions: str, end: str, headings: str = "", headings_after: str = "") -> Case:
    """Make a case on which all collision systems agree."""
    return Case(name, start, actions, end, end, end, headings, headings_after)


CARDINAL_CASES = [
    _alike("free move", ".0.", ">", "..0"),
    _alike("obstacle", "0@", ">", "0@"),
    _alike("edge of the map", "0./..", "^", "0./.."),
    Case("follow, follower is lower", "01.", ">>", soft=".01", priority="0.1", block_both="0.1"),
    Case("follow, follower is higher", "10.", ">>", soft=".10", priority=".10", block_both="1.0"),
    Case("round a corner", "01/@.", ">v", soft=".0/@1", priority="0./@1", block_both="0./@1"),
    Case("vertex conflict", "0.1", "><", soft=".01", priority=".01", block_both="0.1"),
    Case("vertex conflict, mirrored", "1.0", "<>", soft="10.", priority="10.", block_both="1.0"),
    Case("three want one cell", "@2@/0.1/@.@", "><v", "@2@/.01/@.@", "@2@/.01/@.@", "@2@/0.1/@.@"),
    _alike("swap", "01", "><", "01"),
    _alike("swap with a follower", "012", ">><", "012"),
    Case("rotation cycle", "01/32", ">v<^", soft="30/21", priority="01/32", block_both="01/32"),
    Case("cycle, higher one wants in", "014/32.", ">v<^<", soft="304/21.", priority="014/32.", block_both="014/32."),
    _alike("cycle, lower one wants in", "120/43.", "<>v<^", "120/43."),
    _alike("chain against an obstacle", "012@", ">>>", "012@"),
    _alike("chain against the edge", "012", ">>>", "012"),
    _alike("chain behind a waiting agent", "012.", ">>.", "012."),
    _alike("chain behind a swap", "0123", ">>><", "0123"),
    Case("chain behind a loser", "21.0", "<>>", soft="210.", priority="210.", block_both="21.0"),
    Case("chain moves on", "012.", ">>>", soft=".012", priority="01.2", block_both="01.2"),
    Case("chain moves on, lower ones first", "210.", ">>>", soft=".210", priority=".210", block_both="21.0"),
    Case("two want a cell being left", "@3@/012/@.@", ">v.v", "@3@/.02/@1@", "@.@/032/@1@", "@3@/0.2/@1@"),
]

ROTATE_CASES = [
    _alike("forward", "0.", "F", ".0", ">"),
    _alike("forward into an obstacle", "0@", "F", "0@", ">"),
    _alike("forward off the map", "0.", "F", "0.", "^"),
    _alike("left and right", "0.1", "LR", "0.1", ">>", "^v"),
    _alike("left and right, all the way round", "0.1", "LR", "0.1", "v^", ">>"),
    _alike("wait", "0.", "W", "0.", ">"),
    _alike("face to face", "01", "FF", "01", "><"),
    Case("one cell between", "0.1", "FF", soft=".01", priority=".01", block_both="0.1", headings="><"),
    _alike("a turner blocks", "01.", "FR", "01.", ">>", ">v"),
    _alike("a turner blocks a chain", "012.", "FFL", "012.", ">>>", ">>^"),
    _alike("a turner is not pushed", "0.1", "FL", ".01", "><", ">v"),
    Case("chain drives", "012.", "FFF", soft=".012", priority="01.2", block_both="01.2", headings=">>>"),
    Case("chain drives, lower first", "210.", "FFF", soft=".210", priority=".210", block_both="21.0", headings=">>>"),
    Case("chain with a turner behind", "201.", "FFR", "2.01", "20.1", "20.1", ">>>", ">>v"),
    Case("rotation cycle", "01/32", "FFFF", soft="30/21", priority="01/32", block_both="01/32", headings=">v<^"),
    _alike("rotation cycle, one turns", "01/32", "FFFR", "01/32", ">v<^", ">v<>"),
]

CASES = CARDINAL_CASES + ROTATE_CASES
