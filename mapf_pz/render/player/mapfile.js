// The MovingAI benchmark's maps and scenarios. In these files, x is the column and y the row.

const PASSABLE = ".GSE", IMPASSABLE = "@OTW";
const SCENARIO_COLUMNS = 9;

function parseMap(text, name) {
  const lines = linesOf(text);
  const header = [[/^type\s+octile\s*$/, "'type octile'"], [/^height\s+(\d{1,9})\s*$/, "'height' and a number"],
    [/^width\s+(\d{1,9})\s*$/, "'width' and a number"], [/^map\s*$/, "'map'"]];
  const [, height, width] = header.map(([pattern, expected], k) => {
    const match = pattern.exec(lines[k] ?? "");
    require(match, name, `expected ${expected}, got ${shortened(lines[k] ?? "")}`, k + 1);
    return Number(match[1]);
  });
  const cells = height * width;
  require(cells > 0 && cells <= MOST_CELLS, name, `expected 1 to ${MOST_CELLS} cells, got ${height} x ${width}`, 2);
  const free = new Uint8Array(height * width);
  for (let row = 0; row < height; row++) {
    const letters = lines[header.length + row] ?? "", line = header.length + row + 1;
    require(letters.length === width, name, `expected a row of ${width} cells, got ${letters.length}`, line);
    for (let col = 0; col < width; col++) {
      const isKnown = (PASSABLE + IMPASSABLE).includes(letters[col]);
      require(isKnown, name, `expected one of ${PASSABLE}${IMPASSABLE}, got ${shortened(letters[col])}`, line);
      free[row * width + col] = PASSABLE.includes(letters[col]) ? 1 : 0;
    }
  }
  return { height, width, free, name: name.replace(/\.map$/i, "") };
}

// Returns the starts and goals [row, column] of a scenario for a map.
function parseScenario(text, name, map) {
  const starts = [], goals = [];
  for (const [k, line] of linesOf(text.trimEnd()).entries()) {
    if (k === 0 && /^version\s+1(\.0)?\s*$/.test(line)) continue;
    const columns = line.split("\t");
    const expected = `expected ${SCENARIO_COLUMNS} columns separated by tabs, got ${columns.length}`;
    require(columns.length === SCENARIO_COLUMNS, name, expected, k + 1);
    const numbers = columns.slice(2, 8).map((column) => (/^\d{1,9}$/.test(column) ? Number(column) : NaN));
    require(!numbers.some(Number.isNaN), name, "expected the map's size, the start and the goal as whole numbers", k + 1);
    const [width, height, startX, startY, goalX, goalY] = numbers;
    const size = `expected the size of map '${map.name}', width ${map.width} and height ${map.height}`;
    require(width === map.width && height === map.height, name, `${size}, got ${width} and ${height}`, k + 1);
    for (const [what, x, y] of [["start", startX, startY], ["goal", goalX, goalY]]) {
      const isFree = x < width && y < height && map.free[y * width + x];
      require(isFree, name, `expected the ${what} to be a free cell of the map, got x=${x}, y=${y}`, k + 1);
    }
    starts.push([startY, startX]);
    goals.push([goalY, goalX]);
  }
  require(starts.length > 0, name, "expected a line for each agent, got none", 1);
  return { starts, goals, name: name.replace(/\.scen$/i, "") };
}
