// The text files of the PIBT and LaCAM tools: `key=value` lines, then the cells (x,y) of all agents at each step.

const TEXT_HEADINGS = ["X_PLUS", "Y_PLUS", "X_MINUS", "Y_MINUS"]; // east, south, west, north

function parseTextPlan(text, name) {
  const header = new Map(), steps = [];
  for (const [k, line] of linesOf(text).entries()) {
    const entry = steps.length ? null : /^(\w+)=(.*)$/.exec(line);
    if (entry) header.set(entry[1], [entry[2], k + 1]);
    else if (line.trim()) steps.push(textCells(line, steps.length, name, k + 1));
  }
  require(steps.length > 0, name, "expected a solution, got none");
  const agents = steps[0].length, rotates = steps[0][0][2] >= 0;
  const table = new PlanTable(agents, steps.length - 1, rotates, name);
  steps.forEach((cells, step) => {
    const isComplete = cells.length === agents && cells.every(([, , heading]) => heading >= 0 === rotates);
    require(isComplete, name, `expected ${agents} cells in step ${step}, with headings for all cells or for none`);
    cells.forEach(([x, y, heading], agent) => table.set(agent, step, y, x, heading));
  });
  const starts = headerCells(header, "starts", agents, name);
  const isStart = starts === null || steps[0].every(([x, y], agent) => sameCell(starts[agent], [y, x]));
  require(isStart, name, "expected the solution to start at the starts", header.get("starts")?.[1]);
  table.goals = headerCells(header, "goals", agents, name);
  return table;
}

// The cells [row, column] in an entry of the header; null if there is none.
function headerCells(header, key, agents, name) {
  const [value, line] = header.get(key) ?? ["", 0];
  if (!value) return null;
  const cells = textCells(`0:${value}`, 0, name, line);
  require(cells.length === agents, name, `expected ${agents} ${key}, got ${cells.length}`, line);
  return cells.map(([x, y]) => [y, x]);
}

// The cells [x, y, heading or -1] of a line `STEP:(x,y),(x,y,HEADING),...`.
function textCells(line, step, name, number) {
  const prefix = `${step}:`, cells = [];
  require(line.startsWith(prefix), name, `expected '${prefix}' and cells, got ${shortened(line)}`, number);
  const cell = /\((\d{1,9}),(\d{1,9})(?:,([XY]_(?:PLUS|MINUS)))?\)(?:,|$)/y;
  cell.lastIndex = prefix.length;
  while (cell.lastIndex < line.length) {
    const start = cell.lastIndex, match = cell.exec(line);
    require(match, name, `expected a cell (x,y), got ${shortened(line.slice(start))}`, number);
    cells.push([Number(match[1]), Number(match[2]), TEXT_HEADINGS.indexOf(match[3])]);
  }
  require(cells.length > 0, name, "expected at least one cell", number);
  return cells;
}
