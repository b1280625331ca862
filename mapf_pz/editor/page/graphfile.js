// Guidance graphs in GGO's JSON format: the map and a list of weights. The costs of waiting come first, one or one for
// each free cell; then, for each free cell, the weights of the moves that the map allows.

const GGO_PLANES = [0, 3, 2, 1]; // right, up, left, down
const WAIT_PLANE = 4;
const BLOCKED_EDGE = -1;

function graphText(drawing) {
  const { height, width, free } = drawing, rows = mapText(drawing).split("\n").slice(4, -1);
  const weights = drawing.weights ?? new Float32Array(NUM_PLANES * free.length).fill(1);
  const waits = graphEdges(drawing, [WAIT_PLANE]).map((index) => weights[index]);
  const moves = graphEdges(drawing, GGO_PLANES).map((index) => weights[index]);
  const isPerCell = new Set(waits).size > 1;
  const values = [...(isPerCell ? waits : [waits[0] ?? 1]), ...moves.map((weight) => (weight < Infinity ? weight : BLOCKED_EDGE))];
  const data = { name: drawing.name, layout: rows, weight: true, optimize_wait: isPerCell, n_row: height, n_col: width };
  return JSON.stringify({ ...data, weights: values.map(shortest) }, null, 1);
}

// The indices of the weights of all free cells that have a meaning on the map, in the order of the file.
function graphEdges(drawing, planes) {
  const indices = [];
  for (let cell = 0; cell < drawing.free.length; cell++) {
    if (!drawing.free[cell]) continue;
    const [row, col] = cellOf(drawing, cell);
    for (const plane of planes) {
      const [down, right] = HEADING_STEPS[plane] ?? [0, 0];
      if (drawing.isFree(row + down, col + right)) indices.push(plane * drawing.free.length + cell);
    }
  }
  return indices;
}

// The number with the fewest digits that is the same with 32 bits.
function shortest(value) {
  for (let digits = 1; digits < 9; digits++) {
    const number = Number(value.toPrecision(digits));
    if (Math.fround(number) === value) return number;
  }
  return value;
}

// Whether the text of a JSON file is that of a guidance graph.
function isGraph(text) { return /"layout"\s*:/.test(text); }

// The drawing of a guidance graph's file: a map with weights.
function parseGraph(text, name) {
  const data = parseJson(text, name), rows = data.layout, width = Array.isArray(rows) ? rows[0]?.length : 0;
  const isLayout = width > 0 && rows.every((row) => typeof row === "string" && row.length === width && /^[.we@T]+$/.test(row));
  require(isLayout, name, "expected 'layout' to be a list of rows of equal length, of ., w, e, @ and T");
  const free = Uint8Array.from(rows.join(""), (letter) => (".we".includes(letter) ? 1 : 0));
  const drawing = new Drawing({ name: name.replace(/\.json$/i, ""), height: rows.length, width, free });
  if (data.weights === undefined) return drawing;
  const waits = graphEdges(drawing, [WAIT_PLANE]), moves = graphEdges(drawing, GGO_PLANES);
  const numWaits = data.optimize_wait ? waits.length : 1, given = data.weights, expected = numWaits + moves.length;
  const isList = Array.isArray(given) && given.length === expected;
  require(isList, name, `expected ${expected} numbers in 'weights', got ${shortened(given?.length ?? given)}`);
  const wrong = given.findIndex((weight, k) => !(weight > 0 || (weight === BLOCKED_EDGE && k >= numWaits)));
  require(wrong < 0, name, `expected a positive number as weight ${wrong}, got ${shortened(given[wrong])}`);
  const weights = new Float32Array(NUM_PLANES * free.length).fill(1);
  waits.forEach((index, k) => { weights[index] = given[data.optimize_wait ? k : 0]; });
  moves.forEach((index, k) => { weights[index] = given[numWaits + k] > 0 ? given[numWaits + k] : Infinity; });
  return drawing.with({ weights });
}

function parseJson(text, name) {
  try { return JSON.parse(text); } catch (error) { throw new FileError(name, `expected JSON: ${error.message}`); }
}
