// An instance that is drawn: a map, agents, and edge weights. It never changes: edits return another drawing, which
// shares with the first one what stays the same.

const LARGEST_SIDE = 1024; // cells
const NUM_PLANES = 5; // of edge weights: moves to the east, south, west and north, and waiting

class Drawing {
  // `free`: 1 for free cells, in reading order. `agents`: {start, goals, heading}, where cells are [row, column].
  // `turning`: whether agents turn; otherwise, headings have no effect. `weights`: null if all are 1.
  constructor({ name, height, width, free, agents = [], turning = true, weights = null }) {
    Object.assign(this, { name, height, width, free, agents, turning, weights });
    Object.freeze(this);
  }

  static empty(height, width) {
    return new Drawing({ name: "drawing", height, width, free: new Uint8Array(height * width).fill(1) });
  }

  with(changes) { return new Drawing({ ...this, ...changes }); }

  isInside(row, col) { return row >= 0 && row < this.height && col >= 0 && col < this.width; }
  isFree(row, col) { return this.isInside(row, col) && this.free[row * this.width + col] > 0; }
  number([row, col]) { return row * this.width + col; }
  inside([row, col]) {
    return [Math.max(0, Math.min(this.height - 1, row)), Math.max(0, Math.min(this.width - 1, col))];
  }

  withCells(cells, isFree) {
    const free = this.free.slice();
    for (const [row, col] of cells) if (this.isInside(row, col)) free[row * this.width + col] = isFree ? 1 : 0;
    return this.with({ free });
  }

  withAgent(agent, changes) {
    return this.with({ agents: this.agents.map((each, k) => (k === agent ? Object.freeze({ ...each, ...changes }) : each)) });
  }

  withNewAgent(start, goals, heading = 0) {
    return this.with({ agents: [...this.agents, Object.freeze({ start, goals, heading })] });
  }

  withoutAgent(agent) { return this.with({ agents: this.agents.filter((_, k) => k !== agent) }); }

  // The drawing with the weights of some edges [plane, cell number, weight].
  withWeights(edges) {
    const weights = this.weights?.slice() ?? new Float32Array(NUM_PLANES * this.free.length).fill(1);
    for (const [plane, cell, weight] of edges) weights[plane * this.free.length + cell] = weight;
    return this.with({ weights: weights.every((weight) => weight === 1) ? null : weights });
  }

  // The drawing with rows and columns added at its edges, or removed with negative numbers. New cells are free. Agents
  // whose start or a goal is cut off are removed.
  resized({ top = 0, right = 0, bottom = 0, left = 0 }) {
    const height = this.height + top + bottom, width = this.width + left + right;
    if (Math.min(height, width) < 1 || Math.max(height, width) > LARGEST_SIDE) return this;
    const free = new Uint8Array(height * width).fill(1);
    const weights = this.weights && new Float32Array(NUM_PLANES * height * width).fill(1);
    for (let row = Math.max(0, -top); row < Math.min(this.height, height - top); row++)
      for (let col = Math.max(0, -left); col < Math.min(this.width, width - left); col++) {
        const from = row * this.width + col, to = (row + top) * width + col + left;
        free[to] = this.free[from];
        for (let plane = 0; weights && plane < NUM_PLANES; plane++)
          weights[plane * height * width + to] = this.weights[plane * this.free.length + from];
      }
    const moved = ([row, col]) => [row + top, col + left];
    const isKept = ([row, col]) => row >= 0 && row < height && col >= 0 && col < width;
    const agents = this.agents
      .map((agent) => Object.freeze({ ...agent, start: moved(agent.start), goals: agent.goals.map(moved) }))
      .filter(({ start, goals }) => [start, ...goals].every(isKept));
    return this.with({ height, width, free, weights, agents });
  }
}
