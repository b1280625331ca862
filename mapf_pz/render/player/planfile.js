// Plan files: League of Robot Runners JSON, tracker CSV, and the text of the PIBT and LaCAM tools.

// The positions, and headings if agents have them, of all agents, with the steps of each in consecutive order.
class PlanTable {
  constructor(agents, steps, rotates, name) {
    const expected = `expected at most ${MOST_POSITIONS} steps times agents`;
    require(agents * steps <= MOST_POSITIONS, name, `${expected}, got ${steps} x ${agents}`);
    const size = agents * (steps + 1);
    Object.assign(this, { agents, steps, rows: new Int32Array(size), cols: new Int32Array(size), goals: null });
    if (rotates) this.headings = new Uint8Array(size);
  }

  set(agent, step, row, col, heading) {
    const i = agent * (this.steps + 1) + step;
    this.rows[i] = row; this.cols[i] = col;
    if (this.headings) this.headings[i] = heading;
  }
}

// `scenario` may be null; only tracker CSV files need one.
function parsePlan(text, name, scenario) {
  const start = text.trimStart().slice(0, 1000);
  if (start.startsWith("{")) return parseLorrPlan(text, name);
  if (/^(\w+=|0:)/.test(start)) return parseTextPlan(text, name);
  if (/^.*\b(solution_plan|path)\b/.test(start)) return parseTrackerPlan(text, name, scenario);
  const expected = "expected a plan: League of Robot Runners JSON, tracker CSV, or text with a 'solution='";
  throw new FileError(name, `${expected}, got ${shortened(text)}`, 1);
}

// Follows the letters of an agent from its start: `moves` holds the step [row, column] of a letter, `turns` the quarter
// turns of rotating agents, which move straight ahead with `F`.
function followLetters(table, agent, start, letters, moves, turns) {
  let [row, col, heading] = start;
  table.set(agent, 0, row, col, heading);
  for (let step = 1; step <= table.steps; step++) {
    const letter = letters[step - 1] ?? "";
    const [down, right] = turns && letter === "F" ? HEADING_STEPS[heading] : moves[letter] ?? [0, 0];
    row += down; col += right;
    if (turns) heading = (heading + (turns[letter] ?? 0)) % 4;
    table.set(agent, step, row, col, heading);
  }
}
