// One recorded episode or plan: the states of all agents after each step, 0 to `steps`.

const ACTIVE = 1, BLOCKED = 2; // bits of an agent's flags
const HEADINGS = ["east", "south", "west", "north"];
const NORTH = 3;
const HEADING_STEPS = [[0, 1], [1, 0], [0, -1], [-1, 0]]; // row, column

class Episode {
  constructor(data, arrays) {
    Object.assign(this, data, arrays);
    this.countEvents();
  }

  // The arrays hold the steps of each agent in consecutive order.
  index(agent, step) { return agent * (this.steps + 1) + step; }
  cell(agent, step) { const i = this.index(agent, step); return [this.rows[i], this.cols[i]]; }
  goal(agent, step) { const i = this.index(agent, step); return [this.goalRows[i], this.goalCols[i]]; }
  isActive(agent, step) { return (this.flags[this.index(agent, step)] & ACTIVE) > 0; }
  isBlocked(agent, step) { return (this.flags[this.index(agent, step)] & BLOCKED) > 0; }
  isDelayed(agent, step) { return this.delayed !== undefined && this.delayed[this.index(agent, step)] > 0; }
  leader(agent, step) { return this.waitsFor === undefined ? -1 : this.waitsFor[this.index(agent, step)]; } // -1: none
  hasField() { return this.observers > 0 && this.view !== null && this.frame !== null; }
  hasGoals() { return this.goalRows !== undefined; }
  isAtGoal(agent, step) { return this.hasGoals() && sameCell(this.cell(agent, step), this.goal(agent, step)); }
  isInside(row, col) { return row >= 0 && row < this.height && col >= 0 && col < this.width; }
  isFree(row, col) { return this.isInside(row, col) && this.free[row * this.width + col] > 0; }

  // Whether a step of a lifelong episode ended at the goal that the agent had before it.
  arrives(agent, step) {
    return step > 0 && this.isActive(agent, step - 1) && sameCell(this.cell(agent, step), this.goal(agent, step - 1));
  }

  // The displayed position, [row, column], at a time between two steps.
  position(agent, time) {
    const before = Math.floor(time), part = time - before, from = this.cell(agent, before);
    if (!part) return from;
    const to = this.cell(agent, before + 1);
    const isMove = Math.abs(from[0] - to[0]) + Math.abs(from[1] - to[1]) <= 1;
    const share = isMove ? part : Math.round(part);
    return [from[0] + (to[0] - from[0]) * share, from[1] + (to[1] - from[1]) * share];
  }

  // The displayed heading in radians, clockwise from east.
  angle(agent, time) {
    const before = Math.floor(time), after = Math.min(before + 1, this.steps);
    const from = this.headings[this.index(agent, before)], to = this.headings[this.index(agent, after)];
    const turn = ((to - from + 5) % 4) - 1; // -1, 0, 1 or 2 quarters to the right
    return ((from + turn * (time - before)) * Math.PI) / 2;
  }

  // Counts, for each step, the agents on the map, at their goals, blocked and delayed, and all goals reached so far.
  countEvents() {
    const counts = () => new Int32Array(this.steps + 1);
    Object.assign(this, { numActive: counts(), numAtGoal: counts(), numBlocked: counts(), numDelayed: counts(), numReached: counts() });
    for (let agent = 0; agent < this.agents; agent++)
      for (let step = 0; step <= this.steps; step++) {
        const i = this.index(agent, step), flags = this.flags[i];
        if (flags & ACTIVE) this.numActive[step]++;
        if (flags & BLOCKED) this.numBlocked[step]++;
        if (this.isDelayed(agent, step)) this.numDelayed[step]++;
        if (!this.hasGoals()) continue;
        if (this.rows[i] === this.goalRows[i] && this.cols[i] === this.goalCols[i]) this.numAtGoal[step]++;
        if (this.lifelong && this.arrives(agent, step)) this.numReached[step]++;
      }
    addUp(this.numReached, this.steps + 1);
  }

  // The last step of the agent's current path: its next arrival at a goal (lifelong), or that on its last cell.
  endOfPath(agent, step) {
    if (!this.lifelong) return Math.max(step, this.restsFrom(agent));
    for (let later = step + 1; later < this.steps; later++) if (this.arrives(agent, later)) return later;
    return this.steps;
  }

  // The step after which the agent stays on its last cell.
  restsFrom(agent) {
    const last = this.cell(agent, this.steps);
    let step = this.steps;
    while (step > 0 && sameCell(this.cell(agent, step - 1), last)) step--;
    return step;
  }

  // How many moves into each cell the episode has.
  traffic() {
    if (this.movesInto) return this.movesInto;
    this.movesInto = new Float32Array(this.width * this.height);
    for (let agent = 0; agent < this.agents; agent++)
      for (let step = 1; step <= this.steps; step++) {
        const [row, col] = this.cell(agent, step);
        if (this.isInside(row, col) && !sameCell([row, col], this.cell(agent, step - 1)))
          this.movesInto[row * this.width + col]++;
      }
    return this.movesInto;
  }

  // How many steps agents waited in each cell without having reached their goals.
  waits() {
    if (this.waitsIn) return this.waitsIn;
    this.waitsIn = new Float32Array(this.width * this.height);
    for (let agent = 0; agent < this.agents; agent++)
      for (let step = 1; step <= this.steps; step++) {
        const cell = this.cell(agent, step), before = this.cell(agent, step - 1);
        const isWaiting = sameCell(cell, before) && this.isActive(agent, step) && !this.turns(agent, step);
        if (isWaiting && !this.isAtGoal(agent, step) && this.isInside(...cell)) this.waitsIn[cell[0] * this.width + cell[1]]++;
      }
    return this.waitsIn;
  }

  turns(agent, step) {
    return this.headings !== undefined && this.headings[this.index(agent, step)] !== this.headings[this.index(agent, step - 1)];
  }

  // The mean cost of leaving each cell; NaN where no move is allowed.
  leavingCosts() {
    if (this.meanCosts) return this.meanCosts;
    const cells = this.width * this.height;
    this.meanCosts = new Float32Array(cells);
    for (let cell = 0; cell < cells; cell++) {
      const costs = [0, 1, 2, 3].map((k) => this.weights[k * cells + cell]).filter(Number.isFinite);
      this.meanCosts[cell] = costs.reduce((sum, cost) => sum + cost, 0) / costs.length;
    }
    return this.meanCosts;
  }
}

function sameCell(a, b) { return a[0] === b[0] && a[1] === b[1]; }

// Replaces each run of `length` values by its cumulative sums.
function addUp(values, length) {
  for (let i = 0; i < values.length; i++) if (i % length) values[i] += values[i - 1];
}
