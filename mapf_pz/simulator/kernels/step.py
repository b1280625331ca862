"""One step of the environment: delay, propose, resolve, advance, update goals, compute rewards, finish."""

from __future__ import annotations

from numba import prange

from mapf_pz._internal.jit import Array, BatchKernel, inlined, jit
from mapf_pz.simulator.kernels.conflict import NO_MOVE, direction, propose, resolve, wait_of
from mapf_pz.simulator.kernels.cost_lookup import turned
from mapf_pz.simulator.kernels.delay import NEVER, DelayRules, delay_agents
from mapf_pz.simulator.kernels.reward import RewardTerms, compute_rewards, measure_progress
from mapf_pz.simulator.kernels.state import WAIT_WEIGHT, CostToGo, Distances, Fields, Rules, State, World

NOTHING, FINISH, RESTART = 0, 1, 2
ON_TARGET = {"nothing": NOTHING, "finish": FINISH, "restart": RESTART}


@BatchKernel
def step(
    rule_fields: Fields, delay_fields: Fields, term_fields: Fields, world_fields: Fields, distance_fields: Fields,
    state_fields: Fields, all_actions: Array
) -> None:  # fmt: skip
    """Advance all environments by one step.

    `all_actions` (B, N) int64, in which those of delayed agents are replaced; the others are the fields of `Rules`,
    `DelayRules`, `RewardTerms`, `World`, `Distances`, `State`.
    """
    rules, delays = Rules(*rule_fields), DelayRules(*delay_fields)
    terms, world = RewardTerms(*term_fields), World(*world_fields)
    distances, state = Distances(*distance_fields), State(*state_fields)
    to_go = CostToGo(distances.packed, distances.exact, distances.least)
    for b in prange(all_actions.shape[0]):
        m, agents, occupant, claim = state.map[b], state.agents[b], state.occupant[b], state.claim[b]
        time, actions = tick(state.time, b), all_actions[b]

        if delays.events != NEVER:
            delay_agents(delays, state.delay_key[b], time, wait_of(rules.cardinal), agents, actions)
        propose(rules.cardinal, world.leads_to, m, agents, actions)
        resolve(rules.collision, agents, occupant, claim)
        advance(rules.cardinal, world.weight, m, agents, actions, occupant, state.history[b])
        solved = update_goals(rules.on_target, agents, state.goals[b], time)
        add_weights(agents, time)
        measure_progress(terms.progress, world.mean_weight[m], to_go, agents)
        compute_rewards(
            terms, rules.cardinal, world.mean_weight[m], world.height, world.width, agents, actions, occupant, solved
        )
        finish(rules.on_target, agents, occupant, solved, time >= rules.max_steps)
        end_episode(agents, state.terminated, state.truncated, b)


@jit
def tick(times: Array, b: int) -> int:
    """Count a step of environment `b`, and return the number of its steps."""
    times[b] += 1
    return times[b]


@inlined
def advance(
    cardinal: bool, weight: Array, m: int, agents: Array, actions: Array, occupant: Array, history: Array
) -> None:
    """Move each agent to its next cell, turn it, and record its action and the weight of its step on map `m`."""
    for i in range(agents.size):
        agent = agents[i]
        agent.was_active = agent.active
        agent.was_cell = agent.cell
        agent.was_heading = agent.heading
        agent.was_goal = agent.goal
        agent.blocked = False
        agent.step_weight = 0
        if agent.active:
            occupant[agent.cell] = -1
    for i in range(agents.size):
        agent = agents[i]
        if agent.active:
            moves = agent.want != agent.cell
            towards = direction(cardinal, agent.heading, actions[i])
            agent.blocked = not moves and towards != NO_MOVE
            agent.step_weight = weight[m, towards if moves else WAIT_WEIGHT, agent.cell]
            agent.cell = agent.want
            if not cardinal:
                agent.heading = turned(agent.heading, actions[i])
            occupant[agent.cell] = i
            _record(history, i, actions[i], moves)


@inlined
def _record(history: Array, i: int, action: int, moved: bool) -> None:
    for k in range(history.shape[1] - 1, 0, -1):
        history[i, k, 0] = history[i, k - 1, 0]
        history[i, k, 1] = history[i, k - 1, 1]
    history[i, 0, 0] = action
    history[i, 0, 1] = moved


@inlined
def update_goals(on_target: int, agents: Array, goals: Array, time: int) -> bool:
    """Count arrivals and assign new goals; return whether all agents are at their goals at the same time."""
    solved = on_target == NOTHING
    for i in range(agents.size):
        agent = agents[i]
        agent.at_goal = agent.active and agent.cell == agent.goal
        agent.arrived = agent.at_goal and (on_target != NOTHING or agent.arrivals == 0)
        solved &= agent.at_goal
        if agent.arrived:
            agent.arrivals += 1
        if agent.active and not agent.at_goal:
            agent.resting_since = -1
        elif agent.resting_since < 0:
            agent.resting_since = time
        if agent.arrived and on_target == RESTART:
            agent.goal = goals[i, agent.arrivals % goals.shape[1]]
    return solved


@inlined
def add_weights(agents: Array, time: int) -> None:
    """Add the weight of each agent's step; its cost is the sum until the step since which it is on its goal."""
    for i in range(agents.size):
        agent = agents[i]
        agent.path_weight += agent.step_weight
        if agent.resting_since == -1 or agent.resting_since == time:
            agent.weighted_cost = agent.path_weight


@inlined
def finish(on_target: int, agents: Array, occupant: Array, solved: bool, late: bool) -> None:
    """Terminate all agents once solved and agents that finish, and truncate the others at the time limit."""
    for i in range(agents.size):
        agent = agents[i]
        agent.terminated = solved or (agent.arrived and on_target == FINISH)
        agent.truncated = late and agent.active and not agent.terminated
        if agent.arrived and on_target == FINISH:
            occupant[agent.cell] = -1
            agent.active = False


@jit
def end_episode(agents: Array, terminated: Array, truncated: Array, b: int) -> None:
    """Set whether the episode of environment `b` is over."""
    all_ended, any_late = True, False
    for i in range(agents.size):
        all_ended &= agents[i].terminated or not agents[i].active
        any_late |= agents[i].truncated
    terminated[b], truncated[b] = all_ended, any_late
