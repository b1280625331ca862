// Lengths of shortest paths in eight directions that cut no corners, which scenario files contain.

const DIAGONAL = 1.414213562; // as many digits of the root of 2 as the MovingAI benchmark has

class OctileSearch {
  constructor(drawing) {
    const { width, height } = drawing;
    this.width = width + 2; // with obstacles around the map
    this.free = new Uint8Array(this.width * (height + 2));
    for (let row = 0; row < height; row++)
      this.free.set(drawing.free.subarray(row * width, (row + 1) * width), (row + 1) * this.width + 1);
    const numbers = () => new Int32Array(this.free.length);
    Object.assign(this, { costs: new Float64Array(this.free.length), straights: numbers(), diagonals: numbers() });
    this.queues = [numbers(), numbers()]; // cells that a straight and a diagonal step leads to, sorted by cost
  }

  // The length of the path between two cells [row, column]; Infinity if there is none.
  distance(start, goal) {
    const [first, last] = [start, goal].map(([row, col]) => (row + 1) * this.width + col + 1);
    this.costs.fill(Infinity);
    this.costs[first] = this.straights[first] = this.diagonals[first] = 0;
    this.queues[0][0] = first;
    this.heads = [0, 0];
    this.tails = [1, 0];
    while (this.heads[0] < this.tails[0] || this.heads[1] < this.tails[1]) {
      const cell = this.next();
      if (cell === last) break;
      this.expand(cell);
    }
    return this.costs[last];
  }

  next() {
    const [straight, diagonal] = this.queues.map((queue, k) => (this.heads[k] < this.tails[k] ? queue[this.heads[k]] : -1));
    const k = straight >= 0 && (diagonal < 0 || this.costs[straight] <= this.costs[diagonal]) ? 0 : 1;
    return this.queues[k][this.heads[k]++];
  }

  expand(cell) {
    const { free, width } = this;
    for (const down of [-width, 0, width])
      for (const right of [-1, 0, 1]) {
        const isDiagonal = down !== 0 && right !== 0, next = cell + down + right;
        if (free[next] && (!isDiagonal || (free[cell + down] && free[cell + right]))) this.reach(cell, next, isDiagonal ? 1 : 0);
      }
  }

  // Costs are computed from numbers of steps, so that equal ones are exactly equal.
  reach(cell, next, diagonal) {
    const straights = this.straights[cell] + 1 - diagonal, diagonals = this.diagonals[cell] + diagonal;
    const cost = straights + diagonals * DIAGONAL;
    if (cost >= this.costs[next]) return;
    this.costs[next] = cost;
    this.straights[next] = straights;
    this.diagonals[next] = diagonals;
    this.queues[diagonal][this.tails[diagonal]++] = next;
  }
}
