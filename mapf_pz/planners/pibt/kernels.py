"""Priority inheritance with backtracking (PIBT): one collision-free step of all agents of one environment.

Okumura et al., *Priority Inheritance with Backtracking for Iterative Multi-Agent Path Finding*, AIJ 2022. Agents choose
their next cells in priority order. An agent that wants an occupied cell lends its priority to the occupant, which must
find another cell at once, or report that there is none.

For rotating agents, cells are chosen in the same way, by the cost to go from cell and heading. An agent keeps its
chosen cell until it gets there, and enters it only if the cell is empty or its occupant leaves in the same step (the
causal PIBT of the League of Robot Runners).
"""

from __future__ import annotations

from mapf_pz._internal.jit import Array, jit
from mapf_pz.planners.pibt.preference import rank_choices
from mapf_pz.planners.pibt.priority import prioritize
from mapf_pz.planners.pibt.state import NO_AGENT, STAY, UNDECIDED, Options, PibtState
from mapf_pz.planners.pibt.swap import find_partner, pull_agents
from mapf_pz.simulator.actions import Action, CardinalAction
from mapf_pz.simulator.kernels.cost_lookup import num_headings
from mapf_pz.simulator.kernels.state import PlanningView

_FORWARD, _LEFT, _RIGHT, _WAIT = map(int, Action)
CARDINAL_ACTIONS = tuple(int(CardinalAction[name]) for name in ("RIGHT", "DOWN", "LEFT", "UP", "WAIT"))
"""The action that moves in the direction of each heading, and the wait action."""


@jit
def plan(planning_view: PlanningView, passing: bool, options: Options, state: PibtState, actions: Array) -> None:
    """Write an action (N,) int64 for each agent.

    With `passing`, an agent only has to pass its goal; otherwise it must stay there.
    """
    prepare(planning_view, passing, options, state)
    decide(planning_view, passing, options.swap, state)
    write_actions(planning_view, state, actions)


@jit
def prepare(planning_view: PlanningView, passing: bool, options: Options, state: PibtState) -> None:
    """Set the agents' order, and the ranks of the choices of those that are undecided; others keep their cells."""
    agents, rotates = planning_view.agents, num_headings(planning_view.to_go) == 4
    prioritize(planning_view, passing, options.priority, state)
    state.taken[:] = NO_AGENT
    for i in range(agents.size):
        if not agents[i].active:
            state.want[i], state.choice[i] = agents[i].cell, STAY
        elif rotates and state.want[i] != UNDECIDED and state.want[i] != agents[i].cell:
            state.taken[state.want[i]] = i
        else:
            state.want[i] = UNDECIDED
    rank_choices(planning_view, options.hindrance, state)


@jit
def decide(planning_view: PlanningView, passing: bool, swap: bool, state: PibtState) -> None:
    """Set `state.want` of all undecided agents, in `state.order`, by the ranks of their choices.

    Each of them finds a cell together with all agents that must move away for it. With `swap`, agents change places.
    """
    leads_to, agents, occupant = planning_view.leads_to, planning_view.agents, planning_view.occupant
    want, taken, chain = state.want, state.taken, state.chain
    for first in state.order:
        depth = 0
        if want[first] == UNDECIDED:
            chain[0], state.tried[first] = first, 0
            depth = 1
        while depth > 0:
            i = chain[depth - 1]
            here, rank = agents[i].cell, state.rank[i]
            if swap and state.tried[i] == 0:
                state.pull[i] = find_partner(planning_view, passing, i, want, rank)
            k = _next_possible(leads_to, occupant, want, taken, here, rank, state.tried[i])
            state.tried[i] = k + 1
            if k == rank.size:
                # No cell is left: the previous agent in the chain must try another one.
                want[i], state.choice[i] = here, STAY
                taken[here] = i
                depth -= 1
                continue
            choice = rank[k] & 7
            target = here if choice == STAY else leads_to[choice, here]
            want[i], state.choice[i] = target, choice
            taken[target] = i
            other = occupant[target]
            if other == NO_AGENT or want[other] != UNDECIDED:
                if swap:
                    pull_agents(planning_view, passing, depth, state)
                break
            chain[depth], state.tried[other] = other, 0
            depth += 1


@jit
def _next_possible(
    leads_to: Array, occupant: Array, want: Array, taken: Array, here: int, rank: Array, start: int
) -> int:
    """Return the index in `rank` (5,) of the first choice from `start` on that is possible now, or 5."""
    for k in range(start, rank.size):
        choice = rank[k] & 7
        cell = here if choice == STAY else leads_to[choice, here]
        if choice > STAY or (choice < STAY and cell == here) or taken[cell] != NO_AGENT:
            continue
        other = occupant[cell]
        if cell != here and other != NO_AGENT and want[other] == here:
            continue  # they would swap
        return k
    return rank.size


@jit
def write_actions(planning_view: PlanningView, state: PibtState, actions: Array) -> None:
    """Write the action (N,) int64 that brings each agent to the cell in `state.want`, or closer to it."""
    if num_headings(planning_view.to_go) == 4:
        _write_rotating(planning_view, state, actions)
    else:
        for i in range(actions.size):
            actions[i] = CARDINAL_ACTIONS[state.choice[i]]


@jit
def _write_rotating(planning_view: PlanningView, state: PibtState, actions: Array) -> None:
    """Write the action that brings each agent closer to the cell in `state.want`.

    Agents turn first. Then they move forward if the cell is empty or its occupant leaves it in this step, which may be
    around a cycle.
    """
    agents = planning_view.agents
    for i in range(agents.size):
        direction = state.choice[i]
        turn = (direction - agents[i].heading) & 3
        actions[i] = _WAIT if direction == STAY else (_FORWARD if turn == 0 else (_LEFT if turn == 3 else _RIGHT))
    state.resolved[:] = False
    for i in range(agents.size):
        if actions[i] == _FORWARD and not state.resolved[i]:
            _resolve_queue(planning_view.occupant, state, actions, i)


@jit
def _resolve_queue(occupant: Array, state: PibtState, actions: Array, first: int) -> None:
    """Let the queue that starts with `first` move forward, or wait if the agent at its head does not move away."""
    length, i = 0, first
    while i != NO_AGENT and actions[i] == _FORWARD and not state.resolved[i]:
        state.chain[length] = i
        length += 1
        state.resolved[i] = True
        i = occupant[state.want[i]]
    if i != NO_AGENT and actions[i] != _FORWARD:
        for k in range(length):
            actions[state.chain[k]] = _WAIT
