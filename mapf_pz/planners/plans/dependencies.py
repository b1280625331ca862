"""The action dependency graph of a plan, and its execution when agents are delayed."""

from __future__ import annotations

import json
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from reprlib import repr as shortened

import numpy as np

from mapf_pz._internal.arrays import Bools, EqualByValue, Ints, frozen
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
        return self._plan_of(done.cumsum(axis=0))

    def execute(self, delayed: Bools) -> Plan:
        """Return the plan that is executed if agents are delayed, until all actions have been executed.

        Args:
            delayed: (T', N) bool: which agents do not act in each step; after step T', none are delayed.

        Raises `ValueError` for another shape.
        """
        delayed = np.asarray(delayed, np.bool_)
        if delayed.shape[1:] != (self.num_agents,):
            raise ValueError(f"delayed: expected the shape (T', {self.num_agents}), got {delayed.shape}")
        execution = Execution(self)
        done = [execution.done.copy()]
        while not execution.is_finished:
            step = len(done) - 1
            execution.advance(execution.permitted(delayed[step] if step < len(delayed) else None))
            done.append(execution.done.copy())
        return self._plan_of(np.stack(done))

    def _plan_of(self, done: Ints) -> Plan:
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


class Execution:
    """The execution of a dependency graph, step by step: `permitted` agents act, then `advance` counts their actions.

    Delays may be unknown before a step. If all agents try to act that are permitted without delays, the collision
    system `soft` stops each agent that moves to the cell of one that stays, then those behind it. So exactly the agents
    act that are permitted with these delays.
    """

    def __init__(self, graph: DependencyGraph) -> None:
        """Start with all agents at their starts."""
        self.graph = graph
        """The graph."""
        self.done: Ints = np.zeros(graph.num_agents, np.int64)
        """(N,) int64: the number of actions that each agent has executed."""
        self._agents = graph.agents

    @property
    def states(self) -> Ints:
        """(N,) int64: the state of each agent."""
        return self.graph.first[:-1] + self.done

    @property
    def next_states(self) -> Ints:
        """(N,) int64: the state that each agent's next action leads to; the last state if there is none."""
        return np.minimum(self.states + 1, self.graph.first[1:] - 1)

    @property
    def is_finished(self) -> bool:
        """Whether all actions have been executed."""
        return bool((self.done == self.graph.num_actions).all())

    def permitted(self, delayed: Bools | None = None) -> Bools:
        """Return which agents (N,) execute their next action in this step.

        Args:
            delayed: (N,) bool: the agents that do not act in this step. None: no agent.
        """
        states, next_states = self.states, self.next_states
        awaited = self.graph.waits_for[next_states]
        leaders = self._agents[awaited]  # of no meaning for `NONE`, which is reached
        reached = awaited <= states[leaders]
        acts = (next_states > states) & (reached | (awaited == next_states[leaders]))
        if delayed is not None:
            acts &= ~delayed
        # An agent stays if its leader stays, or the leader's leader: chains and cycles have up to N agents.
        leaders = np.where(reached, np.arange(len(states)), leaders)
        for _ in range(len(states).bit_length()):
            acts &= acts[leaders]
            leaders = leaders[leaders]  # the next round looks twice as far
        return acts

    def waiting_for(self, delayed: Bools) -> Ints:
        """Return the agent (N,) int64 that each agent waits for in this step.

        It is `NONE` for agents that act, are delayed themselves, or have no action left.

        Args:
            delayed: (N,) bool: the agents that do not act in this step.
        """
        waits = (self.next_states > self.states) & ~delayed & ~self.permitted(delayed)
        return np.where(waits, self._agents[self.graph.waits_for[self.next_states]], NONE)

    def allows(self, acted: Bools) -> bool:
        """Return whether exactly the agents `acted` (N,) may execute their next action in the same step."""
        return np.array_equal(self.permitted(~acted), acted)

    def advance(self, acted: Bools) -> None:
        """Count the actions that the agents `acted` (N,) have executed in a step.

        Raises `ValueError` if an agent had no action left, or did not wait as the graph says.
        """
        if not self.allows(acted):
            agent = np.flatnonzero(acted & ~self.permitted(~acted))[0]
            raise ValueError(f"agent {agent}: expected it to wait in this step")
        self.done = self.done + acted

    def lateness(self, step: int) -> Ints:
        """Return by how many steps (N,) each agent is behind the plan after `step` steps; 0 if it is not."""
        late = step + 1 - self.graph.steps[self.next_states]
        return np.where(self.next_states > self.states, np.maximum(late, 0), 0)


def _waits_for(agents: Ints, steps: Ints, positions: Ints) -> Ints:
    """Return the state that each state waits for, or `NONE` (S,) int64.

    Args:
        agents: (S,) the agent of each state, in order.
        steps: (S,) the step of the plan that leads to each state, in order for each agent.
        positions: (S, 2) [row, col] in each state.

    Raises `ValueError` if two agents are on one cell after a step, or swap cells.
    """
    num_states = len(agents)
    enters = np.ones(num_states, np.bool_)
    enters[1:] = (agents[1:] != agents[:-1]) | (positions[1:] != positions[:-1]).any(axis=1)
    entered = np.flatnonzero(enters)
    # An agent leaves a cell by the action with which it enters the next one; never: `num_states`.
    following = np.append(entered, num_states)[1:]
    left = np.where(np.append(agents, NONE)[following] == agents[entered], following, num_states)

    order = np.lexsort((steps[entered], *positions[entered].T))
    one, other, leaving = entered[order[:-1]], entered[order[1:]], left[order[:-1]]
    after = (positions[one] == positions[other]).all(axis=1) & (agents[one] != agents[other])
    one, other, leaving = one[after], other[after], leaving[after]
    shared = np.append(steps, NEVER)[leaving] > steps[other]
    if shared.any():
        raise _conflict("vertex", steps, agents, positions, one[shared], other[shared])

    waits_for = np.full(num_states, NONE)
    waits_for[other] = leaving
    swapped = waits_for[leaving] == other
    if swapped.any():
        raise _conflict("edge", steps, agents, positions, leaving[swapped], other[swapped])
    return waits_for


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
