"""Delays: which agents are delayed in a step.

The random numbers of a step are hashes of the episode's key, the step and the agent, so that delays do not depend on
actions, other episodes or threads.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapf_pz._internal.arrays import Bools, Ints
from mapf_pz._internal.jit import Array, inlined, jit
from mapf_pz.instances.delays import NORMAL_DEVIATION, Delays

NEVER, BERNOULLI, POISSON = 0, 1, 2
EVENTS = {"bernoulli": BERNOULLI, "poisson": POISSON}
_COUNT, _CHOICE = 2**32 - 1, 2**32 - 2
"""Numbers in place of an agent's, for the random numbers of a step: how many delays begin, and of which agents."""


class DelayRules(NamedTuple):
    """The delays of a configuration, as the kernels take them."""

    events: int
    probability: float
    smallest: int
    largest: int
    is_normal: bool


def delay_rules(delays: Delays | None) -> DelayRules:
    """Return delays as kernels take them; None: there are none."""
    if delays is None:
        return DelayRules(NEVER, 0.0, 0, 0, is_normal=False)
    is_normal = delays.durations == "normal"
    return DelayRules(EVENTS[delays.events], float(delays.probability), *delays.duration, is_normal)


@jit
def delay_agents(rules: DelayRules, key: np.uint64, time: int, wait: int, agents: Array, actions: Array) -> None:
    """Set which agents are delayed in step `time` (1, 2, ...) of an episode; they wait instead of their actions (N,).

    Those of agents that have disappeared go on, since delays must not depend on actions.
    """
    begin_delays(rules, key, time, agents.delay)
    for i in range(agents.size):
        agent = agents[i]
        agent.delayed = agent.delay > 0
        if agent.delayed:
            agent.delay -= 1
            actions[i] = wait


@jit
def begin_delays(rules: DelayRules, key: np.uint64, time: int, left: Array) -> None:
    """Begin the delays of a step: `left` (N,) int32 is the number of steps that each agent is still delayed."""
    step = mixed(key ^ np.uint64(time))
    if rules.events == BERNOULLI:
        for i in range(left.size):
            if left[i] == 0 and uniform(step, i, 0) < rules.probability:
                left[i] = _duration(rules, step, i)
    else:
        _begin_several(rules, step, left)


@jit
def _begin_several(rules: DelayRules, step: np.uint64, left: Array) -> None:
    """Begin a Poisson distributed number of delays, of agents that are not delayed."""
    free = 0
    for i in range(left.size):
        free += left[i] == 0
    # Events of a Poisson process: the times between them are distributed exponentially.
    mean, time, count = rules.probability * left.size, 0.0, -1
    while time < mean and count < free:
        count += 1
        time -= np.log(1.0 - uniform(step, _COUNT, count))
    if time < mean:
        count = free
    draw = 0
    while count > 0:
        i = int(uniform(step, _CHOICE, draw) * left.size)
        draw += 1
        if left[i] == 0:
            left[i] = _duration(rules, step, i)
            count -= 1


@inlined
def _duration(rules: DelayRules, step: np.uint64, i: int) -> int:
    """Return the number of steps of a delay of agent `i` that begins in a step."""
    span = rules.largest - rules.smallest
    if not rules.is_normal:
        return rules.smallest + int(uniform(step, i, 1) * (span + 1))
    # The method of Box and Muller (1958).
    radius = np.sqrt(-2.0 * np.log(1.0 - uniform(step, i, 1)))
    normal = radius * np.cos(2.0 * np.pi * uniform(step, i, 2))
    steps = int(np.floor(rules.smallest + span * (0.5 + NORMAL_DEVIATION * normal) + 0.5))
    return min(max(steps, rules.smallest), rules.largest)


@inlined
def uniform(step: np.uint64, who: int, draw: int) -> float:
    """Return random number `draw` of an agent in a step, from 0 to less than 1."""
    bits = mixed(mixed(step ^ np.uint64(who)) ^ np.uint64(draw))
    return float(bits >> np.uint64(11)) * 2.0**-53


@inlined
def mixed(bits: np.uint64) -> np.uint64:
    """Return a hash of 64 bits: one step of SplitMix64 (Steele, Lea and Flood, OOPSLA 2014)."""
    bits += np.uint64(0x9E3779B97F4A7C15)
    bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return bits ^ (bits >> np.uint64(31))


def delayed_agents(rules: DelayRules, key: int, num_steps: int, num_agents: int) -> Bools:
    """Return in which steps which agents of an episode are delayed: (T, N) bool."""
    delayed = np.zeros((num_steps, num_agents), np.bool_)
    _write_delayed(rules, np.uint64(key), np.zeros(num_agents, np.int32), delayed)
    return delayed


@jit
def _write_delayed(rules: DelayRules, key: np.uint64, left: Ints, delayed: Bools) -> None:
    for t in range(delayed.shape[0]):
        begin_delays(rules, key, t + 1, left)
        for i in range(left.size):
            delayed[t, i] = left[i] > 0
            left[i] -= delayed[t, i]
