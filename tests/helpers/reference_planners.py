"""PIBT, its safety layer and EPIBT in plain Python, by recursion and dictionaries: what the kernels must do."""

from itertools import pairwise, product

import numpy as np

from mapf_pz.simulator.actions import CardinalAction

STEPS = ((0, 1), (1, 0), (0, -1), (-1, 0))
LETTERS = "FRLW"
ACTION = {"F": 0, "L": 1, "R": 2, "W": 3}
CARDINAL = [int(CardinalAction[name]) for name in ("RIGHT", "DOWN", "LEFT", "UP", "WAIT")]


class World:
    """A map, and the cost to go to each goal from (row, col, heading); all weights are 1."""

    def __init__(self, free):
        self.free = {(int(row), int(col)) for row, col in np.argwhere(free)}
        self._tables = {}

    def to_go(self, goal):
        """Return the cost from every state, by breadth-first search backwards from the goal."""
        if goal not in self._tables:
            table = {(*goal, heading): 0 for heading in range(4)}
            queue = list(table)
            for row, col, heading in queue:
                behind = (row - STEPS[heading][0], col - STEPS[heading][1], heading)
                for state in (behind, (row, col, (heading + 1) % 4), (row, col, (heading + 3) % 4)):
                    if state[:2] in self.free and state not in table:
                        table[state] = table[row, col, heading] + 1
                        queue.append(state)
            self._tables[goal] = table
        return self._tables[goal]


class CardinalWorld(World):
    """A map for cardinal agents, whose cost to go is the same for all headings."""

    def to_go(self, goal):
        """Return the cost from every state, by breadth-first search from the goal."""
        if goal not in self._tables:
            cost, queue = {goal: 0}, [goal]
            for row, col in queue:
                for down, right in STEPS:
                    cell = (row + down, col + right)
                    if cell in self.free and cell not in cost:
                        cost[cell] = cost[row, col] + 1
                        queue.append(cell)
            self._tables[goal] = {(*cell, heading): steps for cell, steps in cost.items() for heading in range(4)}
        return self._tables[goal]


def act(state, letter):
    """Return the state after an action."""
    row, col, heading = state
    if letter == "F":
        return row + STEPS[heading][0], col + STEPS[heading][1], heading
    return row, col, (heading + {"R": 1, "L": 3, "W": 0}[letter]) % 4


def trace(letters):
    """Return the cells that actions lead over, and the heading at their end."""
    states = [(0, 0, 0)]
    for letter in letters:
        states.append(act(states[-1], letter))
    return (*(state[:2] for state in states), states[-1][2])


def lateness(letters):
    """Return the sort key of an operation: actions that do not move, cells that it visits again, bends."""
    depth = len(letters)
    still = sum(
        10 + {"R": 12, "L": 12, "W": 13}[letter] * (depth - t) for t, letter in enumerate(letters) if letter != "F"
    )
    cells = trace(letters)[:-1]
    again = sum(depth - t for t in range(depth) if cells[t + 1] in cells[: t + 1])
    return still, again, sum((one == "F") != (other == "F") for one, other in pairwise(letters))


def operations(depth):
    """Return the operations, the earliest first: no turns after the last move, no needless turns, no two alike."""
    chosen = {}
    for letters in sorted(map("".join, product(LETTERS, repeat=depth)), key=lateness):
        runs = letters.split("F")
        if (len(runs) > 1 or depth > 2) and runs[-1].strip("W"):
            continue
        if any(("R" in run and "L" in run) or len(run.replace("W", "")) > 2 for run in runs):
            continue
        chosen.setdefault(trace(letters), letters)
    return list(chosen.values())


class SlowEPIBT:
    """Plans for lifelong episodes; an operation is the number of its place in the list."""

    def __init__(self, world, depth, additional=()):
        self.world, self.operations = world, [*operations(depth), *additional]
        self.num_regular = len(self.operations) - len(additional)
        places = {trace(letters): place for place, letters in enumerate(self.operations)}
        self.rest = [places[trace(letters[1:] + "W")] for letters in self.operations]
        self.waits = places[trace("W" * depth)]
        self.known = {}
        self.chosen = self.expected = None

    def paths(self, state):
        """Return the states of each operation that does not lead into an obstacle."""
        if state not in self.known:
            self.known[state] = {}
            for place, letters in enumerate(self.operations):
                path = [state]
                for letter in letters:
                    path.append(act(path[-1], letter))
                if all(reached[:2] in self.world.free for reached in path):
                    self.known[state][place] = path
        return self.known[state]

    def decide(self, states, goals):
        """Return a letter for each agent at `states` [(row, col, heading)] with `goals` [(row, col)]."""
        agents = range(len(states))
        as_planned = self.expected == list(states)
        self.chosen = [self.rest[place] if as_planned else self.waits for place in self.chosen or agents]
        self.options = [self.paths(state) for state in states]
        self.costs, self.sorted, away = [], [], []
        for agent, options, state, goal in zip(agents, self.options, states, goals, strict=True):
            table, costs = self.world.to_go(goal), {}
            for place, path in options.items():
                reached = next((t for t, at in enumerate(path[1:], 1) if at[:2] == goal), None)
                costs[place] = len(path) - 1 + table[path[-1]] if reached is None else reached
            self.costs.append(costs)
            self.sorted.append(self.ranked(agent, costs))
            away.append(table[state])
        self.used = {}
        for agent in agents:
            self.put(agent)
        self.rank = {agent: rank for rank, agent in enumerate(sorted(agents, key=lambda agent: away[agent]))}
        self.visits = dict.fromkeys(agents, 0)
        for agent in self.rank:
            had = self.chosen[agent]
            self.take(agent)
            if not self.search(agent, agent, set(), had):
                self.chosen[agent] = had
                self.put(agent)
        self.expected = [self.options[agent][self.chosen[agent]][1] for agent in agents]
        return [self.operations[place][0] for place in self.chosen]

    def ranked(self, agent, costs):
        """Return the operations that an agent may choose, the best first."""
        chosen = [place for place in costs if place < self.num_regular and place != self.waits]
        return sorted(chosen, key=lambda place: (costs[place], place))

    def put(self, agent):
        """Reserve an agent's cells."""
        for t, state in enumerate(self.options[agent][self.chosen[agent]]):
            self.used[t, state[:2]] = agent

    def take(self, agent):
        """Release them, but for the cell where it is now."""
        for t, state in enumerate(self.options[agent][self.chosen[agent]][1:], 1):
            del self.used[t, state[:2]]

    def conflicts(self, path):
        """Return the agents that share a cell with this path, or change places with it."""
        found = set()
        for t in range(1, len(path)):
            here, there = path[t - 1][:2], path[t][:2]
            found.add(self.used.get((t, there)))
            leaving = self.used.get((t - 1, there))
            if here != there and self.used.get((t, here)) == leaving:
                found.add(leaving)
        return found - {None}

    def search(self, agent, first, asking, end):
        """Find an operation that comes before `end` for an agent that has none; tell whether there is one."""
        for place in self.sorted[agent]:
            if place == end:
                return False
            others = self.conflicts(self.options[agent][place])
            if len(others) > 1:
                continue
            self.chosen[agent] = place
            if not others:
                self.put(agent)
                return True
            (other,) = others
            if other in asking or self.visits[other] >= 10 or self.rank[other] < self.rank[first]:
                continue
            self.visits[other] += 1
            had = self.chosen[other]
            self.take(other)
            self.put(agent)
            if self.search(other, first, asking | {agent}, None):
                return True
            self.take(agent)
            self.chosen[other] = had
            self.put(other)
        return False


STAY = 4


class SlowPIBT:
    """Causal PIBT: agents plan their next cells, turn towards them, and drive when the way clears.

    Agents only have to pass their goals, unless they must stay there (`stays`).
    """

    def __init__(self, world, seed=0, stays=False):
        self.world, self.stays = world, stays
        self.random = int(np.random.default_rng(seed).integers(1, 2**63))
        self.want = self.goals = None

    def decide(self, states, goals):
        """Return a letter for each agent at `states` [(row, col, heading)] with `goals` [(row, col)]."""
        agents = range(len(states))
        self.tables = [self.world.to_go(goal) for goal in goals]
        if self.want is None:
            self.want, self.goals = [None] * len(states), [None] * len(states)
            self.away, self.first = [0] * len(states), [0] * len(states)
        for agent in agents:
            at_goal = states[agent][:2] == goals[agent]  # the next goal may be the same cell again
            first = self.goals[agent] != goals[agent]
            begins = first or (at_goal and not self.stays)
            self.away[agent] = 0 if first or at_goal else self.away[agent] + 1
            self.first[agent] = self.tables[agent][states[agent]] if begins else self.first[agent]
        self.states, self.goals = states, goals
        self.cells = cells = [state[:2] for state in states]
        self.occupant = {cell: agent for agent, cell in enumerate(cells)}
        self.want = [None if want == cell else want for want, cell in zip(self.want, cells, strict=True)]
        self.taken = {want: agent for agent, want in enumerate(self.want) if want is not None}
        self.ties = [self.draw() if want is None else None for want in self.want]
        self.closer = [self.cells_nearer(agent) if self.want[agent] is None else {self.want[agent]} for agent in agents]
        self.demand = {}
        for agent in agents:
            for cell in self.closer[agent] if self.want[agent] is None else ():
                self.demand[cell] = self.demand.get(cell, 0) + 1
        for agent in sorted(agents, key=self.priority):
            if self.want[agent] is None:
                self.search(agent)
        letters = [self.letter(agent) for agent in agents]
        for agent in agents:
            queue = []
            while agent is not None and letters[agent] == "F" and agent not in queue:
                queue.append(agent)
                agent = self.occupant.get(self.want[agent])
            if agent is not None and letters[agent] != "F":
                for held in queue:
                    letters[held] = "W"
        return letters

    def priority(self, agent):
        """Return the sort key of an agent: late ones first, then the nearest; if they must stay, by the time away."""
        if self.stays:
            return -self.away[agent], self.first[agent]
        return self.away[agent] <= 4 * self.first[agent], self.tables[agent][self.states[agent]]

    def beside(self, cell):
        """Return the free cells beside a cell, by direction."""
        beside = {choice: (cell[0] + step[0], cell[1] + step[1]) for choice, step in enumerate(STEPS)}
        return {choice: cell for choice, cell in beside.items() if cell in self.world.free}

    def cells_nearer(self, agent):
        """Return the cells beside an agent that are nearer to its goal."""
        table = self.tables[agent]
        near = self.beside(self.cells[agent]).items()
        return {cell for choice, cell in near if table[(*cell, choice)] < table[self.states[agent]]}

    def hindered(self, agent, choice):
        """Return how many agents another one hinders if it takes a choice."""
        here = self.cells[agent]
        cell = here if choice == STAY else self.beside(here)[choice]
        count = self.demand.get(cell, 0) - (cell in self.closer[agent])
        for direction, beside in self.beside(here).items():
            other = self.occupant.get(beside)
            if choice != STAY and other is not None and here in self.closer[other]:
                table = self.tables[other]
                count += table[(*cell, choice)] < table[(*here, (direction + 2) % 4)]
        return count

    def draw(self):
        """Return five numbers of 12 random bits (Marsaglia's xorshift)."""
        x = self.random
        x ^= x << 13 & 2**64 - 1
        x ^= x >> 7
        x ^= x << 17 & 2**64 - 1
        self.random = x
        return [x >> 12 * choice & 0xFFF for choice in range(5)]

    def search(self, agent):
        """Find a cell for an agent; tell whether there is one but its own."""
        here = self.cells[agent]
        choices = self.choices(agent)
        leaves = self.faces(agent, choices[0]) if self.stays else self.leaves(agent, choices[0])
        if leaves is not None:
            choices.reverse()
        for choice in choices:
            cell = here if choice == STAY else self.beside(here)[choice]
            if cell in self.taken:
                continue
            other = self.occupant.get(cell)
            if other is not None and other != agent and self.want[other] == here:
                continue
            self.want[agent] = cell
            self.taken[cell] = agent
            if other is None or self.want[other] is not None or self.search(other):
                if leaves is not None and self.follows(leaves, agent, choice == choices[0]):
                    self.want[leaves] = here
                    self.taken[here] = leaves
                return True
        self.want[agent] = here
        self.taken[here] = agent
        return False

    def choices(self, agent):
        """Return an agent's choices, the best first."""
        return sorted(
            [*self.beside(self.cells[agent]), STAY],
            key=lambda choice: (self.cost(agent, choice), self.hindered(agent, choice), self.ties[agent][choice]),
        )

    def follows(self, leaves, agent, as_wanted):
        """Tell whether an agent can follow the one that makes room for it."""
        free = self.want[leaves] is None and self.cells[agent] not in self.taken
        return free and (as_wanted if self.stays else self.want[agent] != self.cells[leaves])

    def faces(self, agent, first):
        """Return the agent that this one must change places with in a corridor, or None."""
        here = self.cells[agent]
        best = self.beside(here).get(first)
        if best is None or not self.opens(best, here):
            return None
        ahead = self.occupant.get(best)
        if ahead is not None and self.want[ahead] is None and self.collide(agent, ahead, here, best):
            return ahead
        behind = [self.occupant.get(cell) for cell in self.beside(here).values() if cell != best]
        return next((other for other in behind if other is not None and self.collide(other, agent, here, best)), None)

    def collide(self, pusher, puller, back, front):
        """Tell whether the pusher, on the way from `back` over `front`, pushes the puller away from its goal."""
        if self.goals[pusher] == self.goals[puller]:
            return False
        while self.near(pusher, front) < self.near(pusher, back):
            ways = self.ways(back, front)
            if len(ways) > 1:
                return False
            if not ways:
                break
            back, front = front, ways[0]
        wants = self.near(pusher, back) == 0 or self.near(pusher, front) < self.near(pusher, back)
        return wants and self.near(puller, back) < self.near(puller, front)

    def opens(self, back, front):
        """Tell whether the way from `back` over `front` leads to a branch."""
        start = back
        while front != start:
            ways = self.ways(back, front)
            if len(ways) != 1:
                return len(ways) > 1
            back, front = front, ways[0]
        return False

    def ways(self, back, front):
        """Return the cells to go on to; dead ends whose agents are at their goals are none."""
        ways = [cell for cell in self.beside(front).values() if cell != back]
        resting = [cell for cell in ways if cell in self.occupant and self.goals[self.occupant[cell]] == cell]
        return [cell for cell in ways if cell not in resting or len(self.beside(cell)) > 1]

    def near(self, agent, cell):
        """Return the cost to an agent's goal from a cell, in the best heading."""
        return min(self.tables[agent].get((*cell, heading), float("inf")) for heading in range(4))

    def leaves(self, agent, first):
        """Return the agent that must leave the dead end where this one's goal is, or None."""
        here, goal = self.cells[agent], self.goals[agent]
        best = self.beside(here).get(first)
        other = self.occupant.get(best)
        if other is None or self.want[other] is not None or self.goals[other] == goal:
            return None
        inside, outside = self.corridor(here, best), self.corridor(best, here)
        ends = inside[-1] == goal and goal not in inside[:-1] and len(self.beside(goal)) == 1
        return other if ends and len(self.beside(outside[-1])) > 2 else None

    def corridor(self, before, cell):
        """Return the cells of a corridor from `cell` on, up to and with a branch, a dead end, or where it began."""
        start, cells = before, [cell]
        while len(self.beside(cell)) == 2:
            (onward,) = set(self.beside(cell).values()) - {before}
            if onward == start:
                break
            before, cell = cell, onward
            cells.append(cell)
        return cells

    def cost(self, agent, choice):
        """Return the cost of moving to a neighbour and on to the goal, or of staying."""
        row, col, heading = self.states[agent]
        if choice == STAY:
            return 0 if (row, col) == self.goals[agent] else 1 + self.tables[agent][row, col, heading]
        turns = (choice - heading) % 4
        target = (row + STEPS[choice][0], col + STEPS[choice][1], choice)
        return 1 + min(turns, 4 - turns) + self.tables[agent].get(target, float("inf"))

    def letter(self, agent):
        """Return the action that brings an agent nearer to the cell that it wants."""
        row, col, heading = self.states[agent]
        step = (self.want[agent][0] - row, self.want[agent][1] - col)
        return "W" if step == (0, 0) else "FRRL"[(STEPS.index(step) - heading) % 4]


class Progress:
    """Finds the agents that ignore their preferences, as they have come no closer to their goals for some steps."""

    def __init__(self, world, patience):
        self.world, self.patience = world, patience
        self.goals = None

    def stuck(self, states, goals):
        """Return these agents in the next step."""
        if self.goals is None:
            self.goals, self.nearest = [None] * len(goals), [None] * len(goals)
            self.waited, self.ignores = [0] * len(goals), [0] * len(goals)
        for agent, (state, goal) in enumerate(zip(states, goals, strict=True)):
            cost = self.world.to_go(goal)[state]
            progress = self.goals[agent] != goal or cost == 0 or cost < self.nearest[agent]
            self.nearest[agent] = cost if progress else self.nearest[agent]
            if self.ignores[agent] == 0:
                self.waited[agent] = 0 if progress else self.waited[agent] + 1
                self.ignores[agent] = self.patience if self.waited[agent] == self.patience else 0
            else:
                self.waited[agent] = 0
                self.ignores[agent] -= 1
        self.goals = goals
        return {agent for agent, steps in enumerate(self.ignores) if steps > 0}


class SlowRotatingShield(SlowEPIBT):
    """The safety layer for agents that turn, lifelong: EPIBT whose operations are sorted by preferences."""

    def __init__(self, world, patience, depth=3):
        super().__init__(world, depth, additional=("R" + "W" * (depth - 1), "L" + "W" * (depth - 1)))
        self.progress = Progress(world, patience)

    def actions(self, preferences, states, goals):
        """Return an action for each agent at `states` [(row, col, heading)] with `goals`, by `preferences` (N, 4)."""
        self.preferences, self.stuck = preferences, self.progress.stuck(states, goals)
        return [ACTION[letter] for letter in self.decide(states, goals)]

    def ranked(self, agent, costs):
        """Return the operations that an agent may choose, the most preferred first, or those of EPIBT."""
        ranked = super().ranked(agent, costs)
        if agent in self.stuck:
            return ranked
        preferred = {place: self.preferences[agent][ACTION[self.operations[place][0]]] for place in costs}
        worst = min(self.preferences[agent])
        ranked += [place for place in costs if place not in ranked and preferred[place] > worst]
        return sorted(ranked, key=lambda place: (-preferred[place], costs[place], place))


class SlowPibtShield(SlowPIBT):
    """The safety layer: PIBT whose choices are sorted by preferences."""

    def __init__(self, world, patience, stays):
        super().__init__(world, stays=stays)
        self.random = 1
        self.progress = Progress(world, patience)

    def actions(self, preferences, states, goals):
        """Return a decision for each agent at `states` [(row, col, heading)] with `goals`, by `preferences` (N, A)."""
        self.preferences, self.stuck = preferences, self.progress.stuck(states, goals)
        if self.want is not None:  # only agents that ignore their preferences keep their cells
            self.want = [want if agent in self.stuck else None for agent, want in enumerate(self.want)]
        return self.decide(states, goals)

    def choices(self, agent):
        """Return an agent's choices, the most preferred first, or those of PIBT."""
        choices = super().choices(agent)
        return choices if agent in self.stuck else sorted(choices, key=lambda choice: -self.preference(agent, choice))


class SlowTurningShield(SlowPibtShield):
    """The same for agents that turn."""

    def actions(self, preferences, states, goals):
        """Return an action for each agent."""
        return [ACTION[letter] for letter in super().actions(preferences, states, goals)]

    def ways_to(self, agent, cell):
        """Return the first actions toward a cell; a turn to an obstacle leads behind, or in a corner nowhere."""
        row, col, heading = self.states[agent]
        around = [(row + STEPS[(heading + turn) % 4][0], col + STEPS[(heading + turn) % 4][1]) for turn in range(4)]
        ends = {"F": around[0], "W": (row, col)}
        for letter, side in (("L", around[3]), ("R", around[1])):
            ends[letter] = next((end for end in (side, around[2]) if end in self.world.free), (row, col))
        return [letter for letter in "FLRW" if ends[letter] == cell]

    def value(self, agent, letter):
        """Return the preference for an action."""
        return self.preferences[agent][ACTION[letter]]

    def preference(self, agent, choice):
        """Return the preference for the best action to a choice; for the cell behind, if none, the worse turn."""
        cell = self.cells[agent] if choice == STAY else self.beside(self.cells[agent])[choice]
        values = [self.value(agent, letter) for letter in self.ways_to(agent, cell)]
        return max(values) if values else min(self.value(agent, letter) for letter in "LR")

    def letter(self, agent):
        """Return the action that brings an agent nearer to the cell that it wants, by the turn that it prefers."""
        letter = super().letter(agent)
        if agent in self.stuck or letter == "F":
            return letter
        row, col, heading = self.states[agent]
        behind = (row - STEPS[heading][0], col - STEPS[heading][1])
        letters = "RL" if self.want[agent] == behind else self.ways_to(agent, self.want[agent])
        return max(letters, key=lambda one: (self.value(agent, one), one == letter))


class SlowCardinalShield(SlowPibtShield):
    """The same for cardinal agents, whose heading is 0."""

    def preference(self, agent, choice):
        """Return the preference for a choice."""
        return self.preferences[agent][CARDINAL[choice]]

    def cost(self, agent, choice):
        """Return the cost of moving to a neighbor and on to the goal, or of staying."""
        row, col, _ = self.states[agent]
        if choice == STAY:
            return 0 if (row, col) == self.goals[agent] else 1 + self.tables[agent][row, col, 0]
        return 1 + self.tables[agent][row + STEPS[choice][0], col + STEPS[choice][1], 0]

    def letter(self, agent):
        """Return the action that moves an agent to the cell that it wants."""
        step = tuple(int(to) - int(at) for to, at in zip(self.want[agent], self.cells[agent], strict=True))
        return CARDINAL[STAY if step == (0, 0) else STEPS.index(step)]


def assert_same_decisions(env, observations, planner, slow):
    """Play the episode that has begun; in each step, a planner and the one in plain Python must decide the same."""
    while env.agents:
        states = [(*cell, heading) for cell, heading in zip(env.positions.tolist(), env.headings.tolist(), strict=True)]
        expected = [ACTION[letter] for letter in slow.decide(states, list(map(tuple, env.goals.tolist())))]
        actions = planner.act(observations)
        assert list(actions.values()) == expected
        observations = env.step(actions)[0]
