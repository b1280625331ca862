"""The delays of an episode in plain Python, written from their definition alone."""

from __future__ import annotations

from math import cos, floor, log, pi, sqrt

from mapf_pz.instances.delays import Delays

BITS = 2**64 - 1
COUNT, CHOICE = 2**32 - 1, 2**32 - 2


def split_mix(number: int) -> int:
    number = (number + 0x9E3779B97F4A7C15) & BITS
    number = ((number ^ (number >> 30)) * 0xBF58476D1CE4E5B9) & BITS
    number = ((number ^ (number >> 27)) * 0x94D049BB133111EB) & BITS
    return number ^ (number >> 31)


class ReferenceDelays:
    """Which of N agents are delayed, step by step: `left` is how many more steps each of them is."""

    def __init__(self, delays: Delays, key: int, num_agents: int) -> None:
        self.delays, self.key = delays, key
        self.left = [0] * num_agents
        self.time = 0

    def number(self, who: int, draw: int) -> float:
        return (split_mix(split_mix(split_mix(self.key ^ self.time) ^ who) ^ draw) >> 11) / 2**53

    def step(self) -> list[bool]:
        self.time += 1
        free = [agent for agent, left in enumerate(self.left) if left == 0]
        for agent in self.chosen(free):
            self.left[agent] = self.steps(agent)
        delayed = [left > 0 for left in self.left]
        self.left = [max(left - 1, 0) for left in self.left]
        return delayed

    def chosen(self, free: list[int]) -> list[int]:
        probability = self.delays.probability
        if self.delays.events == "bernoulli":
            return [agent for agent in free if self.number(agent, 0) < probability]
        events, waited = 0, -log(1 - self.number(COUNT, 0))
        while waited < probability * len(self.left) and events < len(free):
            events += 1
            waited -= log(1 - self.number(COUNT, events))
        chosen: list[int] = []
        draw = 0
        while len(chosen) < events:
            agent = int(self.number(CHOICE, draw) * len(self.left))
            draw += 1
            if agent in free and agent not in chosen:
                chosen.append(agent)
        return chosen

    def steps(self, agent: int) -> int:
        smallest, largest = self.delays.duration
        if self.delays.durations == "uniform":
            return smallest + int(self.number(agent, 1) * (largest - smallest + 1))
        normal = sqrt(-2 * log(1 - self.number(agent, 1))) * cos(2 * pi * self.number(agent, 2))
        mean, deviation = (smallest + largest) / 2, 0.22 * (largest - smallest)
        return min(max(floor(mean + deviation * normal + 0.5), smallest), largest)
