// Random obstacles and agents. Equal seeds give equal results.

class RandomNumbers {
  constructor(seed) { this.state = seed >>> 0; }

  // The next number, 0 or more and less than 1: mulberry32 by Tommy Ettinger.
  next() {
    this.state = (this.state + 0x6d2b79f5) >>> 0;
    let bits = Math.imul(this.state ^ (this.state >>> 15), this.state | 1);
    bits ^= bits + Math.imul(bits ^ (bits >>> 7), bits | 61);
    return ((bits ^ (bits >>> 14)) >>> 0) / 2 ** 32;
  }

  below(limit) { return Math.floor(this.next() * limit); }

  shuffle(values) {
    for (let k = values.length - 1; k > 0; k--) {
      const other = this.below(k + 1);
      [values[k], values[other]] = [values[other], values[k]];
    }
    return values;
  }
}

// Makes each free cell without a start or goal an obstacle with this probability.
function withRandomObstacles(drawing, density, seed) {
  const random = new RandomNumbers(seed), cells = [];
  const taken = new Set(drawing.agents.flatMap(({ start, goals }) => [start, ...goals]).map((cell) => drawing.number(cell)));
  for (let number = 0; number < drawing.free.length; number++) {
    const isHit = random.next() < density;
    if (isHit && drawing.free[number] && !taken.has(number)) cells.push(cellOf(drawing, number));
  }
  return drawing.withCells(cells, false);
}

// Adds agents with goals in the region of their starts; as many as there is room for, if there are too few cells.
function withRandomAgents(drawing, count, goalsEach, seed) {
  const random = new RandomNumbers(seed), regions = regionNumbers(drawing);
  const without = (cells) => {
    const taken = new Set(cells.map((cell) => drawing.number(cell)));
    return [...drawing.free.keys()].filter((number) => drawing.free[number] && !taken.has(number));
  };
  const starts = random.shuffle(without(drawing.agents.map(({ start }) => start))).slice(0, count);
  const goals = new Map(); // those that are left, by region
  for (const number of random.shuffle(without(drawing.agents.flatMap((agent) => agent.goals))))
    if (goals.has(regions[number])) goals.get(regions[number]).push(number); else goals.set(regions[number], [number]);
  const added = [];
  for (const start of starts) {
    const first = goals.get(regions[start])?.pop();
    if (first === undefined) continue;
    const region = goalsEach > 1 ? [...regions.keys()].filter((number) => regions[number] === regions[start]) : [];
    const later = Array.from({ length: goalsEach - 1 }, () => region[random.below(region.length)]);
    const agent = { start: cellOf(drawing, start), heading: random.below(4) };
    added.push(Object.freeze({ ...agent, goals: [first, ...later].map((number) => cellOf(drawing, number)) }));
  }
  return drawing.with({ agents: [...drawing.agents, ...added] });
}

function cellOf(drawing, number) { return [Math.floor(number / drawing.width), number % drawing.width]; }
