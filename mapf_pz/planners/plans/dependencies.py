"""The action dependency graph of a plan."""

from __future__ import annotations

import json
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from reprlib import repr as shortened

import numpy as np

from mapf_pz._internal.arrays import EqualByValue, Ints, frozen
from mapf_pz._internal.json import JsonObject, are_whole, list_member, parse_object
from mapf_pz.errors import FormatError
from mapf_pz.instances.heading import Heading
from mapf_pz.instances.instance import Instance
from mapf_pz.planners.plans.files.letters import TURNS, WAIT, follow_steps, follow_turns, format_steps, format_turns
from mapf_pz.planners.plans.files.lorr import STEPS
from mapf_pz.planners.plans.files.planfile import check_size
from mapf_pz.planners.plans.plan import Kind, Plan, Violation, validate

NONE = -1
"""In place of the state or agent that is waited for where there is none."""
NEVER = np.iinfo(np.int32).max
"""The step in which an agent leaves its last cell."""


@dataclass(frozen=True, eq=False)
class DependencyGraph(EqualByValue):
    """Which action of a plan waits for which other: the action dependency graph of Hönig et al., RA-L 4(2), 2019.

    The agents execute the actions of their paths, moves and turns, in order and without the waits of the plan. Each
    cell keeps its visitors in the order of the plan: the action with which an agent enters a cell waits for the action
    with which the last visitor before it leaves the cell. It may be executed in the same step, since following is
    legal, or later. In a step, the largest set of agents act in which no agent is delayed and each action waits only
    for actions that have been executed or are executed in this step: see `Execution`.

    No conflicts: an agent enters a cell only when the visitor before it has left, or leaves. If two agents swapped
    cells, each of the two actions would wait for the other one. An action never has an earlier planned step than the
    one that it waits for, so both would have the same step, and the agents would swap cells in the plan.

    No deadlock: let s be the earliest planned step of the actions that are left. Those with this step are the next
    ones of their agents. They wait only for actions with planned steps up to s, which have been executed or belong to
    them. So they can be executed together, and are, unless some are delayed. If agents are delayed in D steps and the
    plan has T steps, the execution has at most D + T steps.

    Agent i has the states `first[i]` to `first[i + 1] - 1`. The first one is its start, and each action is denoted by
    the state that it leads to. N agents, S states.
    """

    first: Ints
    """(N + 1,) int64: the first state of each agent, and S."""
    positions: Ints
    """(S, 2) int32: [row, col] in each state."""
    headings: Ints | None
    """(S,) int8: the `Heading` in each state; None for cardinal agents."""
    steps: Ints
    """(S,) int32: the step of the plan that leads to each state, 1 to T; 0 for starts."""
    waits_for: Ints
    """(S,) int64: the state of another agent that has to be reached before this one, or in the same step; `NONE`."""

    def __post_init__(self) -> None:
        """Copy and freeze the arrays."""
        for name, dtype in (("first", np.int64), ("positions", np.int32), ("steps", np.int32), ("waits_for", np.int64)):
            object.__setattr__(self, name, frozen(getattr(self, name), dtype, name))
        if self.headings is not None:
            object.__setattr__(self, "headings", frozen(self.headings, np.int8, "headings"))

    @classmethod
    def from_plan(cls, plan: Plan, instance: Instance | None = None) -> DependencyGraph:
        """Return the graph of a plan, whose agents need not end at their goals.

        Args:
            plan: the plan.
            instance: the instance of the plan. None: only conflicts between agents are checked, not starts, the map,
                moves and turns.

        Raises `ValueError`, naming the violation, if the plan is illegal.
        """
        violation = None if instance is None else validate(instance, plan)
        if violation is not None and violation.kind != "goal":
            raise ValueError(f"plan: {violation}")
        changed = np.ones((plan.num_steps + 1, plan.num_agents), np.bool_)
        changed[1:] = (np.diff(plan.positions, axis=0) != 0).any(axis=2)
        if plan.headings is not None:
            changed[1:] |= np.diff(plan.headings, axis=0) != 0
        agents, steps = np.nonzero(changed.T)
        positions = plan.positions[steps, agents]
        return cls(
            first=np.append(0, np.bincount(agents, minlength=plan.num_agents).cumsum()),
            positions=positions,
            headings=None if plan.headings is None else plan.headings[steps, agents],
            steps=steps,
            waits_for=_waits_for(agents, steps, positions),
        )

    @property
    def num_agents(self) -> int:
        """Number of agents N."""
        return len(self.first) - 1

    @property
    def num_actions(self) -> Ints:
        """(N,) int64: the number of each agent's actions."""
        return np.diff(self.first) - 1

    @property
    def agents(self) -> Ints:
        """(S,) int64: the agent of each state."""
        return np.repeat(np.arange(self.num_agents), np.diff(self.first))

    @property
    def dependencies(self) -> Ints:
        """(E, 4) int64: agent and number of an action, and agent and number of the one that it waits for.

        The actions of each agent are numbered from 0.
        """
        waiting = np.flatnonzero(self.waits_for != NONE)
        ends = np.stack([waiting, self.waits_for[waiting]], axis=1)
        agents = self.agents[ends]
        return np.stack([agents, ends - self.first[agents] - 1], axis=2).reshape(-1, 4)

    def plan(self) -> Plan:
        """Return the plan, up to the step of its last action."""
        done = np.zeros((int(self.steps.max(initial=0)) + 1, self.num_agents), np.int64)
        acting = self.steps > 0
        done[self.steps[acting], self.agents[acting]] = 1
        return self.plan_of(done.cumsum(axis=0))

    def plan_of(self, done: Ints) -> Plan:
        """Return the plan in which the agents have executed `done` (T + 1, N) actions after each step."""
        states = self.first[:-1] + done
        return Plan(self.positions[states], None if self.headings is None else self.headings[states])

    def to_json(self) -> str:
        """Return the graph as JSON; `docs/reference/file-formats.md` describes it.

        Raises `ValueError` if a move is not one to an adjacent cell, or not straight ahead.
        """
        plan = self.plan()
        letters = format_steps(plan, STEPS) if plan.headings is None else format_turns(plan)
        starts = plan.positions[0]
        if plan.headings is not None:
            starts = np.column_stack([starts, plan.headings[0]])
        members: JsonObject = {
            "starts": starts.tolist(),
            "actions": [word.replace(WAIT, "") for word in letters],
            "steps": [self.steps[start + 1 : end].tolist() for start, end in pairwise(self.first.tolist())],
            "dependencies": self.dependencies.tolist(),
        }
        lines = [f"{json.dumps(name)}: {json.dumps(value)}" for name, value in members.items()]
        return "{\n" + ",\n".join(lines) + "\n}\n"

    @classmethod
    def from_json(cls, text: str, origin: str | Path = "dependency graph") -> DependencyGraph:
        """Return the graph of JSON that `to_json` has written.

        Raises `FormatError` with the name `origin` if it is malformed, its paths conflict, or its dependencies are not
        those of its paths and steps.
        """
        data = parse_object(text, origin)
        starts = list_member(data, "starts", origin)
        turns = bool(starts) and isinstance(starts[0], list) and len(starts[0]) == 3
        for agent, start in enumerate(starts):
            if not are_whole(start) or len(start) != 2 + turns or (turns and start[2] not in list(Heading)):
                expected = "[row, col, heading 0 to 3]" if turns else "[row, col]"
                raise FormatError(
                    origin, f"expected the start of agent {agent} to be {expected}, got {shortened(start)}"
                )
        words = _words(data, len(starts), "".join(TURNS) if turns else "".join(STEPS), origin)
        cells = np.array(starts, np.int64).reshape(len(starts), 2 + turns)
        plan = follow_turns(cells[:, :2], cells[:, 2], words) if turns else follow_steps(cells, words, STEPS)
        try:
            graph = cls.from_plan(plan)
        except ValueError as error:
            raise FormatError(origin, str(error)) from None
        if data.get("dependencies") != graph.dependencies.tolist():
            raise FormatError(origin, "expected 'dependencies' to be those of the paths and steps")
        return graph


def _waits_for(agents: Ints, steps: Ints, positions: Ints) -> Ints:
    """Return the state that each state waits for, or `NONE` (S,) int64.

    Args:
        agents: (S,) the agent of each state, in order.
        steps: (S,) the step of the plan that leads to each state, in order for each agent.
        positions: (S, 2) [row, col] in each state.

    Raises `ValueError` if two agents are on one cell after a step, or swap cells.
    """
    num_states = len(agents)
    enter, leave, one, other = find_visits(agents, steps, positions)
    others = agents[enter[one]] != agents[enter[other]]
    leaving, one, other = leave[one[others]], enter[one[others]], enter[other[others]]
    shared = np.append(steps, NEVER)[leaving] > steps[other]
    if shared.any():
        raise _conflict("vertex", steps, agents, positions, one[shared], other[shared])

    waits_for = np.full(num_states, NONE)
    waits_for[other] = leaving
    swapped = waits_for[leaving] == other
    if swapped.any():
        raise _conflict("edge", steps, agents, positions, leaving[swapped], other[swapped])
    return waits_for


def find_visits(agents: Ints, steps: Ints, positions: Ints) -> tuple[Ints, Ints, Ints, Ints]:
    """Return the visits of agents to cells: the states in which they begin and end, and which follow each other.

    Args:
        agents: (S,) the agent of each state, in order.
        steps: (S,) the step of the plan that leads to each state, in order for each agent.
        positions: (S, 2) [row, col] in each state.

    Returns the states in which the V visits begin, the states in which the next ones of the same agents begin (S: the
    agent stays), and the numbers of visits and of the next ones to the same cells (P,), (P,).
    """
    num_states = len(agents)
    enters = np.ones(num_states, np.bool_)
    enters[1:] = (agents[1:] != agents[:-1]) | (positions[1:] != positions[:-1]).any(axis=1)
    enter = np.flatnonzero(enters)
    following = np.append(enter, num_states)[1:]
    leave = np.where(np.append(agents, NONE)[following] == agents[enter], following, num_states)
    order = np.lexsort((steps[enter], *positions[enter].T))
    one, other = order[:-1], order[1:]
    same = (positions[enter[one]] == positions[enter[other]]).all(axis=1)
    return enter, leave, one[same], other[same]


def _conflict(kind: Kind, steps: Ints, agents: Ints, positions: Ints, ones: Ints, others: Ints) -> ValueError:
    """Return the error of the first conflict between the agents that reach the states `ones` and `others`."""
    first = np.argmin(steps[others])
    pair = sorted((int(agents[state]), *positions[state].tolist()) for state in (ones[first], others[first]))
    cells = dict.fromkeys((row, col) for _, row, col in pair)
    violation = Violation(kind, int(steps[others[first]]), (pair[0][0], pair[1][0]), tuple(cells))
    return ValueError(f"plan: {violation}")


def _words(data: JsonObject, num_agents: int, letters: str, origin: str | Path) -> list[str]:
    """Return the letters of each agent's steps, equally many; raises `FormatError` if there are other letters."""
    actions, steps = (list_member(data, name, origin, num_agents) for name in ("actions", "steps"))
    for agent, (word, planned) in enumerate(zip(actions, steps, strict=False)):
        if not isinstance(word, str) or not set(word) <= set(letters) - {WAIT}:
            expected = f"expected the actions of agent {agent} to be letters of {letters.replace(WAIT, '')}"
            raise FormatError(origin, f"{expected}, got {shortened(word)}")
        if not are_whole(planned) or len(planned) != len(word) or any(b <= a for a, b in pairwise([0, *planned])):
            expected = f"expected the steps of agent {agent} to be {len(word)} increasing whole numbers, 1 or more"
            raise FormatError(origin, f"{expected}, got {shortened(planned)}")
    if not len(actions) == len(steps) == num_agents:
        raise FormatError(origin, f"expected {num_agents} items in 'actions' and 'steps', as in 'starts'")
    num_steps = max((planned[-1] for planned in steps if planned), default=0)
    check_size(num_steps, num_agents, origin)
    return [_with_waits(word, planned, num_steps) for word, planned in zip(actions, steps, strict=True)]


def _with_waits(word: str, planned: list[int], num_steps: int) -> str:
    """Return the letters of `num_steps` steps, those of `word` in the steps `planned`."""
    letters = [WAIT] * num_steps
    for letter, step in zip(word, planned, strict=True):
        letters[step - 1] = letter
    return "".join(letters)
